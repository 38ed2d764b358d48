"""A trained policy in plain PyTorch (1.8 or newer) and numpy: raw sensor numbers in, m/s, rad/s and a request out.

    python3 policy.py --selftest                  replays golden.npz, the recorded inputs and outputs
    python3 policy.py --torchscript policy.pt     writes the network as TorchScript (torch 1.10 or older)

`Policy` loads the folder in which this file lies and is all that most programs need; `Navigator` in navigator.py drives
a robot with it. `Actor` is the network itself. contract.json lists every input and output with shape, unit and range.
Written for Python 3.6: this file runs where nothing newer does.
"""

import argparse
import collections
import os
import sys
import warnings

import numpy as np
import torch
from bundle import HERE, BundleError, load_arrays, load_contract, read_file
from torch import nn

TOLERANCE = 1e-5  # the most by which outputs may differ from the recorded ones
Decision = collections.namedtuple("Decision", "v w request log_p heard answer")
Decision.__doc__ = """The policy's decision.

v:       m/s.
w:       rad/s, to the left.
request: what it asks of people, 0 nothing.
log_p:   [requests] log-probabilities of the requests.
heard:   [K, 3] probabilities that a person asked the robot to stop, to go right, to go left.
answer:  [K, 3] probabilities that a person answers nothing, agrees, refuses.
"""


# The network. Every function takes ``x``, a dict of float32 tensors with a batch axis in front; K people.


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


# What the features below are multiplied by, so that they are of order 1.
DIALOGUE = [1, 1, 0.1, 0.1] + 10 * [1]
PERSON = [1, 1 / 4, 1 / 4, 1, 1, 1 / 2, 2, 2] + DIALOGUE
OWN = [1 / 6, 1 / 6, 1, 1, 1, 1, 1] + 2 * [1 / 6, 1 / 6, 1] + [1, 1]


def person_features(x, heard):
    """[B, K, 22] of each person: place, velocity, and the dialogue; PERSON."""
    place, velocity = x["pedestrians"][..., :2], x["pedestrians"][..., 2:]
    distance = norm(place)
    motion = [x["seen"].unsqueeze(-1), place, place / distance, torch.clamp(distance, max=2.0), velocity]
    return torch.cat(motion + [dialogue_features(x, heard)], dim=-1)


def dialogue_features(x, heard):
    """[B, K, 14] of the dialogue with each person; DIALOGUE."""
    state = [x["is_open"], x["pedestrian_first"], x["message_age"], x["request_age"]]
    state = torch.clamp(torch.stack(state, dim=-1), max=10.0)
    return torch.cat([state, heard, one_hot(x["request"], 0, 4), one_hot(x["reply"], 0, 3)], dim=-1)


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
    signs = x["is_open"] + x["request"] + x["spoken"]
    if "seen" in x:
        signs = signs + x["seen"]
    return (signs > 0).float().unsqueeze(-1)


class LidarEncoder(nn.Module):
    """Scan, people, dialogue and pose -> features; people are embedded one by one and summed."""

    def __init__(self, sizes):
        super().__init__()
        beams, sectors = sizes["beams"], min(sizes["sectors"], sizes["beams"])
        # The beams of each sector; the first sectors have one more where they can't be divided, the others one twice.
        parts = np.array_split(np.arange(beams), sectors)
        parts = [np.pad(part, (0, len(parts[0]) - len(part)), mode="edge") for part in parts]
        constant(self, "sectors", np.concatenate(parts), np.int64)
        self.shape = (-1, sectors, len(parts[0]))
        constant(self, "rates", beams * [-0.5] + sectors * [-4.0])
        constant(self, "person", PERSON)
        constant(self, "own", OWN)
        self.approach = sizes["encoder"] == "lidar-approach"
        self.scan = MLP(beams + sectors, [sizes["scan_width"]])
        self.people = MLP(34 if self.approach else 22, [sizes["pedestrian_width"]])
        self.features = sizes["scan_width"] + sizes["pedestrian_width"] + 15

    def forward(self, x, heard):
        nearest = x["scan"].index_select(-1, self.sectors).view(self.shape).min(dim=-1)[0]
        scan = self.scan(torch.exp(torch.cat([x["scan"], nearest], dim=-1) * self.rates))
        people = person_features(x, heard) * self.person
        if self.approach:
            people = torch.cat([people, approach_features(x)], dim=-1)
        people = (self.people(people) * somebody(x)).sum(dim=1)
        return torch.cat([scan, people, own_features(x) * self.own], dim=-1)


class GridEncoder(nn.Module):
    """Two grid maps as an image, pose and dialogue -> features: the network of the paper."""

    def __init__(self, sizes):
        super().__init__()
        channels = [4] + list(sizes["channels"])
        self.convolutions = nn.ModuleList(nn.Conv2d(a, b, 3, padding=1) for a, b in zip(channels, channels[1:]))
        cells = sizes["cells"] // 2 ** len(sizes["channels"])
        self.image = nn.Linear(cells * cells * channels[-1], sizes["width"])
        self.talk = MLP(14, [sizes["dialogue_width"]])
        self.both = MLP(sizes["width"] + 15 + sizes["dialogue_width"], [sizes["width"]])
        self.features = sizes["width"]
        constant(self, "dialogue", DIALOGUE)
        constant(self, "own", OWN)

    def forward(self, x, heard):
        image = x["maps"]
        for convolution in self.convolutions:
            image = torch.relu(nn.functional.max_pool2d(convolution(image), 2))
        image = torch.relu(self.image(image.flatten(1)))
        talk = (self.talk(dialogue_features(x, heard) * self.dialogue) * somebody(x)).sum(dim=1)
        return self.both(torch.cat([image, own_features(x) * self.own, talk], dim=-1))


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
    """The network: tensors in the order of ``inputs``, each [B, ...], -> (v [B], w [B], request [B],
    log_p [B, requests], heard [B, K, 3], answer [B, K, 3])."""

    def __init__(self, sizes):
        super().__init__()
        self.inputs = list(sizes["inputs"])
        self.squash, self.mean_tanh = sizes["squash"], sizes["mean_tanh"]
        self.requests, self.twists = sizes["requests"], sizes["twists"]
        constant(self, "no_answer", [1.0, 0.0, 0.0])
        constant(self, "scale", [0.5 * sizes["max_v"], sizes["max_w"]])
        constant(self, "slowest", [0.5 * sizes["max_v"], 0.0])
        if "words" in self.inputs:
            self.listener = Listener(sizes["dimensions"], sizes["listener_width"])
        self.encoder = (GridEncoder if "maps" in self.inputs else LidarEncoder)(sizes)
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
        if self.mean_tanh:
            mean = torch.tanh(mean)
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


class Rasteriser:
    """Scan and people -> maps [4, cells, cells]: what the laser sees, and where people are with their velocity."""

    def __init__(self, tables):
        # Which beam looks at each cell in front of the robot, and from which range to which it ends there.
        self.beam, self.nearest, self.farthest = (tables["grid." + name] for name in ("beam", "nearest", "farthest"))
        self.robot, self.centres = tables["grid.robot"], tables["grid.centres"]
        self.values = {key: np.float32(tables["grid." + key]) for key in ("unknown", "robot_value", "body_squared")}

    def __call__(self, scan, pedestrians, seen):
        cells = len(self.centres)
        maps = np.zeros((4, cells, cells), np.float32)
        ahead = len(self.beam)
        ranges = scan[self.beam]
        maps[0] = self.values["unknown"]
        maps[0, :ahead] = np.where(ranges < self.nearest, maps[0, :ahead], (ranges > self.farthest).astype(np.float32))
        maps[0][self.robot] = self.values["robot_value"]
        for (x, y, vx, vy), visible in zip(pedestrians[::-1], seen[::-1]):  # the nearest is drawn last, on top
            if visible and abs(x) <= 3 and abs(y) <= 3:
                squared = ((self.centres - x) ** 2)[:, None] + ((self.centres - y) ** 2)[None, :]
                maps[1:, squared <= self.values["body_squared"]] = np.array([[1.0], [vx], [vy]], np.float32)
        return maps


class Policy:
    """The policy of a bundle: `act` decides from an observation. BundleError: the bundle can't be used."""

    def __init__(self, bundle=HERE):
        self.contract = load_contract(bundle)
        self.inputs = collections.OrderedDict((entry["name"], entry) for entry in self.contract["inputs"])
        network = self.contract["network"]
        arrays = load_arrays(bundle, self.contract, "weights.npz")
        tables = {name: arrays.pop(name) for name in list(arrays) if name.startswith("grid.")}
        self.actor = Actor(network).eval().requires_grad_(False)
        try:
            self.actor.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
        except RuntimeError as error:
            raise BundleError("weights.npz does not fit this policy.py: use the one of the bundle (%s)" % error)
        self.rasterise = Rasteriser(tables) if "maps" in network["inputs"] else None
        # Traced, the network takes half the time: what it costs is its many small operations, not their numbers.
        example = self.tensors({name: np.zeros([1] + entry["shape"]) for name, entry in self.inputs.items()})
        with warnings.catch_warnings():  # newer versions of torch would rather see another way
            warnings.simplefilter("ignore")
            self._traced = torch.jit.trace(self.actor, tuple(example), check_trace=False)
        for _ in range(3):  # the first calls optimise, and would be slow on the way
            self._traced(*example)

    def act(self, observation):
        """`Decision` for a dict of the contract's inputs. ValueError names an input that is missing or wrong."""
        tensors = self.tensors({name: self.check(name, observation)[None] for name in self.inputs})
        v, w, request, log_p, heard, answer = (tensor.numpy()[0] for tensor in self._traced(*tensors))
        return Decision(float(v), float(w), int(request), log_p, heard, answer)

    def understand(self, words):
        """(heard [3], answer [3]) of one sentence's vector [D]: see `Decision`."""
        heard, answer, _ = self.actor.listen(torch.from_numpy(np.array(words, np.float32)))
        return heard.numpy(), answer.numpy()

    def tensors(self, batch):
        """What `Actor` takes, of a dict of arrays [B, ...] of the contract's inputs."""
        if self.rasterise is not None:
            people = zip(batch["scan"], batch["pedestrians"], batch["seen"] != 0)
            batch = dict(batch, maps=np.stack([self.rasterise(*one) for one in people]))
        return [torch.from_numpy(np.array(batch[name], np.float32)) for name in self.actor.inputs]

    def check(self, name, observation):
        """An input as a float32 array. ValueError: missing, of another type or shape, not finite, out of range."""
        entry = self.inputs[name]
        if name not in observation:
            raise ValueError("%s is missing: give %s" % (name, ", ".join(self.inputs)))
        value = np.asarray(observation[name])
        if value.dtype.kind not in "fiub":
            raise ValueError("%s has dtype %s: give %s" % (name, value.dtype, entry["dtype"]))
        if list(value.shape) != entry["shape"]:
            raise ValueError("%s has shape %s: give %s" % (name, list(value.shape), entry["shape"]))
        if value.dtype.kind == "f" and entry["dtype"] != "float32":
            raise ValueError("%s has dtype %s: give %s" % (name, value.dtype, entry["dtype"]))
        value = value.astype(np.float32)
        least, most = value.min(), value.max()
        if not (least >= entry["range"][0] and most <= entry["range"][1]):  # so that nan fails too
            raise ValueError("%s has %g to %g: give %g to %g" % ((name, least, most) + tuple(entry["range"])))
        return value


def golden_error(policy, golden, outputs=None):
    """(largest error, number of differing requests) of outputs, by default the policy's own, from the recorded ones."""
    if outputs is None:
        outputs = [tensor.numpy() for tensor in policy.actor(*policy.tensors(golden))]
    found = dict(zip(Decision._fields, outputs))
    # A request that can't be chosen has -1e9 or so, in which only its size means something. numpy's max keeps a nan.
    error = np.max([
        np.abs(np.maximum(found[name], -1e6) - np.maximum(golden["out." + name], -1e6)).max()
        for name in Decision._fields
        if name != "request"
    ])  # fmt: skip
    best = np.sort(golden["out.log_p"], axis=-1)[:, ::-1]
    tied = best[:, 0] - best[:, 1] < TOLERANCE if best.shape[1] > 1 else np.zeros(len(best), bool)
    return float(error), int(((found["request"] != golden["out.request"]) & ~tied).sum())


def selftest(bundle=HERE):
    """Check every file and replay golden.npz. Returns what to print. BundleError: it is not as it was written."""
    policy = Policy(bundle)
    for name in policy.contract["files"]:
        read_file(bundle, policy.contract, name)
    golden = load_arrays(bundle, policy.contract, "golden.npz")
    batch, requests = golden_error(policy, golden)
    # The same once more, one by one, through all checks: what a robot calls.
    count = len(golden["out.v"])
    each = [policy.act({name: golden[name][i] for name in policy.inputs}) for i in range(count)]
    twists = np.array([[decision.v, decision.w] for decision in each])
    error = float(np.max([batch, np.abs(twists - np.stack([golden["out.v"], golden["out.w"]], axis=1)).max()]))
    where = "python %s, torch %s, numpy %s" % (sys.version.split()[0], torch.__version__, np.__version__)
    said = "%d recorded inputs: largest error %.1e, %d requests differ (%s)" % (count, error, requests, where)
    if not error <= TOLERANCE or requests:
        raise BundleError("selftest FAILED, %s; at most %g is right: do not drive with it" % (said, TOLERANCE))
    return "selftest passed, " + said


def torchscript(path, bundle=HERE):
    """Write the network as TorchScript, checked against golden.npz first. BundleError: this torch is too new for it."""
    version = tuple(int(part) for part in torch.__version__.split("+")[0].split(".")[:2])
    if version > (1, 10):
        raise BundleError(
            "torch %s writes TorchScript that the robot's can't read: run this where torch is 1.10 or older"
            % torch.__version__
        )
    if os.path.exists(path):
        raise BundleError("%s is there already: give another name" % path)
    policy = Policy(bundle)
    golden = load_arrays(bundle, policy.contract, "golden.npz")
    inputs = policy.tensors(golden)
    traced = torch.jit.trace(policy.actor, tuple(tensor[:1] for tensor in inputs))
    single = [traced(*(tensor[i : i + 1] for tensor in inputs)) for i in range(len(golden["out.v"]))]
    error, requests = golden_error(policy, golden, [np.concatenate([t.numpy() for t in part]) for part in zip(*single)])
    if not error <= TOLERANCE or requests:
        raise BundleError(
            "TorchScript differs by %.1e and in %d requests from golden.npz: not written" % (error, requests)
        )
    try:
        traced.save(path)
    except (OSError, RuntimeError) as error:
        raise BundleError("%s can't be written (%s): give another name" % (path, str(error).splitlines()[0]))
    return "%s written by torch %s, largest error %.1e" % (path, torch.__version__, error)


def main():
    parser = argparse.ArgumentParser(description="Check a policy on this machine, or write it as TorchScript.")
    parser.add_argument("--selftest", action="store_true", help="replay golden.npz and print the largest error")
    parser.add_argument("--torchscript", metavar="FILE", help="write the network as TorchScript (torch <= 1.10)")
    options = parser.parse_args()
    if not options.selftest and not options.torchscript:
        parser.error("give --selftest or --torchscript FILE")
    torch.set_num_threads(1)  # more only get in each other's way
    try:
        if options.selftest:
            print(selftest())
        if options.torchscript:
            print(torchscript(options.torchscript))
    except BundleError as error:
        print("error: %s" % error, file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
