"""A trained actor's parameters as arrays of PyTorch: the names, shapes and orders of `Actor` in robot/policy.py."""

import numpy as np

from ..world import sensing

_ENCODER_PARTS = {
    "lidar": {"MLP_0": "scan", "MLP_1": "people"},
    "grid": {"MLP_0": "talk", "MLP_1": "both"},
}
_HEADS = ("mean_head", "request_head")
_WORDS = {"Dense_0": "hidden", "Dense_1": "message", "Dense_2": "reply"}


def torch_weights(actor, requests):
    """{name: float32 array} of the flax parameters ``actor`` of an `Actor`.

    requests: how many it chooses from; the head of requests is left out where that is 1, the standard deviations of the
    twist are left out always: both only serve training.
    """
    params = actor["params"]
    encoder = params["state_encoder"]
    grid = "Conv_0" in encoder
    weights = {}
    for part, name in _ENCODER_PARTS["grid" if grid else "lidar"].items():
        weights |= _mlp(encoder[part], f"encoder.{name}")
    if grid:
        weights |= _image(encoder)
    weights |= _mlp(params["body"], "body")
    for name in _HEADS if requests > 1 else _HEADS[:1]:
        weights |= _dense(params[name], name)
    for part, name in _WORDS.items() if "language_pre_net" in params else ():
        weights |= _dense(params["language_pre_net"][part], f"listener.{name}")
    return {name: np.ascontiguousarray(value, np.float32) for name, value in weights.items()}


def grid_tables(beams, robot_radius):
    """{name: array}: what the rasteriser in robot/policy.py looks up, so that no rounding moves a cell's edge."""
    tables = sensing.sensor_tables(beams)
    return {
        "grid.beam": tables.beam.astype(np.int32), "grid.nearest": tables.nearest, "grid.farthest": tables.farthest,
        "grid.robot": tables.distance <= np.float32(robot_radius), "grid.centres": sensing.cell_centres(),
        "grid.unknown": np.float32(sensing.UNKNOWN), "grid.robot_value": np.float32(sensing.ROBOT),
        "grid.body_squared": np.float32(sensing.MAP_BODY_RADIUS**2),
    }  # fmt: skip


def _dense(params, name):
    return {f"{name}.weight": np.asarray(params["kernel"]).T, f"{name}.bias": np.asarray(params["bias"])}


def _mlp(params, name):
    weights = {}
    for i in range(len(params) // 2):
        norm = params[f"LayerNorm_{i}"]
        weights |= _dense(params[f"Dense_{i}"], f"{name}.linear.{i}")
        weights |= {f"{name}.norm.{i}.weight": norm["scale"], f"{name}.norm.{i}.bias": norm["bias"]}
    return weights


def _image(encoder):
    """Convolutions as [out, in, 3, 3]; the layer behind them reads channels first instead of last."""
    weights, i, channels = {}, 0, 0
    while f"Conv_{i}" in encoder:
        convolution = encoder[f"Conv_{i}"]
        kernel = np.asarray(convolution["kernel"]).transpose(3, 2, 0, 1)
        name = f"encoder.convolutions.{i}"
        weights |= {f"{name}.weight": kernel, f"{name}.bias": np.asarray(convolution["bias"])}
        i, channels = i + 1, kernel.shape[0]
    kernel = np.asarray(encoder["Dense_0"]["kernel"])
    cells = round((kernel.shape[0] / channels) ** 0.5)
    image = kernel.reshape(cells, cells, channels, -1).transpose(3, 2, 0, 1).reshape(kernel.shape[1], -1)
    return weights | {"encoder.image.weight": image, "encoder.image.bias": np.asarray(encoder["Dense_0"]["bias"])}
