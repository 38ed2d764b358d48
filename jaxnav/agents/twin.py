"""The PyTorch twin of an encoder: the source that travels in a bundle, and how flax parameters become its arrays."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class TorchTwin:
    """How a robot without JAX computes an encoder.

    Attributes:
        module: name of an `nn.Module` class of the source. It is made with the sizes of a bundle's network, a dict:
            encoder_widths holds its own by name; beams, nearest and cells are the world's. It sets ``features``, and
            maps (x, heard `[B, K, 3]`) to `[B, features]`; x is a dict of float32 tensors `[B, ...]`, by the names of
            the contract.
        arrays: flax parameters of the encoder -> the state dict of that class, numpy arrays by name.
        source: text of a file of Python 3.6, numpy and torch 1.8, which may import from a bundle's encoders.py; without
            it the class is one of encoders.py.
    """

    module: str
    arrays: Callable[[Any], dict[str, np.ndarray]]
    source: str = ""


def dense_arrays(params: Any, name: str) -> dict[str, np.ndarray]:
    """`nn.Linear` of that name for the parameters of a flax ``Dense``."""
    return {f"{name}.weight": np.asarray(params["kernel"]).T, f"{name}.bias": np.asarray(params["bias"])}


def mlp_arrays(params: Any, name: str) -> dict[str, np.ndarray]:
    """``MLP`` of a bundle's encoders.py, of that name, for the parameters of a flax `MLP`."""
    arrays = {}
    for i in range(len(params) // 2):
        norm = params[f"LayerNorm_{i}"]
        arrays |= dense_arrays(params[f"Dense_{i}"], f"{name}.linear.{i}")
        arrays |= {f"{name}.norm.{i}.weight": norm["scale"], f"{name}.norm.{i}.bias": norm["bias"]}
    return arrays


def lidar_arrays(params: Any) -> dict[str, np.ndarray]:
    """Those of the lidar encoders."""
    return mlp_arrays(params["MLP_0"], "scan") | mlp_arrays(params["MLP_1"], "people")


def grid_arrays(params: Any) -> dict[str, np.ndarray]:
    """Those of the grid encoders: kernels `[out, in, 3, 3]`; the layer behind them reads channels first, not last."""
    arrays, i, channels = mlp_arrays(params["MLP_0"], "talk") | mlp_arrays(params["MLP_1"], "both"), 0, 0
    while f"Conv_{i}" in params:
        kernel = np.asarray(params[f"Conv_{i}"]["kernel"]).transpose(3, 2, 0, 1)
        bias = np.asarray(params[f"Conv_{i}"]["bias"])
        arrays |= {f"convolutions.{i}.weight": kernel, f"convolutions.{i}.bias": bias}
        i, channels = i + 1, kernel.shape[0]
    kernel = np.asarray(params["Dense_0"]["kernel"])
    cells = round((kernel.shape[0] / channels) ** 0.5)
    image = kernel.reshape(cells, cells, channels, -1).transpose(3, 2, 0, 1).reshape(kernel.shape[1], -1)
    return arrays | {"image.weight": image, "image.bias": np.asarray(params["Dense_0"]["bias"])}
