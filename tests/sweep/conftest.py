"""A sweep that is small enough for a test, and an engine that makes up what training would have found."""

import dataclasses

import numpy as np
import pytest

from jaxnav.agents.hsac import HSACConfig
from jaxnav.sweep import Guard, Range, Sweep
from jaxnav.sweep.worker import Round
from jaxnav.training.config import HSACRunConfig, TrainConfig, WorldSettings
from jaxnav.world import Params

# Of seconds: 4 chunks of 5 steps of 16 episodes in the square.
TINY = HSACRunConfig(
    world=WorldSettings(scenes=("square",), beams=16, params=Params(max_steps=12.0)),
    agent=HSACConfig(actor_widths=(16,), critic_widths=(16,), batch=32, updates_per_step=2),
    train=TrainConfig(episodes=16, replay_rows=20, steps_per_chunk=5, total_steps=20, checkpoint_seconds=0.0),
)
SWEEP = Sweep(
    base=TINY,
    space={"hyper.actor_lr": Range(1e-4, 1e-2, log=True), "world.params.reward_request": Range(0.0, 50.0)},
    sizes={"agent.updates_per_step": (1, 2)},
    guard=Guard(scene="hallway", total_steps=15, every=5, reaches=0.8),
    trials=20,
    members=3,
    rungs=(5, 10),
    episodes=8,
    confirm=2,
    seeds=3,
)


@pytest.fixture(scope="session", name="tiny_sweep")
def _tiny_sweep():
    """A function (changed fields) -> `Sweep`."""
    return lambda **changes: dataclasses.replace(SWEEP, **changes)


class MadeUp:
    """An engine whose trials succeed as values and seed say, a little more each round; a rate above 5e-3 breaks."""

    def __init__(self):
        self.rounds = []  # (job, round, numbers of fills) as they were asked for

    def advance(self, tasks, done=lambda: None):
        found = []
        for job, round, fills in tasks:
            self.rounds.append((job.name, round, len(fills)))
            latest = {fill.slot: fill for fill in fills if fill.round <= round}
            there = [latest.get(slot) for slot in range(job.members)]
            found.append(
                Round(
                    scenes=[{"square": {"success": success(job, fill, round)}} for fill in there],
                    losses=[{"critic_loss": 1.0}] * job.members,
                    broken=[fill is not None and broken(fill, round) for fill in there],
                    seconds=3.0,
                    device="made up",
                )
            )
            done()
        return found

    def forget(self, names):
        pass

    def close(self):
        pass


def success(job, fill, round):
    if fill is None:
        return 0.0
    far = abs(np.log10(fill.values["hyper.actor_lr"]) + 3.0) + 0.1 * job.config.agent.updates_per_step
    luck = np.random.default_rng(fill.seed).uniform(0, 0.1)
    return float(np.clip(0.3 + 0.2 * (round - fill.round + 1) - 0.2 * far + luck, 0, 1))


def broken(fill, round):
    return fill.values["hyper.actor_lr"] > 5e-3


@pytest.fixture
def made_up():
    return MadeUp()
