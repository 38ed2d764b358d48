"""The learner outside this package's world: an ordinary loop over a task of plain NumPy.

A point on a line is to be pushed to the middle by one half of the twist, and there the right word ends the episode. To
be elsewhere costs, and so does any other word. Which is the right one can be seen in the scan.
"""

import jax
import numpy as np

from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.learner import Batch
from jaxnav.world import Observation
from jaxnav.world.types import ObservedDialogue

POINTS, LONGEST, REACH, NEAR = 32, 12, 0.4, 0.2


class Line:
    """So many points at once. x: `[points]`; word: 1 to 3, the right one; age: steps of this episode."""

    def __init__(self, rng, points):
        self.rng = rng
        self.x, self.word, self.age = np.zeros(points), np.zeros(points, int), np.zeros(points, int)
        self.restart(np.ones(points, bool))

    def restart(self, which):
        count = which.sum()
        self.x[which] = self.rng.uniform(-1.5, 1.5, count)
        self.word[which] = self.rng.integers(1, 4, count)
        self.age[which] = 0

    def observe(self):
        """An `Observation`: x in the pose, the word in the scan, and nobody there."""
        points = len(self.x)
        pose = np.zeros((points, 3, 3), np.float32)
        pose[:, 2, 0] = self.x
        nobody = np.zeros((points, 1), np.int32)
        talk = ("is_open", "pedestrian_first", "message", "message_age", "request", "request_age", "reply")
        return Observation(
            pose=pose,
            twist=np.zeros((points, 2), np.float32),
            may_request=np.ones(points, bool),
            scan=np.float32(self.word[:, None] == [1, 2, 3]),
            pedestrians=np.zeros((points, 1, 4), np.float32),
            seen=nobody > 0,
            dialogue=ObservedDialogue(utterance=np.uint32(nobody), **dict.fromkeys(talk, nobody)),
        )

    def step(self, twist, request):
        """(reward, terminated, ended) of every point."""
        done = (np.abs(self.x) < NEAR) & (request == self.word)
        self.x = np.clip(self.x + REACH * np.asarray(twist)[:, 0], -2, 2)
        self.age += 1
        reward = np.where(done, 2.0, np.where(request > 0, -0.3, 0.0)) - 0.1 - 0.3 * np.abs(self.x)
        return np.float32(reward), done, done | (self.age == LONGEST)


def returns(policy):
    """Mean return of ``policy(line)`` -> (twist, request) over one episode of each of 500 points."""
    line = Line(np.random.default_rng(7), 500)
    total, going = np.zeros(500), np.ones(500, bool)
    for _ in range(LONGEST):
        reward, _, ended = line.step(*policy(line))
        total += going * reward
        going &= ~ended
    return total.mean()


def ideal(line):
    """As far to the middle as it gets; then the word."""
    forward = np.clip(-line.x / REACH, -1, 1)
    return np.stack([forward, 0 * forward], axis=-1), np.where(np.abs(line.x) < NEAR, line.word, 0)


def test_a_task_of_plain_numpy_is_learnt_in_an_ordinary_loop():
    agent = HSAC(HSACConfig(encoder="lidar", language="codes", actor_widths=(64,), critic_widths=(64, 64)))
    hyper = HSACHyperparameters(reward_scale=1.0, discount=0.9, actor_lr=3e-3, critic_lr=3e-3, tau=0.02, average=0.02)
    init, act, update, best = map(jax.jit, (agent.init, agent.act, agent.update, agent.best_action))
    line = Line(np.random.default_rng(0), POINTS)
    learner = init(jax.random.key(0), jax.tree.map(lambda leaf: leaf[0], line.observe()), hyper)

    def score():
        def policy(line):
            action = best(agent.policy(learner), line.observe())
            return action.twist, np.asarray(action.request)

        return returns(policy)

    untrained, record = score(), []
    for key in jax.random.split(jax.random.key(1), 400):
        key_act, key_update = jax.random.split(key)
        before = line.observe()
        action = jax.device_get(act(key_act, learner, before, hyper))
        reward, terminated, ended = line.step(action.twist, action.request)
        record.append(
            Batch(
                observation=before, next_observation=line.observe(), twist=action.twist, request=action.request,
                reward=reward, terminated=terminated, ended=ended, steps=np.ones(POINTS, np.int32),
            )
        )  # fmt: skip
        line.restart(ended)
        for one in jax.random.split(key_update, 3):
            rows = line.rng.integers(0, len(record), 4)
            batch = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(record[row] for row in rows))
            learner, _ = update(one, learner, batch, hyper)
    trained, most = score(), returns(ideal)
    assert untrained < most - 2.0
    assert trained > most - 0.25
