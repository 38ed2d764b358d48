"""What a field allows is what it checks, shows and documents."""

import dataclasses

import jax
import numpy as np
import pytest
from flax import struct

from jaxnav import fields


@dataclasses.dataclass(frozen=True)
class _Sizes:
    doors: int = fields.whole(1, low=1, high=9, doc="how many doors there are")
    widths: tuple[int, ...] = fields.wholes((8, 8), doc="hidden layers")
    side: str = fields.choice("left", ("left", "right"), doc="side on which they open")
    rooms: tuple[str, ...] = fields.choices(("hall",), ("hall", "yard"), doc="rooms that have doors")
    open: bool = fields.flag(False, doc="whether they stand open")
    name: str = fields.text("door", doc="their name")

    def __post_init__(self):
        fields.check(self, "sizes")


@struct.dataclass
class _Floats:
    width: float = fields.number(0.4, above=0, below=2, unit="m", doc="width of a door")
    count: float = fields.number(0.0, low=0, whole=True, doc="how many are open")
    share: float = fields.probability(0.5, doc="share of time for which it is open")
    reward: float = fields.number(500.0, doc="for passing it")


@pytest.mark.parametrize(
    ("field", "value", "remedy"),
    [
        ("doors", 0, "a whole number from 1 to 9"),
        ("doors", 10, "a whole number from 1 to 9"),
        ("doors", True, "a whole number from 1 to 9"),
        ("doors", 1.0, "a whole number from 1 to 9"),
        ("widths", (), "one or more whole numbers of at least 1"),
        ("widths", (8, 0), "one or more whole numbers of at least 1"),
        ("side", "up", "one of left, right"),
        ("rooms", ("hall", "hall"), "some of hall, yard, each once"),
        ("rooms", ("attic",), "some of hall, yard, each once"),
        ("rooms", "hall", "some of hall, yard, each once"),
        ("open", 1, "True or False"),
        ("name", 3, "any text"),
    ],
)
def test_a_size_out_of_its_range_is_named(field, value, remedy):
    with pytest.raises(ValueError, match=r"^sizes") as error:
        _Sizes(**{field: value})
    assert str(error.value) == f"sizes.{field} is {value!r}: give {remedy}"


@pytest.mark.parametrize(
    ("field", "value", "remedy"),
    [
        ("width", 0.0, "a number above 0 and below 2"),
        ("width", float("nan"), "a number above 0 and below 2"),
        ("width", "wide", "a number above 0 and below 2"),
        ("count", 0.5, "a whole number of at least 0"),
        ("share", np.array([0.2, 1.2]), "a number from 0 to 1"),
        ("reward", float("inf"), "a finite number"),
    ],
)
def test_a_float_out_of_its_range_is_named_and_a_traced_one_passes(field, value, remedy):
    floats = _Floats().replace(**{field: value})
    with pytest.raises(ValueError, match=rf"^floats\.{field} is .*: give {remedy}$"):
        fields.check(floats, "floats")
    if not isinstance(value, str):
        jax.eval_shape(lambda traced: fields.check(traced, "floats"), floats)


def test_pytrees_keep_floats_as_leaves_and_arrays_pass():
    assert jax.tree.leaves(_Floats()) == [0.4, 0.0, 0.5, 500.0]
    fields.check(_Floats(width=np.array([0.1, 0.2]), share=jax.numpy.ones(2)), "floats")


def test_a_subclass_changes_the_default_alone():
    @dataclasses.dataclass(frozen=True)
    class More(_Sizes):
        doors: int = fields.again(_Sizes, "doors", 3)

    assert More().doors == 3
    with pytest.raises(ValueError, match=r"sizes\.doors is 10"):
        More(doors=10)


def test_rows_name_every_field_with_its_range():
    @dataclasses.dataclass(frozen=True)
    class House:
        sizes: _Sizes = fields.nested(_Sizes, doc="its doors")
        floats: _Floats = fields.nested(_Floats, doc="more of them")

    table = {name: (default, rule.unit, rule.allowed) for name, default, rule in fields.rows(House)}
    assert len(table) == 10
    assert table["floats.width"] == (0.4, "m", "a number above 0 and below 2")
    assert table["sizes.side"] == ("left", "", "one of left, right")
