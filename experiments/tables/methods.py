"""The robots of the tables' cells: what each method is, trained all seeds at once in a scene, played, and measured."""

import dataclasses
import json
from typing import NamedTuple

import jax
import numpy as np
from flax import struct

from experiments import study
from experiments.tables.report import RATES
from jaxnav import SUITES, OrcaRobot, Planner, StraightLine, preset
from jaxnav.agents.networks import message_codes
from jaxnav.errors import UserError
from jaxnav.statistics import measure
from jaxnav.training import EpisodeSummary, Evaluator, Policy, Population, make_agent, member, metrics, resolve

BLOCK = 500  # episodes played at once
REPORTED = 32_000  # environment steps between two lines of progress
DRAWN = 6  # episodes of each scene in the figure of a method's trajectories
TUNED = study.RESULTS / "tuning.json"

# Scenes whose robots share a compiled program: those of one number of pedestrians.
GROUPS = (SUITES["parity"], ("narrow", "doorway", "corner"), ("crossflow",))


class Method(NamedTuple):
    """A row's robot. algo: its learner; requests, hears: of its training; voice, told: whether it speaks when it is
    played, and whether it is told what is meant instead of hearing it said."""

    algo: str
    requests: int = 4
    hears: bool = True
    voice: bool = True
    told: bool = False

    @property
    def plays(self):
        """Name of the file of its plays."""
        return "told" if self.told else "played" if self.voice else "muted"

    @property
    def training(self):
        """Name of its training, which robots may share that differ only when they are played."""
        parts = [self.algo, f"{self.requests}-requests" if self.algo == "hsac" else "", "" if self.hears else "deaf"]
        return "-".join(part for part in parts if part)


MAIN = "HSAC"
METHODS = {
    MAIN: Method("hsac"),
    "HSAC, 2 requests": Method("hsac", requests=2),
    "HSAC that only hears": Method("hsac", requests=1),
    "HSAC without language": Method("hsac", requests=1, hears=False),
    "HSAC muted": Method("hsac", voice=False),
    "HSAC told what is meant": Method("hsac", told=True),
    "TD3": Method("td3"),
    "PPO": Method("ppo"),
    "A2C": Method("a2c"),
}
SCRIPTED = {
    "straight line": StraightLine(),
    "ORCA": OrcaRobot(),
    "planner": Planner(),
}


def tuned_hyperparameters(algo):
    """The hyperparameters that tuning chose for an algorithm; UserError: it was not tuned."""
    try:
        return json.loads(TUNED.read_text())["algorithms"][algo]["best"]
    except (OSError, ValueError, KeyError) as error:
        raise UserError(
            f"{TUNED} says nothing of {algo} ({error!r}): run python -m experiments.tables.tuning"
        ) from None


def configuration(method, scenes, env_steps):
    """The `RunConfig` of a method in scenes that share a program, with its tuned hyperparameters.

    Its seed and scene are those of nobody: `Population.start` is given them.
    """
    base = preset("quick", method.algo)
    world = dataclasses.replace(base.world.of_scenes(scenes), hearing=method.hears)
    agent = base.agent
    if method.algo == "hsac":
        agent = dataclasses.replace(agent, requests=method.requests, language="phrases" if method.hears else "codes")
    hyper = base.hyper.replace(**tuned_hyperparameters(method.algo))
    train = dataclasses.replace(base.train, total_steps=env_steps // base.train.episodes)
    return resolve(dataclasses.replace(base, world=world, agent=agent, hyper=hyper, train=train))


@struct.dataclass
class Told:
    """A player like a `Policy` that knows which message a sentence stands for."""

    policy: Policy

    def __call__(self, state, world, params):
        observation = world.observe(state, params)
        learner = self.policy.learner
        return learner.answer(self.policy.parameters, observation, message_codes(observation.dialogue))


class Playing:
    """Plays any player in any of some scenes, through one compiled program for each kind of player."""

    def __init__(self, world, params):
        self._evaluator = Evaluator(world, params, BLOCK)

    def __call__(self, player, scene, seed, episodes):
        """`EpisodeSummary` `[episodes]` of the scene with that index."""
        summary = self._evaluator.summaries(player, episodes, seed, scenes=[scene])
        return EpisodeSummary(*(leaf[0] for leaf in summary))

    def record(self, player, scene, seed):
        """The first `Episode`s that it plays there."""
        return self._evaluator.record(player, seed, np.full(DRAWN, scene), np.arange(DRAWN))


class Programs:
    """The programs of a method in a group of scenes, compiled once: one trains all seeds, one plays a seed."""

    def __init__(self, config, seeds, is_told=False, phrases="test"):
        self.agent = make_agent(config)
        self.population = Population(config, self.agent, seeds)
        self.playing = Playing(self.population.world, config.world.params)
        self._is_told, self._phrases = is_told, phrases
        self._like = None

    def player(self, parameters, voice):
        """The player with these parameters of one member."""
        policy = Policy(parameters, voice, learner=self.agent, world=self.population.world)
        return Told(policy) if self._is_told else policy.hearing(self._phrases)

    def play(self, policies, method, scene, seed, episodes):
        """`EpisodeSummary` `[seeds, episodes]` of policies `[seeds]` in the scene with that index."""
        plays = [
            self.playing(self.player(member(policies, i), method.voice), scene, seed, episodes)
            for i in range(self.population.members)
        ]
        return EpisodeSummary(*(np.stack(leaves) for leaves in zip(*plays, strict=True)))

    def policies(self, folder):
        """The policies `[seeds]` that a training left behind."""
        if self._like is None:
            population = self.population
            start = jax.eval_shape(lambda: population.start(range(population.members), population.config.hyper))
            self._like = jax.tree.structure(self.agent.policy(start.learner))
        stored = np.load(folder / "policies.npz")
        return jax.tree.unflatten(self._like, [stored[name] for name in sorted(stored.files)])


def reporter(console, name, episodes):
    """A function (steps of all episodes, metrics `[members]`) that now and then prints how a training goes."""

    def show(steps, metrics):
        if steps * episodes % REPORTED == 0:
            rates = metrics["episodes_arrived"].sum(1) / np.maximum(metrics["episodes_ended"].sum(1), 1)
            text = " ".join(f"{rate:.2f}" for rate in rates)
            console.print(f"{name}: {steps * episodes // 1000}k steps, success while learning {text}", soft_wrap=True)

    return show


def measures(summary):
    """`metrics` of plays `[seeds, episodes]`, of each seed, as `measure` gives them."""
    seeds, episodes = summary.arrived.shape
    found = [metrics(EpisodeSummary(*(leaf[i] for leaf in summary))) for i in range(seeds)]
    rates = {name: measure([one[name] for one in found], episodes) for name in RATES}
    return rates | {name: measure([one[name] for one in found]) for name in ("comfort", "steps", "min_distance")}
