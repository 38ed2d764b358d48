"""TD3: a deterministic twist, twin critics, delayed actor (Fujimoto et al. 2018). It steers and is silent."""

import dataclasses
from typing import Any

import chex
import jax
import jax.numpy as jnp
import optax
from flax import struct

from ..world import Action
from .learner import ADAM, Batch, ReplayConfig, descend, silent
from .networks import Actor, TwinCritic, message_codes


@dataclasses.dataclass(frozen=True)
class TD3Config(ReplayConfig):
    __doc__ = ReplayConfig.__doc__

    actor_every: int = 2


@struct.dataclass
class TD3Hyperparameters:
    """Floats of the learner, leaves for ``vmap``.

    Attributes:
        actor_lr: learning rate of the actor.
        critic_lr: learning rate of the critics.
        final_lr: fraction of these rates that is left at the end of training; they decay linearly.
        discount: of the return, a step.
        tau: share of the critics and the actor that enters the target ones at each update of the actor.
        exploration_noise: standard deviation of the noise on twists that are tried.
        target_noise: standard deviation of the noise on twists that the target critics judge.
        target_noise_clip: the most of that noise.
        reward_scale: factor on rewards.
    """

    actor_lr: float = 1e-3
    critic_lr: float = 1e-3
    final_lr: float = 1.0
    discount: float = 0.97
    tau: float = 0.02
    exploration_noise: float = 0.2
    target_noise: float = 0.2
    target_noise_clip: float = 0.5
    reward_scale: float = 0.01


@struct.dataclass
class TD3State:
    """Parameters of actor and critics, of their targets, and the state of their optimisers."""

    actor: chex.ArrayTree
    critic: chex.ArrayTree
    target_actor: chex.ArrayTree
    target_critic: chex.ArrayTree
    actor_optimiser: chex.ArrayTree
    critic_optimiser: chex.ArrayTree


class TD3:
    """The bundle of pure functions: `init`, `act`, `update`. Messages are heard as codes."""

    replays, horizon = True, 1

    def __init__(self, config: TD3Config = TD3Config()):
        self.config = config
        self.actor_network = Actor(config.encoder, config.actor_widths)
        self.critic_network = TwinCritic(config.encoder, config.critic_widths, outputs=1)

    def init(self, key, observation, hyper: TD3Hyperparameters) -> TD3State:
        """Fresh parameters for observations shaped like ``observation`` (one, without a batch axis)."""
        del hyper
        key_actor, key_critic = jax.random.split(key)
        heard = message_codes(observation.dialogue)
        actor = self.actor_network.init(key_actor, observation, heard, method="steer")
        critic = self.critic_network.init(key_critic, observation, heard, jnp.zeros(2))
        return TD3State(
            actor=actor,
            critic=critic,
            target_actor=jax.tree.map(jnp.copy, actor),
            target_critic=jax.tree.map(jnp.copy, critic),
            actor_optimiser=ADAM.init(actor),
            critic_optimiser=ADAM.init(critic),
        )

    def policy(self, learner: TD3State) -> chex.ArrayTree:
        """The actor that is evaluated."""
        return learner.target_actor

    def act(self, key, learner: TD3State, observation, hyper: TD3Hyperparameters) -> Action:
        """The actor's twist with noise, for each observation `[..., ...]`, and no request."""
        twist = self._twist(learner.actor, observation)
        twist = jnp.clip(twist + hyper.exploration_noise * jax.random.normal(key, twist.shape), -1.0, 1.0)
        return silent(twist)

    def best_action(self, actor, observation, voice=True, vocabulary=None) -> Action:
        """The actor's twist; it has no voice, and hears codes, whatever the ``vocabulary``."""
        del voice, vocabulary
        return silent(self._twist(actor, observation))

    def vocabulary(self, split):
        """None: this agent hears codes."""
        del split

    def update(self, key, state: TD3State, batch: Batch, hyper: TD3Hyperparameters, lr_scale=1.0, step=0):
        """One step on the critics, and on the actor every so often. Returns (state, metrics).

        lr_scale: multiplies every rate; step: how many updates came before, for the delay.
        """
        target = self._target(key, state, batch, hyper)
        (critic_loss, q), gradient = jax.value_and_grad(self._critic_loss, has_aux=True)(state.critic, batch, target)
        change, critic_optimiser = ADAM.update(gradient, state.critic_optimiser)
        critic = descend(state.critic, change, hyper.critic_lr * lr_scale)
        state = state.replace(critic=critic, critic_optimiser=critic_optimiser)

        def update_actor(state):
            loss, gradient = jax.value_and_grad(self._actor_loss)(state.actor, state.critic, batch)
            change, actor_optimiser = ADAM.update(gradient, state.actor_optimiser)
            actor = descend(state.actor, change, hyper.actor_lr * lr_scale)
            new = state.replace(
                actor=actor,
                actor_optimiser=actor_optimiser,
                target_actor=optax.incremental_update(actor, state.target_actor, hyper.tau),
                target_critic=optax.incremental_update(state.critic, state.target_critic, hyper.tau),
            )
            return new, self.config.actor_every * loss  # the mean over updates is then that of those that had one

        state, actor_loss = jax.lax.cond(
            step % self.config.actor_every == 0, update_actor, lambda state: (state, jnp.float32(0.0)), state
        )
        return state, {"critic_loss": critic_loss, "q": q, "actor_loss": actor_loss}

    def _twist(self, actor, observation):
        mean: Any = self.actor_network.apply(actor, observation, message_codes(observation.dialogue), method="steer")
        return jnp.tanh(mean)

    def _q(self, critic, observation, twist) -> Any:
        """Q `[2, ...]`."""
        q: Any = self.critic_network.apply(critic, observation, message_codes(observation.dialogue), twist)
        return q[..., 0]

    def _target(self, key, state, batch, hyper):
        """r + discount (1 - terminated) min Q(s', pi(s') + noise)."""
        twist = self._twist(state.target_actor, batch.next_observation)
        noise = hyper.target_noise * jax.random.normal(key, twist.shape)
        noise = jnp.clip(noise, -hyper.target_noise_clip, hyper.target_noise_clip)
        q = self._q(state.target_critic, batch.next_observation, jnp.clip(twist + noise, -1.0, 1.0)).min(axis=0)
        return hyper.reward_scale * batch.reward + hyper.discount**batch.steps * (1.0 - batch.terminated) * q

    def _critic_loss(self, critic, batch, target):
        q = self._q(critic, batch.observation, batch.twist)
        return jnp.sum(jnp.mean(optax.huber_loss(q, target[None], delta=self.config.huber_delta), axis=1)), jnp.mean(q)

    def _actor_loss(self, actor, critic, batch):
        """-Q of the first critic."""
        return -jnp.mean(self._q(critic, batch.observation, self._twist(actor, batch.observation))[0])
