"""One update of each learner, and the same in PyTorch: the same new parameters from the same weights and noise."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import torch
from torch.nn import functional as F

from jaxnav.agents.a2c import A2C, A2CConfig
from jaxnav.agents.hsac import HSAC, HSACConfig, HSACHyperparameters
from jaxnav.agents.ppo import PPO, PPOConfig, PPOHyperparameters
from jaxnav.agents.td3 import TD3, TD3Config, TD3Hyperparameters

from .torch_networks import (
    LR_SCALE,
    adam,
    both_critics,
    dense,
    descend,
    features,
    follow,
    gaussian,
    mlp,
    one_hot,
    random_learner,
    tensors,
    trunk,
)

SIZES = {"actor_widths": (8,), "critic_widths": (8, 8)}


def assert_same(learner, **parameters):
    for name, tree in parameters.items():
        assert jax.tree.structure(getattr(learner, name)) == jax.tree.structure(tree)
        for (path, leaf), mine in zip(
            jax.tree.leaves_with_path(getattr(learner, name)), jax.tree.leaves(tree), strict=True
        ):
            message = name + jax.tree_util.keystr(path)
            np.testing.assert_allclose(leaf, mine.detach().numpy(), rtol=0, atol=1e-5, err_msg=message)


def assert_moved(before, after, *names):
    """By far more than the tolerance."""
    for name in names:
        change = jax.tree.map(lambda a, b: float(np.abs(a - b).max()), getattr(before, name), getattr(after, name))
        assert max(jax.tree.leaves(change)) > 0.01, name


# HSAC

HSAC_HYPER = HSACHyperparameters(
    actor_lr=0.3, critic_lr=0.5, temperature_lr=0.2, discount=0.9, tau=0.3, average=0.2, reward_scale=1.5,
    target_entropy_twist=-1.0, target_entropy_request=0.5,
)  # fmt: skip


def judged(p, critic, seen, noise, alpha, config):
    """(soft value of each observation, mean entropy of the twist, mean entropy of the requests where they count)."""
    x = trunk(p, seen)
    mean, std = gaussian(p, x)
    mean, std, noise = (part.unflatten(-1, (-1, 2)) if part.ndim < 3 else part for part in (mean, std, noise))
    raw = mean + std * noise
    twist = torch.tanh(raw)
    log_density = (torch.distributions.Normal(mean, std).log_prob(raw) - torch.log(1 - twist**2)).sum(-1)
    log_p = F.log_softmax(dense(p["request_head"], x), dim=-1)
    value, entropy_twist, counts = 0.0, 0.0, seen.may_request.bool()
    for request in range(config.requests):
        own = request if config.heads == "per-request" else 0
        q = both_critics(critic, seen, twist[:, own])[:, :, request].amin(0)
        p_request = torch.where(counts, log_p[:, request].exp(), float(request == 0))
        surprise = torch.where(counts, log_p[:, request] + math.log(config.requests), 0.0)
        value = value + p_request * (q - alpha["twist"] * log_density[:, own] - alpha["request"] * surprise)
        entropy_twist = entropy_twist - (p_request * log_density[:, own]).mean()
    entropy_request = -(log_p.exp() * log_p).sum(-1)[counts].mean()
    return value, entropy_twist, entropy_request


def hsac_in_torch(learner, batch, noises, hyper, config):
    """The learner's parameters after an update."""
    names = ("actor", "averaged", "critic", "target_critic", "log_temperatures")
    actor, averaged, critic, target_critic, log_alpha = (
        tensors(getattr(learner, name)["params"] if name != "log_temperatures" else getattr(learner, name))
        for name in names
    )
    alpha = {name: leaf.exp().clone() for name, leaf in log_alpha.items()}
    batch = tensors(batch)
    optimisers = [
        adam(part, lr)
        for part, lr in ((critic, hyper.critic_lr), (actor, hyper.actor_lr), (log_alpha, hyper.temperature_lr))
    ]
    with torch.no_grad():
        after, _, _ = judged(actor, target_critic, batch.next_observation, noises[0], alpha, config)
        target = hyper.reward_scale * batch.reward + (1 - batch.terminated) * hyper.discount**batch.steps * after
    spoken = one_hot(batch.request, config.requests)
    predicted = (both_critics(critic, batch.observation, batch.twist) * spoken).sum(-1)
    descend(optimisers[0], sum(F.huber_loss(each, target, delta=config.huber_delta) for each in predicted))
    follow(target_critic, critic, hyper.tau)

    value, entropy_twist, entropy_request = judged(actor, critic, batch.observation, noises[1], alpha, config)
    descend(optimisers[1], -value.mean())
    follow(averaged, actor, hyper.average)
    missing = {
        "twist": entropy_twist - hyper.target_entropy_twist,
        "request": entropy_request - hyper.target_entropy_request * math.log(config.requests),
    }
    descend(optimisers[2], sum(log_alpha[name].exp() * missing[name].detach() for name in missing))
    networks = {"actor": actor, "averaged": averaged, "critic": critic, "target_critic": target_critic}
    return {name: {"params": tree} for name, tree in networks.items()} | {"log_temperatures": log_alpha}


@pytest.mark.parametrize("options", [{"heads": "shared"}, {"heads": "per-request", "requests": 2}])
def test_hsac(options, blank_observation, random_batch):
    agent = HSAC(HSACConfig(language="codes", **SIZES, **options))
    requests, size, rng = agent.config.requests, 12, np.random.default_rng(0)
    batch = random_batch(rng, (size,), requests=requests, steps=np.arange(size) % 3 + 1)
    before = random_learner(agent, blank_observation(), HSAC_HYPER, rng)
    before = before.replace(log_temperatures={"twist": np.float32(-1.2), "request": np.float32(-1.6)})

    @jax.jit
    def updated(key):
        """The learner after an update, and the noise of that."""
        key_critic, key_actor = jax.random.split(key)
        shape = (size, requests, 2) if agent.config.heads == "per-request" else (size, 2)
        noises = [jax.random.normal(key, shape) for key in (key_critic, jax.random.split(key_actor)[0])]
        return agent.update(key, before, batch, HSAC_HYPER, LR_SCALE)[0], noises

    after, noises = jax.device_get(updated(jax.random.key(2)))
    assert_moved(before, after, "actor", "averaged", "critic", "target_critic", "log_temperatures")
    assert_same(after, **hsac_in_torch(before, batch, tensors(noises), HSAC_HYPER, agent.config))


# TD3

# The actor's slope is small: its step is made as large as the others'.
TD3_HYPER = TD3Hyperparameters(
    actor_lr=20.0, critic_lr=0.5, discount=0.9, tau=0.3, target_noise=1.0, target_noise_clip=0.8, reward_scale=1.5
)


def steered(p, seen):
    return torch.tanh(dense(p["mean_head"], trunk(p, seen)))


def td3_in_torch(learner, batch, noise, hyper, config, moves):
    names = ("actor", "target_actor", "critic", "target_critic")
    actor, target_actor, critic, target_critic = (tensors(getattr(learner, name)["params"]) for name in names)
    batch = tensors(batch)
    optimisers = adam(critic, hyper.critic_lr), adam(actor, hyper.actor_lr)
    with torch.no_grad():
        blur = (hyper.target_noise * noise).clamp(-hyper.target_noise_clip, hyper.target_noise_clip)
        twist = (steered(target_actor, batch.next_observation) + blur).clamp(-1, 1)
        after = both_critics(target_critic, batch.next_observation, twist)[..., 0].amin(0)
        target = hyper.reward_scale * batch.reward + (1 - batch.terminated) * hyper.discount**batch.steps * after
    predicted = both_critics(critic, batch.observation, batch.twist)[..., 0]
    descend(optimisers[0], sum(F.huber_loss(each, target, delta=config.huber_delta) for each in predicted))
    if moves:
        twist = steered(actor, batch.observation)
        descend(optimisers[1], -both_critics(critic, batch.observation, twist)[0].mean())
        follow(target_actor, actor, hyper.tau)
        follow(target_critic, critic, hyper.tau)
    networks = (actor, target_actor, critic, target_critic)
    return {name: {"params": tree} for name, tree in zip(names, networks, strict=True)}


def test_td3(blank_observation, random_batch):
    agent, size, rng = TD3(TD3Config(actor_every=2, **SIZES)), 12, np.random.default_rng(0)
    batch = random_batch(rng, (size,), steps=np.arange(size) % 3 + 1)
    before = random_learner(agent, blank_observation(), TD3_HYPER, rng)

    @jax.jit
    def updated(key, step):
        noise = jax.random.normal(key, (size, 2))
        return agent.update(key, before, batch, TD3_HYPER, LR_SCALE, step)[0], noise

    for step in (3, 4):
        after, noise = jax.device_get(updated(jax.random.key(2), step))
        moved = ("actor", "target_actor", "critic", "target_critic") if step == 4 else ("critic",)
        assert_moved(before, after, *moved)
        assert_same(after, **td3_in_torch(before, batch, tensors(noise), TD3_HYPER, agent.config, step == 4))


# PPO and A2C

PPO_HYPER = PPOHyperparameters(
    actor_lr=0.05, critic_lr=0.2, discount=0.9, gae_lambda=0.8, clip=0.1, entropy_weight=0.1, reward_scale=1.5,
    average=0.2,
)  # fmt: skip


def value_of(p, seen):
    return dense(p["Dense_0"], mlp(p["MLP_0"], features(p["LidarEncoder_0"], seen)))[..., 0]


def advantages_of(batch, now, after, hyper):
    """`[horizon, episodes]`, back from the last step."""
    advantage, rows = torch.zeros_like(now[0]), []
    for t in reversed(range(len(now))):
        error = hyper.reward_scale * batch.reward[t] + hyper.discount * (1 - batch.terminated[t]) * after[t] - now[t]
        advantage = error + hyper.discount * hyper.gae_lambda * (1 - batch.ended[t]) * advantage
        rows.insert(0, advantage)
    return torch.stack(rows)


def ppo_in_torch(learner, batch, orders, hyper, clipped):
    actor, averaged, value = (tensors(getattr(learner, name)["params"]) for name in ("actor", "averaged", "value"))
    batch = tensors(batch)
    optimisers = adam(actor, hyper.actor_lr), adam(value, hyper.critic_lr)

    def distribution(seen):
        return torch.distributions.Normal(*gaussian(actor, trunk(actor, seen)))

    with torch.no_grad():
        now, after = (value_of(value, seen) for seen in (batch.observation, batch.next_observation))
        advantages = advantages_of(batch, now, after, hyper)
        returns = advantages + now
        before = distribution(batch.observation).log_prob(batch.twist).sum(-1)
    seen, twist, advantages, returns, before = jax.tree.map(
        lambda leaf: leaf.flatten(0, 1), (batch.observation, batch.twist, advantages, returns, before)
    )
    for rows in torch.tensor(np.array(orders)):
        part = jax.tree.map(lambda leaf, rows=rows: leaf[rows], seen)
        tried = distribution(part)
        log_density, advantage = tried.log_prob(twist[rows]).sum(-1), advantages[rows]
        if clipped:
            advantage = (advantage - advantage.mean()) / advantage.std(correction=0)
            ratio = torch.exp(log_density - before[rows])
            near = ratio.clamp(1 - hyper.clip, 1 + hyper.clip)
            objective = torch.minimum(ratio * advantage, near * advantage)
        else:
            objective = log_density * advantage
        actor_loss = -objective.mean() - hyper.entropy_weight * tried.entropy().sum(-1).mean()
        value_loss = 0.5 * F.mse_loss(value_of(value, part), returns[rows])
        descend(optimisers[0], actor_loss, hyper.max_gradient_norm)
        descend(optimisers[1], value_loss, hyper.max_gradient_norm)
        follow(averaged, actor, hyper.average)
    return {"actor": {"params": actor}, "averaged": {"params": averaged}, "value": {"params": value}}


HORIZON, EPISODES = 4, 6


@pytest.mark.parametrize(
    ("agent", "longest"),
    [
        (PPO(PPOConfig(horizon=HORIZON, epochs=1, minibatches=1, **SIZES)), 1e3),
        (PPO(PPOConfig(horizon=HORIZON, epochs=3, minibatches=2, **SIZES)), 0.5),
        (A2C(A2CConfig(horizon=HORIZON, **SIZES)), 1e3),
    ],
    ids=["ppo-once", "ppo-often", "a2c"],
)
def test_ppo_and_a2c(agent, longest, blank_observation, random_batch):
    hyper, rng = PPO_HYPER.replace(max_gradient_norm=longest), np.random.default_rng(0)
    batch = random_batch(rng, (HORIZON, EPISODES))
    traits = set(zip(batch.terminated.flat, batch.ended.flat, strict=True))
    assert traits == {(True, True), (False, True), (False, False)}
    before = random_learner(agent, blank_observation(), hyper, rng)

    @jax.jit
    def updated(key, batch):
        """The learner after an update, the twists that it has tried, and the rows of each minibatch."""
        tried = batch.replace(twist=agent.act(jax.random.key(3), before, batch.observation, hyper).twist)
        keys, count = jax.random.split(key, agent.epochs), HORIZON * EPISODES
        orders = jnp.concatenate([jax.random.permutation(one, count) for one in keys])
        after, _ = agent.update(key, before, tried, hyper, LR_SCALE)
        return after, tried, orders.reshape(-1, count // agent.minibatches)

    after, tried, orders = jax.device_get(updated(jax.random.key(2), batch))
    assert_moved(before, after, "actor", "averaged", "value")
    assert_same(after, **ppo_in_torch(before, tried, orders, hyper, clipped=not isinstance(agent, A2C)))
