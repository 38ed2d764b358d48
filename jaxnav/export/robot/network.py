"""The network of a policy in PyTorch: a listener for sentences, an encoder, and the heads on top of it.

Written for Python 3.6 and torch 1.8.
"""

import importlib

import numpy as np
import torch
from encoders import MLP, constant, one_hot
from torch import nn


class Listener(nn.Module):
    """Words [..., D] -> probabilities of the message [..., 4] and of the reply [..., 3].

    The last number of a vector is the side that the sentence names, 1 right and -1 left: whether the robot is asked to
    go to that side or to the other is decided without knowing which it is. Who names no side asks for none.
    """

    def __init__(self, dimensions, width):
        super().__init__()
        self.scale = (dimensions - 1) ** 0.5
        self.hidden = nn.Linear(dimensions - 1, width)
        self.message = nn.Linear(width, 4)
        self.reply = nn.Linear(width, 3)
        constant(self, "mirror", [0, 1, 3, 2], np.int64)
        constant(self, "no_side", [0.0, 0.0, -1e9, -1e9])

    def forward(self, words):
        hidden = torch.relu(self.hidden(words[..., :-1] * self.scale))
        message = self.message(hidden)  # silence, stop, this side, the other side
        side = words[..., -1:]
        message = torch.where(side > 0, message, message.index_select(-1, self.mirror)) + self.no_side * (side == 0)
        return torch.softmax(message, dim=-1), torch.softmax(self.reply(hidden), dim=-1)


class Actor(nn.Module):
    """Tensors in the order of ``inputs``, each [B, ...], -> (v [B], w [B], request [B], log_p [B, requests],
    heard [B, K, 3], answer [B, K, 3])."""

    def __init__(self, sizes):
        super().__init__()
        self.inputs = list(sizes["inputs"])
        self.squash = sizes["squash"]
        self.requests, self.twists = sizes["requests"], sizes["twists"]
        constant(self, "no_answer", [1.0, 0.0, 0.0])
        constant(self, "scale", [0.5 * sizes["max_v"], sizes["max_w"]])
        constant(self, "slowest", [0.5 * sizes["max_v"], 0.0])
        if "words" in self.inputs:
            self.listener = Listener(sizes["dimensions"], sizes["listener_width"])
        # A file of the bundle: encoders.py, or the twin of an encoder that somebody added.
        self.encoder = getattr(importlib.import_module(sizes["encoder_module"]), sizes["encoder_class"])(sizes)
        self.body = MLP(self.encoder.features, sizes["widths"])
        self.mean_head = nn.Linear(sizes["widths"][-1], 2 * self.twists)
        if self.requests > 1:
            self.request_head = nn.Linear(sizes["widths"][-1], self.requests)

    def forward(self, *values):
        x = dict(zip(self.inputs, values))
        if "words" in x:
            heard, answer, x["spoken"] = self.listen(x["words"])
        else:
            heard = one_hot(x["message"], 1, 3)
            answer = self.no_answer.expand(heard.shape)
        features = self.body(self.encoder(x, heard))
        log_p = self.request_log_probabilities(features, x["may_request"] * x["voice"])
        request = torch.argmax(log_p, dim=-1)
        mean = self.mean_head(features)
        if self.twists > 1:  # each request has its twist
            chosen = one_hot(request, 0, self.requests).unsqueeze(-1)
            mean = (mean.view(-1, self.requests, 2) * chosen).sum(dim=1)
        twist = torch.tanh(mean) if self.squash == "tanh" else torch.clamp(mean, -1.0, 1.0)
        twist = twist * self.scale + self.slowest  # from [-1, 1] to m/s from 0, and rad/s
        return twist[:, 0], twist[:, 1], request, log_p, heard, answer

    def listen(self, words):
        """(heard [..., 3], answer [..., 3], spoken [...]) of words [..., D]; silence is the zero vector."""
        message, answer = self.listener(words)
        spoken = (words != 0).any(dim=-1).float()
        said = spoken.unsqueeze(-1)
        return message[..., 1:] * said, torch.where(said > 0, answer, self.no_answer), spoken

    def request_log_probabilities(self, features, counts):
        """[B, requests]; where a request would not count it is none for certain."""
        if self.requests == 1:
            return torch.zeros_like(features[:, :1])
        logits = self.request_head(features)
        others = logits[:, 1:].masked_fill((counts == 0).unsqueeze(-1), -1e9)
        return torch.log_softmax(torch.cat([logits[:, :1], others], dim=-1), dim=-1)
