"""The exported policy as ONNX and as TorchScript, each compared with golden.npz before it is kept."""

import importlib.util
import pathlib
import tempfile
import warnings

import numpy as np

from ..errors import UserError
from .modules import modules
from .verify import run_policy

OPSET = 13  # the newest that TensorRT 8.2 reads and PyTorch's exporter writes for it
ONNX_TOLERANCE = 1e-4
# In ONNX no output may be called like an input, and `request` is one: what was asked of each person before.
_OUTPUTS = ("v", "w", "chosen_request", "log_p", "heard", "answer")


def add_onnx(folder: str | pathlib.Path) -> float:
    """Write policy.onnx into a bundle. Returns the largest error against golden.npz.

    UserError: torch, onnx or onnxruntime is missing, or its outputs differ from the recorded ones.
    """
    _need("torch", "onnx", "onnxruntime")
    import onnxruntime
    import torch

    folder = pathlib.Path(folder)
    with modules(folder, "policy") as (robot,):
        policy = robot.Policy(str(folder))
        golden = robot.load_arrays(str(folder), policy.contract, "golden.npz")
    inputs = policy.tensors(golden)
    names = policy.actor.inputs
    target = folder / "policy.onnx"
    with tempfile.TemporaryDirectory() as scratch:
        path = pathlib.Path(scratch) / "policy.onnx"
        with warnings.catch_warnings():
            # The exporter that writes opset 13 is on its way out, and says so.
            warnings.simplefilter("ignore")
            torch.onnx.export(
                policy.actor, tuple(tensor[:1] for tensor in inputs), str(path), input_names=names,
                output_names=list(_OUTPUTS), opset_version=OPSET, dynamo=False, do_constant_folding=True,
            )  # fmt: skip
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        kept = {entry.name for entry in session.get_inputs()}
        rows = [
            session.run(_OUTPUTS, {n: t[i : i + 1].numpy() for n, t in zip(names, inputs, strict=True) if n in kept})
            for i in range(len(golden["out.v"]))
        ]
        outputs = [np.concatenate(part) for part in zip(*rows, strict=True)]
        error, requests = robot.golden_error(policy, golden, outputs)
        if not error <= ONNX_TOLERANCE or requests:
            raise UserError(
                f"the ONNX file differs by {error:.1e} and in {requests} requests from golden.npz (at most "
                f"{ONNX_TOLERANCE:g}): it was not written"
            )
        target.write_bytes(path.read_bytes())
    return error


def add_torchscript(folder: str | pathlib.Path, python: str | pathlib.Path) -> str:
    """Write policy.pt into a bundle by a Python with torch 1.10 or older. Returns its message. UserError: it failed."""
    folder = pathlib.Path(folder)
    try:
        return run_policy(folder, python, "--torchscript", folder.resolve() / "policy.pt")
    except UserError as error:
        said = str(error).removeprefix(f"{folder}: ")
        raise UserError(
            f"--torchscript {python}: {said} (it has to be a Python with numpy and torch 1.10 or older)"
        ) from None


def _need(*packages: str) -> None:
    missing = [name for name in packages if importlib.util.find_spec(name) is None]
    if missing:
        raise UserError(f'--onnx needs {", ".join(missing)}: pip install "jaxnav[export]"')
