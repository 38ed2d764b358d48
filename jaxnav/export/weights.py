"""A trained actor's parameters as arrays of PyTorch: the names, shapes and orders of `Actor` in robot/network.py."""

from typing import Any

import numpy as np

from ..agents.encoders import Encoder
from ..agents.twin import dense_arrays, mlp_arrays
from ..errors import UserError
from ..world import sensing

_HEADS = ("mean_head", "request_head")
_WORDS = {"Dense_0": "hidden", "Dense_1": "message", "Dense_2": "reply"}


def torch_weights(actor: Any, requests: int, encoder: Encoder) -> dict[str, np.ndarray]:
    """{name: float32 array} of the flax parameters ``actor`` of an `Actor` with that encoder.

    requests: how many it chooses from; the head of requests is left out where that is 1, the standard deviations of the
    twist are left out always: both only serve training.
    UserError: the encoder's twin can't make its arrays of the parameters.
    """
    params, twin = actor["params"], encoder.twin
    assert twin is not None  # as checked before
    try:
        weights = {f"encoder.{name}": array for name, array in twin.arrays(params["state_encoder"]).items()}
    except Exception as error:
        raise UserError(
            f"agent.encoder {encoder.name}: the arrays of its twin can't be made ({type(error).__name__}: {error}): "
            "mend TorchTwin.arrays"
        ) from error
    weights |= mlp_arrays(params["body"], "body")
    for name in _HEADS if requests > 1 else _HEADS[:1]:
        weights |= dense_arrays(params[name], name)
    for part, name in _WORDS.items() if "language_pre_net" in params else ():
        weights |= dense_arrays(params["language_pre_net"][part], f"listener.{name}")
    return {name: np.ascontiguousarray(value, np.float32) for name, value in weights.items()}


def grid_tables(beams: int, robot_radius: float) -> dict[str, Any]:
    """{name: array} for the rasteriser in robot/policy.py, so that no rounding moves a cell's edge."""
    tables: Any = sensing.sensor_tables(beams)
    return {
        "grid.beam": tables.beam.astype(np.int32), "grid.nearest": tables.nearest, "grid.farthest": tables.farthest,
        "grid.robot": tables.distance <= np.float32(robot_radius), "grid.centres": sensing.cell_centres(),
        "grid.unknown": np.float32(sensing.UNKNOWN), "grid.robot_value": np.float32(sensing.ROBOT),
        "grid.body_squared": np.float32(sensing.MAP_BODY_RADIUS**2),
    }  # fmt: skip
