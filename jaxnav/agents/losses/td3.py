"""The losses of TD3 (Fujimoto et al. 2018, arXiv 1802.09477).

twist_of: (actor, observation) -> twist `[..., 2]`; q_of: (critic, observation, twist) -> Q `[2, ...]`.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import optax

from ..learner import Batch, Parameters

TwistOf = Callable[..., jax.Array]
QOf = Callable[..., jax.Array]


def target(
    key: jax.Array, twist_of: TwistOf, q_of: QOf, target_actor: Parameters, target_critic: Parameters, batch: Batch,
    hyper: Any,
) -> jax.Array:  # fmt: skip
    """y = r + discount^steps (1 - terminated) min_i Q_i(s', pi(s') + noise): equations 10 and 14.

    The noise is a Gaussian clipped at ``target_noise_clip``.
    """
    twist = twist_of(target_actor, batch.next_observation)
    noise = hyper.target_noise * jax.random.normal(key, twist.shape)
    noise = jnp.clip(noise, -hyper.target_noise_clip, hyper.target_noise_clip)
    q = q_of(target_critic, batch.next_observation, jnp.clip(twist + noise, -1.0, 1.0)).min(axis=0)
    return hyper.reward_scale * batch.reward + hyper.discount**batch.steps * (1.0 - batch.terminated) * q


def critic_loss(
    critic: Parameters, q_of: QOf, batch: Batch, wanted: jax.Array, huber_delta: float
) -> tuple[jax.Array, jax.Array]:
    """(Huber(Q_i(s, a) - y) summed over both critics, mean Q). wanted: y `[batch]`."""
    q = q_of(critic, batch.observation, batch.twist)
    return jnp.sum(jnp.mean(optax.huber_loss(q, wanted[None], delta=huber_delta), axis=1)), jnp.mean(q)


def actor_loss(actor: Parameters, twist_of: TwistOf, q_of: QOf, critic: Parameters, batch: Batch) -> jax.Array:
    """-Q_1(s, pi(s)), whose gradient is the deterministic policy gradient: equation 1."""
    return -jnp.mean(q_of(critic, batch.observation, twist_of(actor, batch.observation))[0])
