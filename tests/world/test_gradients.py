"""Gradients through 20-step rollouts: those of central differences, and finite wherever a rollout starts."""

import json
import os
import pathlib
import subprocess
import sys

ROLLOUTS = pathlib.Path(__file__).with_name("rollout_gradients.py")


def found(study, full):
    """What `rollout_gradients.py` finds, in a process that may choose its own precision."""
    command = [sys.executable, ROLLOUTS, study, "full" if full else "everyday"]
    here = {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True, env=os.environ | here).stdout)


def test_gradients_of_the_return_are_those_of_central_differences(full):
    result = found("differences", full)
    assert result["largest_error"] <= 1e-3, result
    assert result["events"] < 0.01
    components = result["components"]
    assert all(component["events"] < 0.05 for component in components.values()), result
    # Nobody arrives within these 8 s, and few are as fast as they can be; all else has a slope.
    assert {name for name in components if components[name]["not_zero"] == 0} <= {"reward_arrival", "max_speed"}
    assert components["twist v"]["not_zero"] > 0.5


def test_gradients_of_rewards_and_observations_are_finite_wherever_a_rollout_starts(full):
    result = found("finite", full)
    assert result["not_finite"] == {"twists": 0, "poses": 0, "params": 0}, result
