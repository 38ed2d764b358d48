"""Calibrates IRVO pedestrians by gradient descent through the world: on walkers it simulates, or on recorded people.

python -m experiments.calibrate_pedestrians --help
"""

import contextlib
import dataclasses
import json
import pathlib
import sys
import time
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import Progress

from experiments.study import RESULTS, make_folder
from jaxnav.errors import UserError, remedy
from jaxnav.world.config import MAX_PEDESTRIANS


@dataclasses.dataclass(frozen=True)
class Simulated:
    """Recover known parameters: walkers of the world itself are recorded, and fitted from far-off starting values.

    A robot drives straight through some walkers, for several truths. Writes calibrate_simulated.json and
    .png: every truth, start and fit, and by how much the best start (the lowest loss) misses each parameter.

    Args:
        truths: parameter sets to recover.
        starts: starting values for each, 30 to 60 percent off; the one that ends with the lowest loss counts.
        walkers: in each episode.
        episodes: recorded for each truth, of 16 steps.
        steps: of gradient descent.
        noise: standard deviation of the recorded positions, metres.
        seed: of truths, starts, episodes and batches.
        out: folder of the results.
    """

    truths: int = 5
    starts: int = 4
    walkers: int = 4
    episodes: int = 100
    steps: int = 800
    noise: float = 0.0
    seed: int = 0
    out: pathlib.Path = RESULTS

    def __post_init__(self):
        _at_least(self, truths=1, starts=1, walkers=1, episodes=1, steps=1, noise=0, seed=0)
        if self.walkers > MAX_PEDESTRIANS:
            raise UserError(f"walkers is {self.walkers}: give at most {MAX_PEDESTRIANS}")


@dataclasses.dataclass(frozen=True)
class Eth:
    """Fit recorded people in the ETH walking-pedestrians format, and predict people who were held out.

    The first people to appear are for fitting, the others are held out. Every predictor is given the observed frames
    alone; destinations are chosen by the heading so far. Writes calibrate_eth.json and .png: displacement errors of
    constant velocity, of ORCA as it comes and of the calibrated one, with 95 percent bootstrap intervals over people.

    Args:
        data: the recording, ...obsmat.txt: frame, id, x, z, y, vx, vz, vy; 2.5 annotated frames a second. Files beside
            it called ...destinations.txt and ...groups.txt are read too.
        share: of the people, in order of appearance, for fitting.
        observe: frames observed, 0.4 s apart.
        predict: frames predicted.
        starts: random starting values; the one that ends with the lowest training loss counts.
        steps: of gradient descent.
        seed: of starts, batches and bootstrap.
        out: folder of the results.
    """

    data: pathlib.Path
    share: float = 0.6
    observe: int = 8
    predict: int = 12
    starts: int = 3
    steps: int = 300
    seed: int = 0
    out: pathlib.Path = RESULTS

    def __post_init__(self):
        _at_least(self, observe=2, predict=1, starts=1, steps=1, seed=0)
        if not 0 < self.share < 1:
            raise UserError(f"share is {self.share:g}: give a number between 0 and 1")


def _at_least(options, **limits):
    for name, least in limits.items():
        value = getattr(options, name)
        if not value >= least:
            raise UserError(f"{name} is {value}: give at least {least}")
        if not value < 2**32:
            raise UserError(f"{name} is {value}: give less than {2**32}")


_Commands = (
    Annotated[Simulated, tyro.conf.subcommand("simulated")] | Annotated[Eth, tyro.conf.subcommand("eth")]
)  # fmt: skip


def main(arguments=None):
    """Entry point. Exits with 2 after an error that the user can mend."""
    try:
        options = tyro.cli(
            _Commands, args=arguments, description=__doc__, prog="python -m experiments.calibrate_pedestrians"
        )
        make_folder(options.out)
        run = _simulated if isinstance(options, Simulated) else _eth
        run(options, Console(stderr=True, soft_wrap=True, markup=False, highlight=False))
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def _simulated(options, console):
    from experiments.calibration import figures, recovery

    started = time.monotonic()
    with _progress(console, options.truths * options.steps, f"fitting {options.truths} truths") as report:
        result = recovery.study(
            options.truths,
            options.starts,
            options.walkers,
            options.episodes,
            options.steps,
            options.noise,
            options.seed,
            report,
        )
    _write(options, "calibrate_simulated", result, started, figures.recovery)
    worst = ", ".join(f"{name} {error:.2%}" for name, error in result["largest_error"].items())
    console.print(f"largest relative errors over {options.truths} truths: {worst}")


def _eth(options, console):
    from experiments.calibration import comparison, eth, figures, windows

    started = time.monotonic()
    recording = eth.read(options.data, *(_beside(options.data, kind) for kind in ("destinations", "groups")))
    training, held_out = windows.split(
        recording, windows.cut(recording, options.observe, options.predict), options.share
    )
    with _progress(console, options.steps, "fitting") as report:
        result = comparison.study(training, held_out, options.starts, options.steps, options.seed, report)
    _write(options, "calibrate_eth", result, started, figures.comparison)
    for name, errors in result["predictors"].items():
        ade, fde = ("{:.3f} m ({:.3f}-{:.3f})".format(*errors[kind]) for kind in ("ade", "fde"))
        console.print(f"{name:>42}  ADE {ade}  FDE {fde}")


def _beside(data, kind):
    """The file of that kind that belongs to an obsmat.txt, None if there is none."""
    path = data.with_name(data.name.replace("obsmat", kind))
    return path if path != data and path.exists() else None


@contextlib.contextmanager
def _progress(console, total, description):
    """Yields a function of no argument to call after every step: a bar on a terminal, else a line every tenth."""
    if not console.is_terminal:
        done = 0

        def count():
            nonlocal done
            done += 1
            if 10 * done // total > 10 * (done - 1) // total:
                console.print(f"{description}: {done / total:4.0%}")

        yield count
        return
    with Progress(console=console) as bar:
        task = bar.add_task(f"{description} (the first step compiles)", total=total)
        yield lambda: bar.advance(task)


def _write(options, name, result, started, draw):
    """The result with all it comes from as JSON, and its figure."""
    from jaxnav.training.provenance import provenance

    # Names, not places: a result says nothing of the machine's folders.
    given = {key: getattr(value, "name", value) for key, value in dataclasses.asdict(options).items() if key != "out"}
    document = {
        "options": given, **result, **provenance(), "wall_seconds": round(time.monotonic() - started, 1)
    }  # fmt: skip
    try:
        # A line a field: the curves of an indented file would fill pages.
        lines = ",\n".join(f" {json.dumps(key)}: {json.dumps(value)}" for key, value in document.items())
        (options.out / f"{name}.json").write_text(f"{{\n{lines}\n}}\n")
        draw(document, options.out / f"{name}.png")
    except OSError as error:
        raise UserError(f"out is {options.out}: can't be written ({error.strerror}): {remedy(error)}") from None


if __name__ == "__main__":
    main()
