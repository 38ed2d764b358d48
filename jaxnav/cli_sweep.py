"""The command line of sweeps: jaxnav sweep, and what jaxnav train --from-sweep takes from one."""

import contextlib
import dataclasses
import fcntl
import json
import pathlib
import time
import uuid
from typing import Annotated, Literal

import jax
import tyro
from rich.console import Console
from rich.live import Live
from rich.table import Table

from .command import enable_compilation_cache, parse
from .errors import UserError, remedy
from .training.config import TrainConfig, run_from_json
from .training.dataclass_json import differences
from .training.provenance import provenance

_SHOWN = 8  # trials in the live table


@dataclasses.dataclass(frozen=True)
class _Options:
    """Search for hyperparameters: populations of learners trained at once, the worst stopped early, the best confirmed
    on fresh seeds. FILE declares the sweep (experiments/sweeps/hard.py is one); options change what it says.

    Args:
        file: the Python file that declares the sweep.
        out: the sweep's folder; runs/sweeps/NAME if not given.
        resume: go on with the sweep that the folder holds, also with more trials or seeds.
        engine: local, this process and its device; ray, one population a GPU (or CPU) of a Ray cluster.
        address: of a Ray cluster, auto for the one this machine belongs to; without it ray begins one here.
        storage: URL of a database for the trials, in place of a file in the folder: postgresql://user@host/name.
        report: draw up the summary of that folder again; nothing is trained, and no file is given.
        sweep: what the file says.
    """

    file: Annotated[str, tyro.conf.Positional] = ""
    out: str = ""
    resume: bool = False
    engine: Literal["local", "ray"] = "local"
    address: str = ""
    storage: str = ""
    report: str = ""


def sweep(arguments):
    """jaxnav sweep."""
    if any(argument.partition("=")[0] == "--report" for argument in arguments):
        options = parse(_Options, arguments, "sweep")
        if dataclasses.replace(options, report="") != _Options():
            raise UserError(f"--report is {options.report} beside other options: it takes none, and no file")
        return _report(pathlib.Path(options.report))
    if not arguments or arguments[0].startswith("-"):
        if not {"-h", "--help"} & set(arguments):
            raise UserError("give the Python file that declares a sweep, before all options")
        parse(_Options, arguments, "sweep")
        return None
    return _sweep(arguments[0], arguments)


def _sweep(file, arguments):
    from .sweep import search, spec
    from .sweep.engines import Local, OnRay
    from .sweep.store import Store

    declared = spec.load(file)
    fields = [
        (field.name, field.type, dataclasses.field(default=field.default)) for field in dataclasses.fields(_Options)
    ]
    given = Annotated[spec.Sweep, tyro.conf.arg(name="")]
    cls = dataclasses.make_dataclass(
        "Options", [*fields, ("sweep", given, dataclasses.field(default=declared))], frozen=True
    )
    cls.__doc__ = _Options.__doc__
    options = parse(cls, arguments, "sweep")
    found = options.sweep
    spec.check(found)
    if options.address and options.engine != "ray":
        raise UserError(f"--address is {options.address} with --engine local: give --engine ray")
    if options.engine == "ray":
        jax.config.update("jax_platforms", "cpu")  # of this process alone: accelerators are the workers'
    enable_compilation_cache()
    name = pathlib.Path(file).stem
    folder = pathlib.Path(options.out or f"runs/sweeps/{name}")
    kept = _checked(folder, name, found, options)
    console = Console(stderr=True, soft_wrap=True, markup=False, highlight=False)
    # What others have to answer comes first: nothing is written if they don't.
    populations = found.populations * len(found.combinations)
    with contextlib.closing(OnRay(options.address, populations) if options.engine == "ray" else Local()) as engine:
        store = Store(folder, kept["studies"], options.storage) if options.storage else None
        _keep(folder, kept)
        with _alone(folder):
            store = store or Store(folder, kept["studies"], mend=True)
            console.print(f"sweep {name} in {folder}: {found.trials} trials in populations of {found.members}")
            with _shown(found, console) as show:
                search.run(found, folder, store, engine, show)
    return _report(folder)


def _checked(folder, name, found, options):
    """What sweep.json is to say. UserError: the folder holds something else than what is asked for."""
    path = folder / "sweep.json"
    # In a database there may be other sweeps of the same name.
    studies = f"{name}-{uuid.uuid4().hex[:8]}" if options.storage else name
    budget = {field: getattr(found, field) for field in ("trials", "confirm", "seeds")}
    value = {"name": name, "storage": options.storage, "identity": found.identity()}
    value = json.loads(json.dumps(value))
    if options.resume:
        before = _read(path, "--resume starts nothing: leave it out to start one")
        changed = differences({n: before[n] for n in value}, value)
        if changed:
            raise UserError(
                f"--out {folder} holds another sweep ({', '.join(changed[:5])} differ): give the same values to resume "
                "it, or another --out"
            )
        return before | {"budget": budget}
    if path.exists():
        raise UserError(f"--out {folder} already holds a sweep: go on with --resume, or give another --out")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UserError(f"--out {folder} is not an empty folder: give another --out")
    return value | {"studies": studies, "budget": budget, "runs": []}


def _keep(folder, kept):
    """Write sweep.json, with this start among its runs: what is said of each was true of it."""
    path, runs = folder / "sweep.json", list(kept["runs"])
    runs += [found for found in [provenance()] if found not in runs]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        whole = path.with_suffix(".tmp")
        whole.write_text(json.dumps(kept | {"runs": runs}, indent=1) + "\n")
        whole.replace(path)
    except OSError as error:
        raise UserError(f"{path} can't be written ({error.strerror}): {remedy(error)}") from error


@contextlib.contextmanager
def _alone(folder):
    """UserError: another process runs the sweep of this folder; one that was killed does no longer."""
    with open(folder / "sweep.lock", "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UserError(f"--out {folder} is the sweep of a process that still runs: stop it first") from None
        yield


def _read(path, otherwise):
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        raise UserError(f"{path.parent} holds no sweep: {otherwise}") from None
    except (OSError, ValueError) as error:
        raise UserError(f"{path} can't be read ({error}): search anew with another --out") from error


def _report(folder):
    from .sweep import report
    from .sweep.results import PHASES, Results
    from .sweep.store import Store

    kept = _read(folder / "sweep.json", "give the folder of one")
    store = Store(folder, kept["studies"], kept["storage"])
    phases = {phase: store.trials(phase) for phase in PHASES}
    report.write(Results(kept["name"], kept["identity"], kept["budget"], phases, kept["runs"]), folder)
    print((folder / "summary.md").read_text(), end="")


def winner(folder):
    """The `RunConfig` of a sweep's winner. UserError: there is none yet."""
    from .sweep.spec import put

    folder = pathlib.Path(folder)
    kept = _read(folder / "sweep.json", "give the folder of one to --from-sweep")
    summary = _read(folder / "summary.json", f"it isn't done: go on with jaxnav sweep FILE --resume --out {folder}")
    if summary["winner"] is None or summary["budget"] != kept["budget"]:
        raise UserError(
            f"--from-sweep {folder} has no winner yet: go on with jaxnav sweep FILE --resume --out {folder}"
        )
    base = kept["identity"]["base"]
    train = base["train"] | {"checkpoint_seconds": TrainConfig().checkpoint_seconds}  # of the machine, not of the sweep
    config = run_from_json(base | {"out": "", "resume": False, "train": train})
    for name, value in summary["winner"]["values"].items():
        config = put(config, name, tuple(value) if isinstance(value, list) else value)
    return config


@contextlib.contextmanager
def _shown(sweep, console):
    """Yields the function that shows how a sweep goes: a table on a terminal, else a line a population."""
    began, first = time.monotonic(), {}

    def text(results, state):
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
        yield lambda results, state: console.print(text(results, state))
        return
    with Live(console=console, refresh_per_second=1) as live:
        yield lambda results, state: live.update(_table(sweep, results, text(results, state)))


def _table(sweep, results, title):
    """The best trials of the search, those that came furthest first."""
    table = Table(title=title, title_justify="left")
    names = [*sweep.sizes, *sweep.space]
    for heading in ("trial", "state", "steps", sweep.objective.__name__, *(name.rpartition(".")[2] for name in names)):
        table.add_column(heading, justify="right")
    sign = 1 if sweep.direction == "maximize" else -1
    known = [trial for trial in results.phases["search"] if trial.objective is not None]
    for trial in sorted(known, key=lambda trial: (-len(trial.curve), -sign * trial.objective))[:_SHOWN]:
        values = (trial.values[name] for name in names)
        table.add_row(
            str(trial.number), trial.state, f"{trial.curve[-1]['env_steps'] / 1000:.0f}k", f"{trial.objective:.3f}",
            *(f"{value:.3g}" if isinstance(value, float) else str(value) for value in values),
        )  # fmt: skip
    return table
