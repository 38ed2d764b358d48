"""A trained policy in plain PyTorch (1.8 or newer) and numpy: raw sensor numbers in, m/s, rad/s and a request out.

    python3 policy.py --selftest                  replays golden.npz, the recorded inputs and outputs
    python3 policy.py --torchscript policy.pt     writes the network as TorchScript (torch 1.10 or older)

`Policy` loads the folder in which this file lies and is all that most programs need; `Navigator` in navigator.py drives
a robot with it; network.py holds the network itself. contract.json lists every input and output with shape, unit and
range. Written for Python 3.6: this file runs where nothing newer does.
"""

import argparse
import collections
import os
import sys
import warnings

import numpy as np
import torch
from bundle import HERE, BundleError, load_arrays, load_contract, read_file
from network import Actor

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
