"""An encoder that knows of the laser only the nearest echo of six sectors, and its twin for robots without JAX.

jaxnav train --agent.encoder encoder.py:SECTORS
"""

import flax.linen as nn
import jax.numpy as jnp

from jaxnav.agents import Encoder, TorchTwin, dense_arrays, dialogue_features, known, own_features


class Sectors(nn.Module):
    scan: int
    talk: int

    @nn.compact
    def __call__(self, observation, heard):
        ranges = observation.scan.reshape(*observation.scan.shape[:-1], 6, -1).min(axis=-1)
        scan = nn.relu(nn.Dense(self.scan)(jnp.exp(-ranges)))
        talk = nn.relu(nn.Dense(self.talk)(dialogue_features(observation.dialogue, heard)))
        talk = (talk * known(observation)).sum(axis=-2)
        return jnp.concatenate([scan, talk, own_features(observation)], axis=-1)


TWIN = """
import torch
from encoders import OWN, constant, dialogue_factors, dialogue_features, own_features, somebody
from torch import nn


class Sectors(nn.Module):
    def __init__(self, sizes):
        super().__init__()
        widths = sizes["encoder_widths"]
        self.shape, self.requests = (-1, 6, sizes["beams"] // 6), sizes["request_kinds"]
        factors = dialogue_factors(self.requests)
        self.scan, self.talk = nn.Linear(6, widths["scan"]), nn.Linear(len(factors), widths["talk"])
        self.features = widths["scan"] + widths["talk"] + 15
        constant(self, "dialogue", factors)
        constant(self, "own", OWN)

    def forward(self, x, heard):
        ranges = x["scan"].reshape(self.shape).min(dim=-1)[0]
        scan = torch.relu(self.scan(torch.exp(-ranges)))
        talk = torch.relu(self.talk(dialogue_features(x, heard, self.requests) * self.dialogue))
        talk = (talk * somebody(x)).sum(dim=1)
        return torch.cat([scan, talk, own_features(x) * self.own], dim=-1)
"""


def arrays(params):
    return dense_arrays(params["Dense_0"], "scan") | dense_arrays(params["Dense_1"], "talk")


SECTORS = Encoder(
    "sectors", Sectors, ("scan", "dialogue"), {"scan": 32, "talk": 16}, TorchTwin("Sectors", arrays, TWIN)
)
