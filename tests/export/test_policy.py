"""The exported policy beside the JAX policy: every encoder, head, language and learner, and what it refuses."""

import ast
import json

import jax
import numpy as np
import pytest

from experiments.exporting import single_states
from jaxnav.export.bundle import GOLDEN, travelling
from jaxnav.export.reference import Reference

NAMES = ("lidar", "approach", "grid", "frozen", "td3", "ppo")  # the bundles of conftest.py


@pytest.mark.parametrize("name", NAMES)
def test_it_computes_what_the_policy_in_jax_does(name, bundles, robot, full):
    """In states of other episodes than those of golden.npz; random weights, no bias 0 and no scale 1."""
    if name == "frozen" and not full:
        pytest.skip("compiles a second world with grid maps: pytest --full")
    run, actor, _ = bundles(name)
    folder, policy, _, _ = robot(name)
    reference = Reference(run, actor)
    episodes = reference.play(seed=5)
    inputs, outputs = reference.sample(episodes, GOLDEN, seed=6)  # as many as were recorded: compiled already
    exact = policy.Policy(str(folder))
    found = single_states.difference(policy, exact, inputs, outputs)
    assert max(found["v"], found["w"]) <= 1e-5 and found["requests"] == 0, found
    # What is compared is no constant: decisions differ a thousand times as much from state to state.
    assert min(np.ptp(outputs["v"]), np.ptp(outputs["w"])) > 0.01
    requests = exact.contract["network"]["requests"]
    assert len(np.unique(outputs["request"])) > 1 or requests <= 2
    one = exact.act({key: value[0] for key, value in inputs.items()})
    np.testing.assert_allclose([one.v, one.w], [outputs["v"][0], outputs["w"][0]], atol=1e-5)
    for key in ("heard", "answer", "log_p"):
        np.testing.assert_allclose(getattr(one, key), outputs[key][0], atol=1e-5)
    assert one.request == outputs["request"][0]
    if exact.rasterise is not None:
        assert_maps_of_the_world(run, episodes, reference, exact.rasterise)


def assert_maps_of_the_world(run, episodes, reference, rasterise):
    """Cell by cell, in the states in which these episodes begin and end."""
    states = jax.tree.map(
        lambda *leaves: np.concatenate([leaf[[0, -1]] for leaf in leaves]), *(e.states for e in episodes)
    )
    states = jax.tree.map(lambda leaf: np.resize(leaf, (GOLDEN, *leaf.shape[1:])), states)
    inputs, _ = reference.both(states, np.ones(GOLDEN, bool))
    seen = jax.jit(jax.vmap(run.world.observe, in_axes=(0, None)))(states, run.params)
    scans = zip(inputs["scan"], inputs["pedestrians"], inputs["seen"], strict=True)
    maps = np.stack([rasterise(*one) for one in scans])
    np.testing.assert_array_equal(maps[:, 0], seen.sensor_map)
    np.testing.assert_array_equal(maps[:, 1:], seen.pedestrian_map)
    assert (maps[:, 1] > 0).any() and len(np.unique(maps[:, 0])) == 4


def test_a_request_is_only_spoken_with_a_voice(robot):
    folder, policy, _, _ = robot("approach")
    exact = policy.Policy(str(folder))
    golden = policy.load_arrays(str(folder), exact.contract, "golden.npz")
    spoke = np.flatnonzero(golden["out.request"])
    assert len(spoke)
    observation = {name: golden[name][spoke[0]] for name in exact.inputs}
    assert exact.act(observation).request != 0
    assert exact.act(dict(observation, voice=np.array(False))).request == 0


def test_what_travels_is_python_3_6():
    assert len(travelling()) >= 8
    for path in travelling():
        with open(path, encoding="utf-8") as file:
            source = file.read()
        nodes = list(ast.walk(ast.parse(source, feature_version=(3, 6))))
        names = [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        names += [node.module or "." for node in nodes if isinstance(node, ast.ImportFrom)]
        assert not {name.split(".")[0] for name in names} & {"", "jax", "jaxnav"}, path


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("scan", np.full(180, np.nan, np.float32), "scan has nan to nan: give 0 to 12"),
        ("scan", np.zeros(179, np.float32), r"scan has shape \[179\]: give \[180\]"),
        ("scan", np.full(180, 12.5), "scan has 12.5 to 12.5: give 0 to 12"),
        ("scan", np.full(180, "3"), "scan has dtype <U1: give float32"),
        ("scan", None, "scan has dtype object: give float32"),
        ("asked", np.array([0.5]), "asked has dtype float64: give int32"),
        ("asked", np.array([4]), "asked has 4 to 4: give 0 to 3"),
        ("pose", np.full((3, 3), np.inf), "pose has inf to inf"),
        ("voice", ..., "voice is missing: give scan, pedestrians"),
    ],
)
def test_a_wrong_input_is_named(name, value, said, robot):
    folder, policy, _, _ = robot("lidar")
    exact = policy.Policy(str(folder))
    golden = policy.load_arrays(str(folder), exact.contract, "golden.npz")
    observation = {key: golden[key][0] for key in exact.inputs}
    exact.act(observation)
    if value is ...:
        del observation[name]
    else:
        observation[name] = value
    with pytest.raises(ValueError, match=said):
        exact.act(observation)


def test_the_contract_describes_every_input_and_output(robot):
    folder, policy, _, _ = robot("lidar")
    contract = json.loads((folder / "contract.json").read_text())
    golden = policy.load_arrays(str(folder), contract, "golden.npz")
    assert {entry["name"] for entry in contract["inputs"]} == {name for name in golden if not name.startswith("out.")}
    assert [entry["name"] for entry in contract["outputs"]] == list(policy.Decision._fields)
    entries = {entry["name"]: entry for entry in contract["inputs"]}
    for name, entry in (entries | {"out." + entry["name"]: entry for entry in contract["outputs"]}).items():
        recorded = golden[name]
        assert list(recorded.shape[1:]) == entry["shape"], entry["name"]
        low, high = entry["range"]
        assert recorded.min() >= low and recorded.max() <= high, entry["name"]
        assert entry["meaning"] and entry["unit"]
    assert contract["requests"][1] == {"request": 1, "name": "stop"}
