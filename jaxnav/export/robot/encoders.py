"""The encoders of a policy in PyTorch: observations -> features, the first part of the network in network.py.

Every function takes ``x``, a dict of float32 tensors with a batch axis in front, by the names of contract.json; K is
the number of people. Written for Python 3.6 and torch 1.8.
"""

import numpy as np
import torch
from torch import nn


def constant(module, name, values, dtype=np.float32):
    """Give a module numbers that are no weights."""
    module.register_buffer(name, torch.from_numpy(np.array(values, dtype)), persistent=False)


class MLP(nn.Module):
    """Linear, layer normalisation, ReLU for each width."""

    def __init__(self, inputs, widths):
        super().__init__()
        sizes = [inputs] + list(widths)
        self.linear = nn.ModuleList(nn.Linear(a, b) for a, b in zip(sizes, sizes[1:]))
        self.norm = nn.ModuleList(nn.LayerNorm(width, eps=1e-6) for width in widths)

    def forward(self, x):
        for linear, norm in zip(self.linear, self.norm):
            x = torch.relu(norm(linear(x)))
        return x


def norm(vector):
    """[..., 1] length of [..., 2], never quite 0."""
    return torch.sqrt((vector * vector).sum(dim=-1, keepdim=True) + 1e-12)


def one_hot(index, first, count):
    """[..., count] 1 where the index is first, first + 1, ..."""
    values = torch.arange(first, first + count, dtype=index.dtype, device=index.device)
    return (index.unsqueeze(-1) == values).float()


SECTORS = 12  # of the scan
# The factors that make the features below be of order 1.
PERSON = [1, 1 / 4, 1 / 4, 1, 1, 1 / 2, 2, 2]
DIALOGUE = [1, 1, 0.1, 0.1]  # and 1 for each one that follows
OWN = [1 / 6, 1 / 6, 1, 1, 1, 1, 1] + 2 * [1 / 6, 1 / 6, 1] + [1, 1]


def dialogue_factors(requests):
    """The factor of each of `dialogue_features`."""
    return DIALOGUE + (3 + requests + 3) * [1]


def person_features(x, heard, requests):
    """[B, K, 18 + requests] of each person: place, velocity, and the dialogue; PERSON, `dialogue_factors`."""
    place, velocity = x["pedestrians"][..., :2], x["pedestrians"][..., 2:]
    distance = norm(place)
    motion = [x["seen"].unsqueeze(-1), place, place / distance, torch.clamp(distance, max=2.0), velocity]
    return torch.cat(motion + [dialogue_features(x, heard, requests)], dim=-1)


def dialogue_features(x, heard, requests):
    """[B, K, 10 + requests] of the dialogue with each person. requests: how many there are, none included."""
    state = [x["is_open"], x["pedestrian_first"], x["message_age"], x["request_age"]]
    state = torch.clamp(torch.stack(state, dim=-1), max=10.0)
    return torch.cat([state, heard, one_hot(x["asked"], 0, requests), one_hot(x["reply"], 0, 3)], dim=-1)


def approach_features(x):
    """[B, K, 12] when and how near each person comes, for four ways in which the robot may go on; 0 of the unseen.

    As now, at 0.6 m/s ahead, at 0.6 m/s to the goal, and standing.
    """
    place, velocity = x["pedestrians"][..., None, :2], x["pedestrians"][..., None, 2:]
    goal = x["pose"][:, 2, :2]
    goal = goal / torch.sqrt(torch.clamp((goal * goal).sum(dim=-1, keepdim=True), min=1e-12))
    standing = torch.zeros_like(goal)
    ahead = standing + torch.tensor([0.6, 0.0], device=goal.device)
    now = torch.cat([x["twist"][:, :1], standing[:, 1:]], dim=-1)
    own = torch.stack([now, ahead, 0.6 * goal, standing], dim=1).unsqueeze(1)
    relative = velocity - own  # [B, K, 4, 2]
    speed_squared = torch.clamp((relative * relative).sum(dim=-1, keepdim=True), min=1e-12)
    time = torch.clamp(-(place * relative).sum(dim=-1, keepdim=True) / speed_squared, 0.0, 6.0)
    closest = place + time * relative
    distance = torch.sqrt(torch.clamp((closest * closest).sum(dim=-1, keepdim=True), min=1e-12))
    danger = torch.exp(-0.5 * time - 3.0 * torch.clamp(distance - 0.3, min=0.0))
    features = torch.cat([time / 4, torch.clamp(distance, max=2.0) / 2, danger], dim=-1)
    return features.flatten(2) * x["seen"].unsqueeze(-1)


def own_features(x):
    """[B, 15] of the robot: its goal now and at the two times before, how far it has turned, and its twist; OWN."""
    goal, turned, past = x["pose"][:, 2, :2], x["pose"][:, 2, 2:], x["pose"][:, :2].flatten(1)
    distance = norm(goal)
    near = torch.clamp(distance, max=1.0)
    return torch.cat([goal, goal / distance, near, turned, x["may_request"].unsqueeze(-1), past, x["twist"]], dim=-1)


def somebody(x):
    """[B, K, 1] 1 for people who are seen or in dialogue, 0 for rows of nobody."""
    signs = x["is_open"] + x["asked"] + x["spoken"]
    if "seen" in x:
        signs = signs + x["seen"]
    return (signs > 0).float().unsqueeze(-1)


class LidarEncoder(nn.Module):
    """Scan, people, dialogue and pose -> features; people are embedded one by one and summed."""

    more_inputs = 0  # of a person

    def __init__(self, sizes):
        super().__init__()
        beams, sectors = sizes["beams"], min(SECTORS, sizes["beams"])
        widths = sizes["encoder_widths"]
        # The beams of each sector; the first sectors have one more where they can't be divided, the others one twice.
        parts = np.array_split(np.arange(beams), sectors)
        parts = [np.pad(part, (0, len(parts[0]) - len(part)), mode="edge") for part in parts]
        constant(self, "sectors", np.concatenate(parts), np.int64)
        self.shape = (-1, sectors, len(parts[0]))
        constant(self, "rates", beams * [-0.5] + sectors * [-4.0])
        self.requests = sizes["request_kinds"]
        person = PERSON + dialogue_factors(self.requests)
        constant(self, "person", person)
        constant(self, "own", OWN)
        self.scan = MLP(beams + sectors, [widths["scan"]])
        self.people = MLP(len(person) + self.more_inputs, [widths["pedestrians"]])
        self.features = widths["scan"] + widths["pedestrians"] + 15

    def forward(self, x, heard):
        nearest = x["scan"].index_select(-1, self.sectors).view(self.shape).min(dim=-1)[0]
        scan = self.scan(torch.exp(torch.cat([x["scan"], nearest], dim=-1) * self.rates))
        people = (self.people(self.describe(x, heard)) * somebody(x)).sum(dim=1)
        return torch.cat([scan, people, own_features(x) * self.own], dim=-1)

    def describe(self, x, heard):
        """[B, K, inputs] of each person."""
        return person_features(x, heard, self.requests) * self.person


class LidarApproachEncoder(LidarEncoder):
    """The same, told when and how near each person comes."""

    more_inputs = 12

    def describe(self, x, heard):
        return torch.cat([super().describe(x, heard), approach_features(x)], dim=-1)


class GridEncoder(nn.Module):
    """Two grid maps as an image, pose and dialogue -> features: the network of the paper."""

    def __init__(self, sizes):
        super().__init__()
        widths = sizes["encoder_widths"]
        channels = [4] + [widths["channels_%d" % i] for i in (1, 2, 3)]
        self.convolutions = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in zip(channels, channels[1:]))
        cells = sizes["cells"] // 8
        self.features = widths["features"]
        self.image = nn.Linear(cells * cells * channels[-1], self.features)
        self.requests = sizes["request_kinds"]
        factors = dialogue_factors(self.requests)
        self.talk = MLP(len(factors), [widths["dialogue"]])
        self.both = MLP(self.features + 15 + widths["dialogue"], [self.features])
        constant(self, "dialogue", factors)
        constant(self, "own", OWN)

    def forward(self, x, heard):
        image = x["maps"]
        for convolution in self.convolutions:
            image = torch.relu(nn.functional.max_pool2d(convolution(image), 2))
        image = torch.relu(self.image(image.flatten(1)))
        talk = (self.talk(dialogue_features(x, heard, self.requests) * self.dialogue) * somebody(x)).sum(dim=1)
        return self.both(torch.cat([image, own_features(x) * self.own, talk], dim=-1))
