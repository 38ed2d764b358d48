"""Import, one step of the world, three updates of the learner: whether an installation works at all."""

import sys

import jax
import jax.numpy as jnp

import jaxnav
from jaxnav import Action, Params, World
from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.training.config import TrainConfig
from jaxnav.training.loop import Trainer


def one_step():
    """A step of an episode, and what it led to."""
    world, params = World(), Params()
    key_reset, key_step = jax.random.split(jax.random.key(0))
    state = jax.jit(world.reset)(key_reset, params)
    action = Action(twist=jnp.array([1.0, 0.0]), request=jnp.int32(0))
    state, outcome = jax.jit(world.step)(key_step, state, action, params)
    observation = jax.jit(world.observe)(state, params)
    assert int(state.t) == 1, state.t
    assert jnp.isfinite(outcome.reward), outcome
    assert jnp.all(jnp.isfinite(observation.scan)), observation


def three_updates():
    """Three updates of hybrid SAC, and losses that are finite."""
    config = TrainConfig(episodes=16, replay_rows=8, steps_per_chunk=3, total_steps=3)
    trainer = Trainer(World(), HSAC(HSACConfig(batch=32, updates_per_step=1)), Params(), config)
    hyper = HSACHyperparameters()
    loop = jax.jit(trainer.init)(jax.random.key(0), hyper)
    loop, metrics = jax.jit(trainer.train_chunk, donate_argnums=0)(loop, hyper)
    assert int(loop.counter) == 3, loop.counter
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(metrics)), metrics


if __name__ == "__main__":
    one_step()
    three_updates()
    print(f"jaxnav {jaxnav.__version__} works: Python {sys.version.split()[0]}, jax {jax.__version__}")
