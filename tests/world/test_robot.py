"""The unicycle against its closed form and a fine integration."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxnav.world import Params
from jaxnav.world.robot import arc, twist_from_action

jitted_arc = jax.jit(arc)


@given(
    st.floats(-5, 5), st.floats(-5, 5), st.floats(-4, 4), st.floats(0, 0.6),
    st.floats(-0.9, 0.9),
)  # fmt: skip
def test_arc_is_what_fine_integration_gives(x, y, heading, v, w):
    time, steps = 0.4, 2000
    headings = heading + w * time * (np.arange(steps) + 0.5) / steps
    expected = (x + v * time * np.cos(headings).mean(), y + v * time * np.sin(headings).mean(), heading + w * time)
    np.testing.assert_allclose(jitted_arc(x, y, heading, v, w, time), expected, atol=3e-6)


@pytest.mark.parametrize("w", [0.9, -0.9, 0.3, -0.01])
@pytest.mark.parametrize("time", [0.4, 3.0])
def test_arc_is_a_circle(w, time):
    x, y, heading = arc(1.0, -2.0, 0.5, 0.6, w, time)
    r = 0.6 / w
    assert (x, y) == pytest.approx(
        (1 + r * (np.sin(0.5 + w * time) - np.sin(0.5)), -2 - r * (np.cos(0.5 + w * time) - np.cos(0.5))),
        abs=1e-4 if abs(w) < 0.1 else 1e-5,
    )
    assert heading == pytest.approx(0.5 + w * time)


def test_arc_without_turning_is_a_line_and_has_the_limit_of_the_gradient():
    assert arc(1.0, 2.0, np.pi / 6, 0.5, 0.0, 0.4) == pytest.approx((1 + 0.2 * np.cos(np.pi / 6), 2.1, np.pi / 6))
    # dy/dw of a straight line along x: v t^2 / 2.
    assert jax.grad(lambda w: arc(0.0, 0.0, 0.0, 0.5, w, 0.4)[1])(0.0) == pytest.approx(0.5 * 0.4**2 / 2)


@pytest.mark.parametrize(
    ("twist", "expected"),
    [((-1, 0), (0, 0)), ((1, 1), (0.6, 0.9)), ((0, -1), (0.3, -0.9)), ((-7, 3), (0, 0.9)), ((9, -9), (0.6, -0.9))],
)
def test_actions_cover_standing_still_to_full_speed_and_no_more(twist, expected):
    assert twist_from_action(np.array(twist, np.float32), Params()) == pytest.approx(expected)
