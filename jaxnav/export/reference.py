"""The inputs and outputs of a run's JAX policy by the names of a contract: an exported one has to equal them."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..agents.distributions import request_log_probabilities
from ..agents.networks import message_codes, message_words
from ..training.rollout import Episode
from ..training.run import Run
from ..world.robot import twist_from_action
from ..world.types import REPLIES
from .contract import RAW_PARTS, TALK, raw_inputs

Arrays = dict[str, np.ndarray]

_EPISODES = 14  # of each scene: as many as are drawn into pictures, so that both share a compiled program


class Reference:
    """The policy ``actor`` of a run; people speak test phrases."""

    def __init__(self, run: Run, actor: Any) -> None:
        self._run, self._actor = run, actor
        self._raw = run.world.with_config(dataclasses.replace(run.world.config, observation=RAW_PARTS))
        self._both = jax.jit(lambda *given: (self._inputs(*given[1:]), self._outputs(*given)))

    def play(self, seed: int, episodes: int = _EPISODES) -> list[Episode]:
        """Episodes of the policy, ``episodes`` of each scene."""
        scenes = np.repeat(np.arange(len(self._run.world.scenes)), episodes)
        indices = np.tile(np.arange(episodes), len(self._run.world.scenes))
        return self._run.evaluator.record(self._run.policy_of(self._actor), seed, scenes, indices)

    def sample(self, episodes: Sequence[Episode], count: int, seed: int) -> tuple[Arrays, Arrays]:
        """(inputs, outputs) `[count, ...]` by name in ``count`` states drawn from ``episodes``.

        In one state of four no request may be spoken, as between two beats of a robot.
        """
        states = jax.tree.map(lambda *leaves: np.concatenate(leaves), *(episode.states for episode in episodes))
        rng = np.random.default_rng(seed)
        total = len(states.t)
        rows = np.sort(rng.choice(total, count, replace=count > total))
        return self.both(jax.tree.map(lambda leaf: leaf[rows], states), rng.random(count) < 0.75)

    def both(self, states: Any, voice: np.ndarray) -> tuple[Arrays, Arrays]:
        """(inputs, outputs) `[n, ...]` by name in states `[n]`; voice: `[n]` whether a request may be spoken."""
        vocabulary = self._run.agent.vocabulary("test")
        inputs, outputs = jax.device_get(self._both(self._actor, vocabulary, states, voice))
        return {name: inputs[name] for name in raw_inputs(self._run)}, outputs

    def _inputs(self, vocabulary: Any, states: Any, voice: Any) -> dict[str, Any]:
        seen = jax.vmap(self._raw.observe, in_axes=(0, None))(states, self._run.params)
        talk: Any = seen.dialogue
        given = {name: getattr(talk, field) for name, field in TALK.items()} | {"message": talk.message}
        given |= {"is_open": talk.is_open != 0, "pedestrian_first": talk.pedestrian_first != 0}
        given |= {name: getattr(seen, name) for name in ("scan", "pedestrians", "seen", "pose", "twist", "may_request")}
        given |= {"voice": voice, "spoken": talk.utterance != 0}
        if vocabulary is not None:
            given["words"] = message_words(talk, vocabulary)
        return given

    def _outputs(self, actor: Any, vocabulary: Any, states: Any, voice: Any) -> dict[str, Any]:
        agent = self._run.agent
        observation = jax.vmap(self._run.world.observe, in_axes=(0, None))(states, self._run.params)
        action = jax.vmap(agent.best_action, in_axes=(None, 0, 0, None))(actor, observation, voice, vocabulary)
        v, w = jax.vmap(twist_from_action, in_axes=(0, None))(action.twist, self._run.params)
        log_p, heard, answer = self._words(actor, vocabulary, observation, voice)
        return {"v": v, "w": w, "request": action.request, "log_p": log_p, "heard": heard, "answer": answer}

    def _words(self, actor: Any, vocabulary: Any, observation: Any, voice: Any) -> Any:
        agent: Any = self._run.agent
        heard = message_codes(observation.dialogue)
        answer = jnp.broadcast_to(jax.nn.one_hot(0, len(REPLIES)), (*heard.shape[:-1], len(REPLIES)))
        if vocabulary is not None:
            words = message_words(observation.dialogue, vocabulary)
            heard = agent.actor_network.apply(actor, words, method="listen")
            answer = jnp.exp(agent.understand(actor, words)[1])
        if agent.requests == 1:
            return jnp.zeros((heard.shape[0], 1)), heard, answer
        _, _, logits = agent.actor_network.apply(actor, observation, heard, method="act")
        return request_log_probabilities(logits, observation.may_request & voice), heard, answer
