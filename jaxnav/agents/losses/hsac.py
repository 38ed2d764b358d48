"""The losses of hybrid SAC (Delalleau et al. 2019, arXiv 1912.11077), which extends SAC (Haarnoja et al. 2018, arXiv
1812.05905, of which the numbers of equations are).

p_k is the probability of request k, u_k the twist that goes with it, pi(u_k) its density, n the number of requests.
"""

from typing import Any

import jax
import jax.numpy as jnp
import optax

from ...language.vocabulary import Vocabulary
from ...world.types import MESSAGES
from ..distributions import entropy
from ..hybrid import HybridNetworks
from ..learner import Batch, Parameters
from ..networks import message_codes

Temperatures = dict[str, jax.Array]
_PHRASES = 128  # of `message_loss`, an update
_SMOOTHING = 0.05  # of its labels: what a sentence means is never quite certain


def soft_value(
    q: jax.Array, log_density: jax.Array, log_p: jax.Array, counts: jax.Array, temperatures: Temperatures
) -> jax.Array:
    """V(s) `[...]` = sum_k p_k (Q_k - alpha_twist log pi(u_k)) + alpha_request (H(p) - log n).

    Equation 3 of SAC, summed over the requests as in hybrid SAC.

    Subtracting log n keeps the discrete bonus from paying for staying alive.

    q, log_p: `[..., requests]`; log_density: `[..., requests]`, or `[..., 1]` of one twist for all; counts: `[...]`
    whether a request counts; where it doesn't, n is 1.
    """
    bonus = jnp.where(counts, entropy(log_p) - jnp.log(log_p.shape[-1]), 0.0)
    expected = jnp.sum(jnp.exp(log_p) * (q - temperatures["twist"] * log_density), axis=-1)
    return expected + temperatures["request"] * bonus


def critic_loss(
    critic: Parameters, key: jax.Array, networks: HybridNetworks, target_critic: Parameters, actor: Parameters,
    batch: Batch, temperatures: Temperatures, hyper: Any, huber_delta: float,
) -> tuple[jax.Array, jax.Array]:  # fmt: skip
    """(Huber(Q_k(s, u) - y), mean Q) with y = r + discount^steps (1 - terminated) V(s'): equation 5 of SAC.

    V is that of the lesser of the two target critics. The policy of the next state is that of a robot told what was
    meant: an approximation, since phrases of the train split are understood soon and reading them again costs time.
    """
    after = batch.next_observation
    policy = networks.heard_policy(actor, after, message_codes(after.dialogue))
    twist, log_density, log_p = networks.sample(key, policy, after.may_request)
    q, next_q = networks.q(critic, batch.observation, batch.twist), networks.q(target_critic, after, twist)
    value = soft_value(next_q.min(axis=0), log_density, log_p, after.may_request, temperatures)
    target = hyper.reward_scale * batch.reward + (1.0 - batch.terminated) * hyper.discount**batch.steps * value
    target = jax.lax.stop_gradient(target)
    chosen = jnp.take_along_axis(q, batch.request[None, :, None], axis=-1)[..., 0]
    loss = optax.huber_loss(chosen, target[None], delta=huber_delta)
    return jnp.sum(jnp.mean(loss, axis=1)), jnp.mean(chosen)


def actor_loss(
    actor: Parameters, key: jax.Array, networks: HybridNetworks, critic: Parameters, batch: Batch,
    vocabulary: Vocabulary | None, temperatures: Temperatures, hyper: Any,
) -> tuple[jax.Array, dict[str, jax.Array]]:  # fmt: skip
    """(-V(s) + message_weight `message_loss`, entropies): equation 7 of SAC.

    Every u_k is reparameterised, and p is not detached.

    vocabulary: from which sentences are drawn; None where messages are heard as codes. The entropies are those of twist
    and request, beside the number of rows in which a request counted and the message loss.
    """
    key, key_phrases = jax.random.split(key)
    policy = networks.policy(actor, batch.observation, vocabulary)
    counts = batch.observation.may_request
    twist, log_density, log_p = networks.sample(key, policy, counts)
    q = networks.q(critic, batch.observation, twist).min(axis=0)
    loss = -jnp.mean(soft_value(q, log_density, log_p, counts, temperatures))
    counted = jnp.sum(counts)
    request_entropy = jnp.sum(jnp.where(counts, entropy(log_p), 0.0)) / jnp.maximum(counted, 1)
    meaning = jnp.float32(0.0) if vocabulary is None else message_loss(actor, key_phrases, networks, vocabulary)
    entropies = {
        "twist": -jnp.mean(jnp.sum(jnp.exp(log_p) * log_density, axis=-1)), "request": request_entropy,
        "counted": counted, "message_loss": meaning,
    }  # fmt: skip
    return loss + hyper.message_weight * meaning, jax.lax.stop_gradient(entropies)


def temperature_slope(
    entropies: dict[str, jax.Array], temperatures: Temperatures, requests: int, hyper: Any
) -> Temperatures:
    """alpha (H - target), the slope in log alpha of equation 18 of SAC: too little entropy raises the temperature.

    That of the request is 0 where no request counted.
    """
    targets = {
        "twist": hyper.target_entropy_twist, "request": hyper.target_entropy_request * jnp.log(requests),
    }  # fmt: skip
    slope = {name: temperatures[name] * (entropies[name] - targets[name]) for name in targets}
    return slope | {"request": jnp.where(entropies["counted"] > 0, slope["request"], 0.0)}


def message_loss(actor: Parameters, key: jax.Array, networks: HybridNetworks, vocabulary: Vocabulary) -> jax.Array:
    """Cross-entropy, with smoothed labels, of message and reply over phrases of the train split.

    Every message is as frequent as any other.
    """
    drawn, word = jax.random.bits(key, (2, _PHRASES), jnp.uint32)
    message = (drawn % len(MESSAGES)).astype(jnp.int32)
    index, word = vocabulary.phrase(message, word)
    meant = jnp.asarray(vocabulary.message)[index], jnp.asarray(vocabulary.reply)[index]
    understood = networks.understand(actor, vocabulary.vectors(index, word))
    losses = [
        -jnp.mean((1.0 - _SMOOTHING) * jnp.take_along_axis(p, label[:, None].astype(jnp.int32), axis=-1))
        - _SMOOTHING * jnp.mean(jnp.where(p > -1e8, p, 0.0))
        for p, label in zip(understood, meant, strict=True)
    ]
    return losses[0] + losses[1]
