"""Encoders: how an `Observation` becomes features. Each is a record of `ENCODERS`; `register_encoder` adds one."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp

from .. import plugins
from ..errors import UserError
from ..world.config import OBSERVATION_PARTS
from ..world.types import Observation
from .features import approach_features, dialogue_features, known, own_features, part, pedestrian_features
from .layers import MLP
from .twin import TorchTwin, grid_arrays, lidar_arrays

SECTORS = 12
PARTS = (
    "scan",
    "pedestrians",
    "dialogue",
    "sensor_map",
    "pedestrian_map",
)  # of an observation, that a world may observe


@dataclasses.dataclass(frozen=True, eq=False)
class Encoder:
    """How an observation becomes features.

    Attributes:
        name: by which `agent.encoder` chooses it.
        module: makes the flax module from its widths by name. Called with (observation, S_c `[..., K, 3]`), the module
            returns `[..., features]`; it takes any number of axes in front.
        reads: parts of an observation that the world has to observe: names of `OBSERVATION_PARTS`. Pose, twist and
            may_request are always there.
        widths: its sizes with their defaults, by name and in the order of `agent.encoder_widths`.
        twin: how a robot computes it without JAX; without one a policy can be trained, but not exported.
    """

    name: str
    module: Callable[..., nn.Module]
    reads: tuple[str, ...]
    widths: Mapping[str, int] = dataclasses.field(default_factory=dict)
    twin: TorchTwin | None = None

    def sizes(self, widths: tuple[int, ...] = ()) -> dict[str, int]:
        """Widths by name: those given, in order, or the defaults. ValueError: their number, or one below 1."""
        if not widths:
            return dict(self.widths)
        if len(widths) != len(self.widths) or any(width < 1 for width in widths):
            names = ", ".join(self.widths) or "none"
            raise ValueError(
                f"agent.encoder_widths is {' '.join(map(str, widths))}: the encoder {self.name} has {len(self.widths)} "
                f"({names}), each at least 1"
            )
        return dict(zip(self.widths, widths, strict=True))

    def build(self, widths: tuple[int, ...] = ()) -> nn.Module:
        """The flax module."""
        return self.module(**self.sizes(widths))


class LidarEncoder(nn.Module):
    """Scan, pedestrians, dialogue, S_c and pose -> `[..., features]`, for any number of pedestrians.

    The scan enters as exp(-range / 2), and once more as exp(-4 range) of the nearest echo in each of twelve sectors:
    the first says what is where, the second tells 0.2 m from 0.3 m. Pedestrians are embedded one by one and summed;
    with ``approach`` their `approach_features` enter, too.
    """

    scan: int = 64
    pedestrians: int = 64
    approach: bool = False

    @nn.compact
    def __call__(self, observation: Observation, heard: jax.Array) -> jax.Array:
        ranges = part(observation, "scan")
        sectors = jnp.array_split(ranges, min(SECTORS, ranges.shape[-1]), axis=-1)
        nearest = jnp.stack([sector.min(axis=-1) for sector in sectors], axis=-1)
        echoes = jnp.concatenate([jnp.exp(-0.5 * ranges), jnp.exp(-4.0 * nearest)], axis=-1)
        scan = MLP([self.scan])(echoes)
        people = pedestrian_features(observation, heard)
        if self.approach:
            people = jnp.concatenate([people, approach_features(observation)], axis=-1)
        people = MLP([self.pedestrians])(people)
        people = (people * known(observation)).sum(axis=-2)
        return jnp.concatenate([scan, people, own_features(observation)], axis=-1)


class Convolution(nn.Module):
    """``nn.Conv(channels, (3, 3))`` as one matrix product of the nine neighbours of every cell.

    Training is a loop, and inside a loop XLA runs convolutions on a CPU two orders of magnitude slower.
    """

    channels: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        *lead, height, width, channels = x.shape
        kernel = self.param("kernel", nn.initializers.lecun_normal(), (3, 3, channels, self.channels))
        bias = self.param("bias", nn.initializers.zeros, (self.channels,))
        padded = jnp.pad(x, [(0, 0)] * len(lead) + [(1, 1), (1, 1), (0, 0)])
        shifted = [padded[..., i : i + height, j : j + width, :] for i in range(3) for j in range(3)]
        return jnp.concatenate(shifted, axis=-1) @ kernel.reshape(9 * channels, self.channels) + bias


class GridEncoder(nn.Module):
    """Img_PreNet and State_PreNet of the paper (docs/learner.md): grid maps, pose, dialogue and S_c -> `[..., 512]`.

    Maps `[4, 48, 48]` -> 3 x (convolution 3 x 3, ReLU, 2 x 2 maximum) -> 512, beside the rest -> 512, each with ReLU.
    The maximum is taken over a reshaped array: on a CPU its gradient is ten times as fast as that of `nn.max_pool`.
    With ``frozen`` Img_PreNet, its last layer included, keeps its random weights, as in the authors' release.
    """

    channels_1: int = 64
    channels_2: int = 128
    channels_3: int = 256
    features: int = 512
    dialogue: int = 64
    frozen: bool = False

    @nn.compact
    def __call__(self, observation: Observation, heard: jax.Array) -> jax.Array:
        sensor_map = part(observation, "sensor_map")[..., None, :, :]
        maps = jnp.concatenate([sensor_map, part(observation, "pedestrian_map")], axis=-3)
        lead = maps.shape[:-3]
        x = jnp.moveaxis(maps.reshape(-1, *maps.shape[-3:]), 1, -1)
        for i, channels in enumerate((self.channels_1, self.channels_2, self.channels_3)):
            x = Convolution(channels, name=f"Conv_{i}")(x)
            batch, height, width, _ = x.shape
            # ReLU after the maximum: the same numbers, a quarter of the work.
            x = nn.relu(x.reshape(batch, height // 2, 2, width // 2, 2, channels).max(axis=(2, 4)))
        image = nn.relu(nn.Dense(self.features)(x.reshape(x.shape[0], -1))).reshape(*lead, self.features)
        if self.frozen:
            image = jax.lax.stop_gradient(image)
        talk = MLP([self.dialogue])(dialogue_features(part(observation, "dialogue"), heard))
        talk = (talk * known(observation)).sum(axis=-2)
        x = jnp.concatenate([image, own_features(observation), talk], axis=-1)
        return MLP([self.features])(x)


LIDAR_PARTS = ("scan", "pedestrians", "dialogue")
GRID_PARTS = ("sensor_map", "pedestrian_map", "dialogue")
_LIDAR_WIDTHS = {"scan": 64, "pedestrians": 64}
_GRID_WIDTHS = {"channels_1": 64, "channels_2": 128, "channels_3": 256, "features": 512, "dialogue": 64}
ENCODERS: dict[str, Encoder] = {}
plugins.recognise("encoder", lambda value: isinstance(value, Encoder))


def register_encoder(encoder: Encoder) -> Encoder:
    """Make an encoder known by its name, and return it.

    UserError: the name is taken by another, a part that it reads is unknown, its widths are no whole numbers, or its
    module takes something else than (observation, heard).
    """
    if ENCODERS.get(encoder.name, encoder) is not encoder:
        raise UserError(f"the encoder {encoder.name!r} is registered already: choose another name")
    ENCODERS[encoder.name] = _checked(encoder)
    return encoder


def find_encoder(name: str) -> Encoder:
    """The encoder of that name, registered or file.py:NAME. ValueError: there is none; UserError: it can't be used."""
    if plugins.is_file(name):
        return _checked(plugins.load_part(name, "encoder"))
    if name not in ENCODERS:
        raise ValueError(f"agent.encoder {name!r} is unknown: choose from {', '.join(ENCODERS)}, or give file.py:NAME")
    return ENCODERS[name]


def _checked(encoder):
    said = f"the encoder {encoder.name!r}"
    unknown = [name for name in encoder.reads if name not in OBSERVATION_PARTS]
    if unknown:
        raise UserError(f"{said} reads {unknown[0]!r}, which is no part: choose from {', '.join(OBSERVATION_PARTS)}")
    if not all(isinstance(width, int) and width > 0 for width in encoder.widths.values()):
        raise UserError(f"{said} has widths {dict(encoder.widths)}: give whole numbers of at least 1")
    try:
        module: Any = encoder.build()
    except TypeError as error:
        raise UserError(f"{said} can't be made of its widths ({error}): its module has to take each by name") from None
    try:
        inspect.signature(module).bind(None, None)
    except (TypeError, ValueError):
        raise UserError(
            f"{said} can't be called with (observation, heard): its __call__ has to take these two"
        ) from None
    return encoder


def encode(module: Any, observation: Observation, heard: jax.Array) -> jax.Array:
    """Features `[..., features]` of a module of an encoder. UserError: it returns another shape."""
    features = module(observation, heard)
    lead, shape = jnp.shape(observation.may_request), getattr(features, "shape", None)
    if not shape or shape[:-1] != lead:
        found = type(features).__name__ if shape is None else f"shape {list(shape)}"
        wanted = str([*lead, "features"]).replace("'", "")
        raise UserError(f"agent.encoder: {type(module).__name__} returns {found}: it has to return {wanted}")
    return features


_FOR_LIDAR, _FOR_GRID = (LIDAR_PARTS, _LIDAR_WIDTHS), (GRID_PARTS, _GRID_WIDTHS)
_LIDAR, _APPROACH = TorchTwin("LidarEncoder", lidar_arrays), TorchTwin("LidarApproachEncoder", lidar_arrays)
_GRID = TorchTwin("GridEncoder", grid_arrays)
register_encoder(Encoder("lidar", LidarEncoder, *_FOR_LIDAR, _LIDAR))
register_encoder(Encoder("lidar-approach", functools.partial(LidarEncoder, approach=True), *_FOR_LIDAR, _APPROACH))
register_encoder(Encoder("grid", GridEncoder, *_FOR_GRID, _GRID))
register_encoder(Encoder("grid-frozen", functools.partial(GridEncoder, frozen=True), *_FOR_GRID, _GRID))
