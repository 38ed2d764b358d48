"""Networks and optimisers of the learners once more, in PyTorch and in double precision; for `test_torch.py`.

Parameters keep the names that flax gives them. Adam, layer normalisation and clipping are PyTorch's own.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import torch
from torch.nn import functional as F

# Adam in the midst of training: its step is then about proportional to the gradient, and an error shows in any of it.
COUNT, SQUARES = 1000, 0.01
LR_SCALE = 0.7


def random_learner(agent, observation, hyper, rng):
    """The state of a learner with random parameters, targets and averages apart from them, after many steps."""
    shapes = jax.eval_shape(agent.init, jax.random.key(0), observation, hyper)
    learner = jax.tree.map(
        lambda leaf: np.float32(rng.normal(size=leaf.shape) / math.sqrt(leaf.shape[0] if leaf.ndim == 2 else 4.0)),
        shapes,
    )

    def seasoned(optimiser):
        moments = {"mu": jnp.zeros(optimiser.mu.shape), "nu": jnp.full(optimiser.nu.shape, SQUARES)}
        return optimiser._replace(count=jnp.int32(COUNT), **moments)

    return learner.replace(
        **{name: seasoned(leaf) for name, leaf in vars(shapes).items() if name.endswith("optimiser")}
    )


def adam(parameters, lr):
    """PyTorch's Adam after as many."""
    leaves = jax.tree.leaves(parameters)
    optimiser = torch.optim.Adam(leaves, lr=lr * LR_SCALE)
    for leaf in leaves:
        leaf.requires_grad_(True)
        moments = {"exp_avg": torch.zeros_like(leaf), "exp_avg_sq": torch.full_like(leaf, SQUARES)}
        optimiser.state[leaf] = {"step": torch.tensor(float(COUNT)), **moments}
    return optimiser


def descend(optimiser, loss, longest=math.inf):
    """A step down the slope of ``loss``, of that norm at most, in the parameters of this optimiser alone."""
    leaves = optimiser.param_groups[0]["params"]
    for leaf, slope in zip(leaves, torch.autograd.grad(loss, leaves), strict=True):
        leaf.grad = slope
    torch.nn.utils.clip_grad_norm_(leaves, longest)
    optimiser.step()


def follow(target, source, share):
    """``target`` moves by that share of the way to ``source``."""
    for old, new in zip(jax.tree.leaves(target), jax.tree.leaves(source), strict=True):
        old += share * (new.detach() - old)


def tensors(tree):
    """A copy of arrays in double precision, whatever they are of."""
    return jax.tree.map(lambda leaf: torch.tensor(np.asarray(leaf, np.float64)), tree)


def dense(p, x):
    return x @ p["kernel"] + p["bias"]


def mlp(p, x):
    for i in range(len(p) // 2):
        scale = p[f"LayerNorm_{i}"]
        x = F.relu(F.layer_norm(dense(p[f"Dense_{i}"], x), scale["bias"].shape, scale["scale"], scale["bias"], 1e-6))
    return x


def one_hot(index, size):
    return F.one_hot(index.long(), size).double()


def features(p, seen):
    """What the encoder makes of an observation whose messages are heard as codes."""
    nearest = torch.stack([part.amin(-1) for part in seen.scan.tensor_split(12, dim=-1)], dim=-1)
    scan = mlp(p["MLP_0"], torch.cat([torch.exp(-seen.scan / 2), torch.exp(-4 * nearest)], dim=-1))

    place, velocity, talk = seen.pedestrians[..., :2], seen.pedestrians[..., 2:], seen.dialogue
    distance = place.norm(dim=-1, keepdim=True).clamp(min=1e-6)
    somebody = seen.seen + talk.is_open + talk.utterance + talk.message + talk.request > 0
    ages = torch.stack([talk.message_age, talk.request_age], dim=-1).clamp(max=10) / 10
    people = [
        seen.seen[..., None], place / 4, place / distance, distance.clamp(max=2) / 2, 2 * velocity,
        torch.stack([talk.is_open, talk.pedestrian_first], dim=-1), ages,
        one_hot(talk.message, 4)[..., 1:], one_hot(talk.request, 4), one_hot(talk.reply, 3),
    ]  # fmt: skip
    crowd = (mlp(p["MLP_1"], torch.cat(people, dim=-1)) * somebody[..., None]).sum(dim=-2)

    goal, turned = seen.pose[..., 2, :2], seen.pose[..., 2, 2:]
    away = goal.norm(dim=-1, keepdim=True)
    past = (seen.pose[..., :2, :] / torch.tensor([6.0, 6.0, 1.0])).flatten(-2)
    own = [goal / 6, goal / away, away.clamp(max=1), turned, seen.may_request[..., None], past, seen.twist]
    return torch.cat([scan, crowd, *own], dim=-1)


def gaussian(p, x):
    """Mean and standard deviation of heads on ``x``."""
    return dense(p["mean_head"], x), torch.exp(-5 + 2.5 * (torch.tanh(dense(p["log_std_head"], x)) + 1))


def both_critics(p, seen, twist):
    """`[2, batch, outputs]`."""
    x = torch.cat([features(p["LidarEncoder_0"], seen), twist], dim=-1)
    return torch.stack([dense(p[f"Dense_{i}"], mlp(p[f"MLP_{i}"], x)) for i in range(2)])


def trunk(p, seen):
    return mlp(p["body"], features(p["state_encoder"], seen))
