"""What a run is: every value with its default, and the presets."""

import dataclasses
from typing import Any

import numpy as np

from .. import maps
from ..agents import (
    A2C,
    HSAC,
    LEARNERS,
    PPO,
    TD3,
    A2CConfig,
    A2CHyperparameters,
    HSACConfig,
    HSACHyperparameters,
    Learner,
    PPOConfig,
    PPOHyperparameters,
    RolloutConfig,
    TD3Config,
    TD3Hyperparameters,
)
from ..agents.encoders import GRID_PARTS
from ..errors import UserError
from ..world import SCENES, SUITES, Params, World, WorldConfig, body_reach, check_params, default_params
from ..world.people import RECORDING
from .dataclass_json import from_json
from .randomise import check_ranges


@dataclasses.dataclass(frozen=True)
class WorldSettings(WorldConfig):
    __doc__ = (
        f"{WorldConfig.__doc__}    params: every float of the world.\n"
        "        randomise: name, lowest and highest of fields of params that each training episode draws anew.\n    "
    )

    params: Params = dataclasses.field(default_factory=Params)
    randomise: tuple[tuple[str, float, float], ...] = ()

    def world(self) -> World:
        """The `World` of these sizes; a scene that is called like a file is the map that the file describes."""
        fields = dataclasses.fields(WorldConfig)
        scan_range, margin = float(self.params.scan_range), max(maps.MARGIN, float(body_reach(self.params)))
        own = [maps.load(name, scan_range=scan_range, margin=margin) for name in self.scenes if is_map(name)]
        return World(WorldConfig(**{field.name: getattr(self, field.name) for field in fields}), own)

    def of_scenes(self, names) -> "WorldSettings":
        """The same with these scenes, as many people as they take, and, unless said otherwise, the people there.

        ValueError: people of different suites.
        """
        crowds = [SCENES[name].crowd or (1, 1) for name in names if name in SCENES]
        pedestrians = max(self.pedestrians, *(most for _, most in crowds), 1)
        known = [name for name in names if name in SCENES]
        usual, here = Params(), default_params(known) if known else Params()
        params = {
            name: getattr(here, name) if np.array_equal(value, getattr(usual, name)) else value
            for name, value in vars(self.params).items()
        }
        return dataclasses.replace(self, scenes=tuple(names), pedestrians=pedestrians, params=Params(**params))


def is_map(scene):
    """Whether the name of a scene is that of a ROS map_server file."""
    return scene.endswith((".yaml", ".yml"))


def scene_names(scene):
    """The scenes that --scene stands for: those of a suite, or one. UserError: there is none of that name."""
    suites = {"all": SUITES["parity"], "hard": SUITES["hard"], "hard-laser": SUITES["hard-laser"]}
    if scene in suites:
        return suites[scene]
    if scene not in SCENES and scene != RECORDING and not is_map(scene):
        raise UserError(
            f"scene {scene!r} is unknown: choose {', '.join(suites)}, one of {', '.join(SCENES)}, "
            f"{RECORDING} (that of world.recording), or the yaml file of a map"
        )
    return (scene,)


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Sizes of the training loop.

    Attributes:
        episodes: played at once.
        replay_rows: steps of all of them that replay keeps.
        steps_per_chunk: steps between two lines of metrics.jsonl.
        total_steps: when training ends, in steps of all episodes.
        evaluate_every: chunks between two evaluations.
        checkpoint_seconds: the most work a kill can cost; may change on --resume.
    """

    episodes: int = 256
    replay_rows: int = 400
    steps_per_chunk: int = 25
    total_steps: int = 1000
    evaluate_every: int = 4
    checkpoint_seconds: float = 60.0

    def __post_init__(self):
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if field.name == "checkpoint_seconds":
                if not value >= 0:
                    raise ValueError(f"train.checkpoint_seconds is {value!r}: give a number of at least 0")
            elif not isinstance(value, int) or value < 1:
                raise ValueError(f"train.{field.name} is {value!r}: give a whole number of at least 1")
        if self.total_steps % self.steps_per_chunk:
            raise ValueError(
                f"train.total_steps is {self.total_steps}: give a multiple of "
                f"train.steps_per_chunk, which is {self.steps_per_chunk}"
            )


@dataclasses.dataclass(frozen=True)
class RunConfig:
    """A training run.

    Attributes:
        preset: quick (CPU minutes), robust (its world randomised), lidar (larger, longer), grid or grid-frozen
            (the paper's CNN on grid maps, for a GPU): the defaults of all other values.
        algo: the learner: hsac, or td3, ppo and a2c, which steer only.
        scene: what to train and evaluate on: all (square, hallway, crosswalk), hard, hard-laser, one scene, or the yaml
            file of a ROS map.
        seed: seed of everything random.
        out: the run's folder; runs/PRESET-SEED if not given, runs/ALGO-PRESET-SEED for the others than hsac.
        resume: go on with the run that the folder holds.
        world: sizes, switches and floats of the world.
        agent: sizes of the learner.
        hyper: floats of the learner.
        train: sizes of the training loop.
    """

    preset: str = "quick"
    algo: str = "hsac"
    scene: str = "all"
    seed: int = 0
    out: str = ""
    resume: bool = False
    world: WorldSettings = WorldSettings()
    agent: Any = None
    hyper: Any = None
    train: TrainConfig = TrainConfig()


@dataclasses.dataclass(frozen=True)
class HSACRunConfig(RunConfig):
    __doc__ = RunConfig.__doc__

    agent: HSACConfig = HSACConfig()
    hyper: HSACHyperparameters = dataclasses.field(default_factory=HSACHyperparameters)


@dataclasses.dataclass(frozen=True)
class TD3RunConfig(RunConfig):
    __doc__ = RunConfig.__doc__

    algo: str = "td3"
    agent: TD3Config = TD3Config()
    hyper: TD3Hyperparameters = dataclasses.field(default_factory=TD3Hyperparameters)


@dataclasses.dataclass(frozen=True)
class PPORunConfig(RunConfig):
    __doc__ = RunConfig.__doc__

    algo: str = "ppo"
    agent: PPOConfig = PPOConfig()
    hyper: PPOHyperparameters = dataclasses.field(default_factory=PPOHyperparameters)
    train: TrainConfig = TrainConfig(episodes=64)


@dataclasses.dataclass(frozen=True)
class A2CRunConfig(RunConfig):
    __doc__ = RunConfig.__doc__

    algo: str = "a2c"
    agent: A2CConfig = A2CConfig()
    hyper: A2CHyperparameters = dataclasses.field(default_factory=A2CHyperparameters)
    train: TrainConfig = TrainConfig(episodes=64)


# Of each algorithm its learner and the class of its runs.
ALGORITHMS = {
    "hsac": (HSAC, HSACRunConfig),
    "td3": (TD3, TD3RunConfig),
    "ppo": (PPO, PPORunConfig),
    "a2c": (A2C, A2CRunConfig),
}

_MAPS = WorldSettings(observation=GRID_PARTS)
_PAPER_NET = HSACConfig(encoder="grid", actor_widths=(128,), critic_widths=(128,), batch=256, updates_per_step=4)
_SLOW = HSACHyperparameters(actor_lr=3e-4, critic_lr=3e-4)  # convolutions learn sooner than at 1e-3 (docs/learner.md)
PRESETS = {
    "quick": HSACRunConfig(),
    "robust": HSACRunConfig(
        preset="robust",
        world=WorldSettings(
            pedestrians=8,
            params=Params(crowd_size=4.0),  # where nothing is drawn: evaluations
            scan_noise=True,
            control_delay=2,
            randomise=(
                ("crowd_size", 1, 8),
                ("awareness", 0.0, 2.0),
                ("preferred_speed", 0.3, 1.4),
                ("compliance", 0.0, 1.0),
                ("scan_noise_std", 0.0, 0.1),
                ("scan_dropout", 0.0, 0.2),
                ("control_latency", 0, 2),
            ),
        ),
        train=TrainConfig(total_steps=1500),
    ),
    "lidar": HSACRunConfig(
        preset="lidar",
        agent=HSACConfig(actor_widths=(256, 256), critic_widths=(256, 256)),
        train=TrainConfig(replay_rows=1500, total_steps=3000, evaluate_every=10),
    ),
    "grid": HSACRunConfig(preset="grid", world=_MAPS, agent=_PAPER_NET, hyper=_SLOW),
    "grid-frozen": HSACRunConfig(
        preset="grid-frozen", world=_MAPS, agent=dataclasses.replace(_PAPER_NET, encoder="grid-frozen")
    ),
}


def preset(name, algo="hsac") -> RunConfig:
    """The defaults of a preset for an algorithm. UserError: there is none of that name."""
    if name not in PRESETS:
        raise UserError(f"preset {name!r} is unknown: choose from {', '.join(PRESETS)}")
    if algo not in ALGORITHMS:
        raise UserError(f"algo {algo!r} is unknown: choose from {', '.join(ALGORITHMS)}")
    base = PRESETS[name]
    if algo == "hsac":
        return base
    cls = ALGORITHMS[algo][1]
    agent = _like(cls().agent, base.agent, HSACConfig())
    hyper = _like(cls().hyper, base.hyper, HSACHyperparameters())
    # Whoever learns from what it has just played plays fewer episodes at once, and as many steps in all. Its chunks
    # stay as long: each draws as many fresh starts as there are episodes; a longer one would use them again.
    episodes = cls().train.episodes
    factor = base.train.episodes // episodes
    sizes = {field: factor * getattr(base.train, field) for field in ("evaluate_every", "total_steps")}
    train = dataclasses.replace(base.train, episodes=episodes, **sizes)
    return cls(preset=name, world=base.world, agent=agent, hyper=hyper, train=train)


def _like(own, base, usual):
    """``own`` with what ``base`` has otherwise than ``usual``, as far as ``own`` has such fields."""
    fields = {field.name for field in dataclasses.fields(own)}
    other = {f.name: getattr(base, f.name) for f in dataclasses.fields(base) if f.name in fields}
    return dataclasses.replace(own, **{name: v for name, v in other.items() if v != getattr(usual, name)})


def make_agent(config: RunConfig) -> Learner:
    """The learner of a run."""
    return LEARNERS[config.algo].make(config.agent)


def resolve(config: RunConfig) -> RunConfig:
    """``config`` with scene and folder filled in, checked as a whole. UserError names the field and the remedy."""
    if config.algo not in ALGORITHMS:
        raise UserError(f"algo {config.algo!r} is unknown: choose from {', '.join(ALGORITHMS)}")
    if type(config) is not ALGORITHMS[config.algo][1]:
        raise UserError(
            f"algo is {config.algo!r} in a {type(config).__name__}: begin with preset(name, {config.algo!r})"
        )
    names, given = scene_names(config.scene), tuple(config.world.scenes)
    if config.scene == "all":
        names = given
    elif given not in (names, WorldConfig().scenes):
        raise UserError(f"world.scenes is {' '.join(given)} beside --scene {config.scene}: give one of the two")
    if not 0 <= config.seed < 2**32:
        raise UserError(f"seed is {config.seed}: give a whole number from 0 to {2**32 - 1}")
    missing = set(config.agent.encoding.reads) - set(config.world.observation)
    if missing:
        raise UserError(
            f"world.observation lacks {', '.join(sorted(missing))}: the {config.agent.encoder} encoder needs it"
        )
    if isinstance(config.agent, RolloutConfig):
        steps = config.agent.horizon * config.train.episodes
        if config.train.steps_per_chunk % config.agent.horizon:
            raise UserError(
                f"agent.horizon is {config.agent.horizon}: give a divisor of train.steps_per_chunk, which is "
                f"{config.train.steps_per_chunk}"
            )
        parts = getattr(config.agent, "minibatches", 1)
        if steps % parts:
            raise UserError(
                f"agent.minibatches is {parts}: give a divisor of agent.horizon times train.episodes, which is {steps}"
            )
    try:
        world = config.world.of_scenes(names)
        check_params(world.params, world)
        check_ranges(world.randomise, world.params, world)
        world.world()
        check_hyperparameters(config.hyper)
    except ValueError as error:
        raise UserError(str(error)) from None
    usual = "" if config.algo == "hsac" else f"{config.algo}-"
    out = config.out or f"runs/{usual}{config.preset}-{config.seed}"
    return dataclasses.replace(config, world=world, agent=config.agent.filled(), out=out)


_FRACTIONS = (
    "discount", "tau", "average", "final_lr", "target_entropy_request", "gae_lambda", "word_errors",
    "initial_std",
)  # fmt: skip
_ABOVE_ZERO = ("initial_temperature", "initial_std", "clip", "max_gradient_norm", "reward_scale")
_NOT_NEGATIVE = (
    "exploration_noise", "target_noise", "target_noise_clip", "entropy_weight", "word_noise", "message_weight",
)  # fmt: skip


def check_hyperparameters(hyper):
    """Raise ValueError naming the first hyperparameter that is not finite or out of its range."""
    for name, value in vars(hyper).items():
        if not np.all(np.isfinite(value)):
            raise ValueError(f"hyper.{name} is {value}: give a finite number")
        if (name.endswith("_lr") or name in _NOT_NEGATIVE) and np.any(np.asarray(value) < 0):
            raise ValueError(f"hyper.{name} is {value}: give a number of at least 0")
        if name in _FRACTIONS and not np.all((np.asarray(value) >= 0) & (np.asarray(value) <= 1)):
            raise ValueError(f"hyper.{name} is {value}: give a number from 0 to 1")
        if name in _ABOVE_ZERO and not np.all(np.asarray(value) > 0):
            raise ValueError(f"hyper.{name} is {value}: give a number above 0")


def run_from_json(data) -> RunConfig:
    """The run that `to_json` made ``data`` of; ValueError names what is missing or unknown."""
    algo = data["algo"]
    if algo not in ALGORITHMS:
        raise ValueError(f"algo {algo!r} is unknown")
    return from_json(ALGORITHMS[algo][1], data)
