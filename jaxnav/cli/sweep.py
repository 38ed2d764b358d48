"""jaxnav sweep: a search for hyperparameters."""

import contextlib
import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING, Annotated, Any

import jax
import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table

from ..errors import UserError
from ..fields import choice, flag, text
from ..statistics import sign
from .options import enable_compilation_cache, parse, scene_field, value_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ..sweep.results import Results
    from ..sweep.spec import Sweep

_SHOWN = 8  # trials in the live table


@dataclasses.dataclass(frozen=True)
class _Options:
    """Search for hyperparameters: populations of learners trained at once, the worst stopped early, the best confirmed
    on fresh seeds. FILE declares the sweep (experiments/sweeps/hard.py is one); options change what it says.
    """

    file: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")] = text(
        "", allowed="a path", doc="Python file that declares the sweep"
    )
    scene: str = scene_field("of all trials, if not those of the file; with the people who walk there")
    out: str = text("", allowed="a path", doc="the sweep's folder; runs/sweeps/NAME if empty")
    resume: bool = flag(False, doc="go on with the sweep that the folder holds, also with more trials or seeds")
    engine: str = choice(
        "local", ("local", "ray"), doc="this process and its device, or one population a GPU (or CPU) of a Ray cluster"
    )
    address: str = text("", allowed="auto or HOST:PORT", doc="the Ray cluster; without it ray begins one here")
    storage: str = text(
        "", allowed="postgresql://user@host/name", doc="database for the trials, in place of a file in the folder"
    )
    report: str = text("", allowed="a path", doc="folder of a sweep whose summary is drawn up again; no training")


_EXAMPLES = """\
  jaxnav sweep experiments/sweeps/hard.py --trials 60 --members 8
  jaxnav sweep experiments/sweeps/hard.py --out runs/sweeps/hard --resume
  jaxnav train --from-sweep runs/sweeps/hard
"""


def command(arguments: list[str]) -> None:
    if any(argument.partition("=")[0] == "--report" for argument in arguments):
        options = parse(_Options, arguments, "sweep", _EXAMPLES)
        if dataclasses.replace(options, report="") != _Options():
            raise UserError(f"--report is {options.report} beside other options: it takes none, and no file")
        _report(pathlib.Path(options.report))
        return
    if not arguments or arguments[0].startswith("-"):
        if not {"-h", "--help"} & set(arguments):
            raise UserError("give the Python file that declares a sweep, before all options")
        parse(_Options, arguments, "sweep", _EXAMPLES)
        return
    _search(arguments[0], arguments)


def _search(file: str, arguments: list[str]) -> None:
    from ..sweep import search, spec
    from ..sweep.engines import Local, OnRay
    from ..sweep.folder import alone, checked, keep
    from ..sweep.store import Store

    declared = spec.load(file)
    scene = value_of(arguments, "--scene")
    if scene is not None:
        declared = dataclasses.replace(declared, base=declared.base.of_scenes(scene))
    fields = [
        (field.name, field.type, dataclasses.field(default=field.default, metadata=field.metadata))
        for field in dataclasses.fields(_Options)
    ]
    given = Annotated[spec.Sweep, tyro.conf.arg(name="")]
    cls = dataclasses.make_dataclass(
        "Options", [*fields, ("sweep", given, dataclasses.field(default=declared))], frozen=True
    )
    cls.__doc__ = _Options.__doc__
    options: Any = parse(cls, arguments, "sweep", _EXAMPLES)
    found = options.sweep
    spec.check(found)
    if options.address and options.engine != "ray":
        raise UserError(f"--address is {options.address} with --engine local: give --engine ray")
    if options.engine == "ray":
        jax.config.update("jax_platforms", "cpu")  # of this process alone: accelerators are the workers'
    enable_compilation_cache()
    name = pathlib.Path(file).stem
    folder = pathlib.Path(options.out or f"runs/sweeps/{name}")
    kept = checked(folder, name, found, options.storage, options.resume)
    console = Console(stderr=True, soft_wrap=True, markup=False, highlight=False)
    # What others have to answer comes first: nothing is written if they don't.
    populations = found.populations * len(found.combinations)
    with contextlib.closing(OnRay(options.address, populations) if options.engine == "ray" else Local()) as engine:
        store = Store(folder, kept["studies"], options.storage) if options.storage else None
        keep(folder, kept)
        with alone(folder):
            store = store or Store(folder, kept["studies"], mend=True)
            console.print(f"sweep {name} in {folder}: {found.trials} trials in populations of {found.members}")
            with _shown(found, console) as show:
                search.run(found, folder, store, engine, show)
    _report(folder)


def _report(folder: pathlib.Path) -> None:
    from ..sweep import report
    from ..sweep.folder import read
    from ..sweep.results import PHASES, Results
    from ..sweep.store import Store

    kept = read(folder / "sweep.json", "give the folder of one")
    store = Store(folder, kept["studies"], kept["storage"])
    phases = {phase: store.trials(phase) for phase in PHASES}
    report.write(Results(kept["name"], kept["identity"], kept["budget"], phases, kept["runs"]), folder)
    print((folder / "summary.md").read_text(), end="")


@contextlib.contextmanager
def _shown(sweep: "Sweep", console: Console) -> "Iterator[Callable[[Results, str], None]]":
    """Yields the function that shows how a sweep goes: a table on a terminal, else a line a population."""
    began, first = time.monotonic(), {}

    def line(results, state):
        trials = results.phases["search"]
        ended = sum(trial.state != "running" for trial in trials)
        since = ended - first.setdefault("ended", ended)
        spent = time.monotonic() - began
        left = (
            f", about {spent * (sweep.trials - ended) / since / 60:.0f} min of the search left"
            if since and ended < sweep.trials
            else ""
        )
        return f"{state}; {ended} of {sweep.trials} trials ended; {spent / 60:.1f} min{left}"

    if not console.is_terminal:
        yield lambda results, state: console.print(line(results, state))
        return
    with Live(console=console, refresh_per_second=1) as live:
        yield lambda results, state: live.update(_table(sweep, results, line(results, state)))


def _table(sweep: "Sweep", results: "Results", title: str) -> Table:
    """The best trials of the search, those that came furthest first."""
    table = Table(title=title, title_justify="left")
    names = [*sweep.sizes, *sweep.space]
    for heading in ("trial", "state", "steps", sweep.objective.__name__, *(name.rpartition(".")[2] for name in names)):
        table.add_column(heading, justify="right")

    def best_first(pair):
        trial, objective = pair
        return -len(trial.curve), -sign(sweep.direction) * objective

    known = [(trial, trial.objective) for trial in results.phases["search"] if trial.objective is not None]
    for trial, objective in sorted(known, key=best_first)[:_SHOWN]:
        values = (trial.values[name] for name in names)
        table.add_row(
            str(trial.number), trial.state, f"{trial.curve[-1]['env_steps'] / 1000:.0f}k", f"{objective:.3f}",
            *(f"{value:.3g}" if isinstance(value, float) else str(value) for value in values),
        )  # fmt: skip
    return table
