"""Exported policies beside those in JAX in single states: untrained robots of every encoder, head and language."""

import dataclasses
import functools
import math
import pathlib
import re
import subprocess
import sys
import tempfile

import jax
import jax.numpy as jnp
import numpy as np

from jaxnav import preset
from jaxnav.agents import ENCODERS
from jaxnav.agents.hsac import HEADS, LANGUAGES
from jaxnav.errors import UserError
from jaxnav.export.bundle import write_bundle
from jaxnav.export.contract import origin_of
from jaxnav.export.modules import modules
from jaxnav.export.reference import Reference
from jaxnav.training import Run, resolve

# Of hybrid SAC every encoder, head and language; of the others one each, since only what makes a twist differs.
CONFIGURATIONS = {
    f"{encoder}, {heads}, {language}": ("hsac", encoder, {"heads": heads, "language": language})
    for encoder in ENCODERS
    for heads in HEADS
    for language in LANGUAGES
} | {"lidar, td3": ("td3", "lidar", {}), "lidar-approach, ppo": ("ppo", "lidar-approach", {})}
_STEPS = 40  # of the episodes from which states are drawn
_SEED = 3
_BLOCK = 500  # states at once: what a convolution makes of them must fit into memory


def untrained(name):
    """(run, actor) of a configuration: random weights, none of them as a fresh start leaves it."""
    algo, encoder, sizes = CONFIGURATIONS[name]
    base = preset("quick", algo)
    agent = dataclasses.replace(base.agent, encoder=encoder, **sizes)
    params = base.world.params.replace(max_steps=float(_STEPS))
    world = dataclasses.replace(base.world, observation=ENCODERS[encoder].reads, pedestrians=3, params=params)
    run = Run(resolve(dataclasses.replace(base, agent=agent, world=world, out="runs/exported/none")))
    return run, random_actor(run, _SEED)


def random_actor(run, seed):
    """Actor parameters of a run, of which no bias is 0 and no scale 1."""
    rng = np.random.default_rng(seed)
    hyper = jax.tree.map(jnp.float32, run.config.hyper)
    state = jax.eval_shape(run.world.reset, jax.random.key(0), run.params)
    observation = jax.eval_shape(run.world.observe, state, run.params)
    learner = jax.eval_shape(run.agent.init, jax.random.key(0), observation, hyper)

    def draw(path, leaf):
        values, name = rng.normal(size=leaf.shape), jax.tree_util.keystr(path)
        if len(leaf.shape) > 1:  # large enough that what goes in decides what comes out
            return np.float32(2.0 * values / math.sqrt(math.prod(leaf.shape[:-1])))
        return np.float32(0.2 * values + ("scale" in name))

    return jax.tree_util.tree_map_with_path(draw, run.agent.policy(learner))


@functools.cache
def drawn(count):
    """`[count]` states, drawn from episodes of the first configuration: a state has no memory of who drove there."""
    episodes = Reference(*untrained(next(iter(CONFIGURATIONS)))).play(_SEED, math.ceil(count / 30))
    states = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(episode.states for episode in episodes))
    rows = np.random.default_rng(_SEED).choice(len(states.t), count, replace=False)
    return jax.tree.map(lambda leaf: leaf[rows], states)


def compare(name, options, console):
    """Compare `Policy` with the JAX policy in states drawn from episodes, and replay its outputs in every Python."""
    run, actor = untrained(name)
    states, voice = drawn(options.states), np.random.default_rng(_SEED).random(options.states) < 0.75
    with tempfile.TemporaryDirectory() as folder:
        bundle = pathlib.Path(folder) / "bundle"
        write_bundle(run, actor, bundle, origin_of(run, "last", {}, None))
        reference, found = Reference(run, actor), []
        with modules(bundle, "policy") as (policy,):
            exported = policy.Policy(str(bundle))
            for block in (slice(i, i + _BLOCK) for i in range(0, options.states, _BLOCK)):
                inputs, outputs = reference.both(
                    jax.tree.map(lambda leaf, block=block: leaf[block], states), voice[block]
                )
                found.append(difference(policy, exported, inputs, outputs))
        replays = [_replay(bundle, python) for python in (sys.executable, *options.pythons)]
    found = {"states": options.states} | {
        key: function(part[key] for part in found)
        for key, function in (("v", max), ("w", max), ("requests", sum), ("ties", sum))
    }
    console.print(f"{name}: {found}")
    return found | {"replays": replays}


def difference(module, policy, inputs, outputs):
    """Largest differences of an exported `Policy` from what the JAX policy computed, and how many requests differ where
    the likeliest two are not tied."""
    found = dict(zip(module.Decision._fields, map(np.asarray, policy.actor(*policy.tensors(inputs))), strict=True))
    best = np.sort(outputs["log_p"], axis=-1)
    tied = best[:, -1] - best[:, -2] < 1e-5 if best.shape[1] > 1 else np.zeros(len(best), bool)
    differs = found["request"] != outputs["request"]
    return {
        **{name: float(np.abs(found[name] - outputs[name])[~differs].max()) for name in ("v", "w")},
        "requests": int((differs & ~tied).sum()), "ties": int((differs & tied).sum()),
    }  # fmt: skip


def _replay(bundle, python):
    done = subprocess.run([python, "-B", bundle / "policy.py", "--selftest"], capture_output=True, text=True)
    if done.returncode:
        raise UserError(f"{python} fails: {(done.stderr.strip() or done.stdout).splitlines()[-1]}")
    error, where = re.search(r"error (\S+),.*\((.*)\)", done.stdout).groups()
    return {"error": float(error), "where": where}
