"""The store of trials: each phase of a sweep is a study of Optuna, in a file of ours or in any database it supports.

The only user of Optuna's storage. A trial is added whole, with its values and its place; each of its rounds is one more
attribute. So a kill between any two lines leaves a store that the next start can read.
"""

import contextlib
import dataclasses
import json
import pathlib
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from typing import Any, Protocol

from ..errors import UserError, remedy
from ..training.dataclass_json import differences
from .results import Trial
from .spec import Sweep

try:
    import optuna
    import optuna.storages.journal
    import sqlalchemy.exc
except ImportError as error:
    raise UserError(
        f'a sweep needs {error.name}, which isn\'t installed: pip install "jaxnav[sweep]", or in a clone -e ".[sweep]"'
    ) from error

optuna.logging.set_verbosity(optuna.logging.ERROR)
# A database that isn't there or whose driver isn't, and a file that is no journal.
_OF_STORES = (optuna.exceptions.OptunaError, sqlalchemy.exc.SQLAlchemyError, ImportError, ValueError, KeyError)
_STATES = {"RUNNING": "running", "COMPLETE": "complete", "PRUNED": "stopped", "FAIL": "broken"}


@dataclasses.dataclass(frozen=True)
class Place:
    """Where and when a trial trains.

    population: its name.
    slot:       the trial's slot in it.
    round:      the population's round before which the trial begins.
    turn:       the turn of all populations in which it begins.
    """

    population: str
    slot: int
    round: int
    turn: int


class Store:
    """All studies of one sweep. UserError where they can't be read or written, or belong to another sweep.

    name: of the studies; mend: cut off the half line that a full disk left, which only the writing process may do.
    """

    def __init__(self, folder: pathlib.Path, name: str, url: str = "", mend: bool = False) -> None:
        self._where, self.name = url or str(folder / "store.log"), name
        with self._telling():
            self._storage = _database(url) if url else _file(folder / "store.log", mend)

    def open(self, phase: str, sweep: Sweep) -> "Study":
        """The `Study` of a phase, created if there is none."""
        with self._telling():
            study = optuna.create_study(
                storage=self._storage,
                study_name=f"{self.name}/{phase}",
                direction=sweep.direction,
                load_if_exists=True,
            )
            identity = json.loads(json.dumps(sweep.identity()))
            found = study.user_attrs.get("sweep")
            if found is None:
                study.set_user_attr("sweep", identity)
                found = identity
        changed = differences(found, identity)
        if changed:
            raise UserError(
                f"{self._where} is of another sweep ({', '.join(changed[:5])} differ): give the same values to go on "
                "with it, or another --out" + (" and another name of the file" if "://" in self._where else "")
            )
        return Study(study, self._telling)

    def trials(self, phase: str) -> list[Trial]:
        """Trials of a phase, none if it has not begun: for a report, which needs no sweep."""
        with self._telling():
            names = {summary.study_name for summary in optuna.get_all_study_summaries(self._storage)}
            name = f"{self.name}/{phase}"
            if name not in names:
                return []
            return Study(optuna.load_study(study_name=name, storage=self._storage), self._telling).trials()

    @contextlib.contextmanager
    def _telling(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise UserError(
                f"{self._where} can't be written ({error.strerror}): {remedy(error)}, then go on with --resume"
            ) from error
        except _OF_STORES as error:
            text = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
            raise UserError(
                f"{self._where} can't be used ({text}): mend it, or give another --out or --storage"
            ) from error


class Study:
    """The trials of a phase, in order of their numbers."""

    def __init__(self, study: Any, telling: Callable[[], AbstractContextManager[None]]) -> None:
        self._study, self._telling = study, telling

    def trials(self) -> list[Trial]:
        """All trials."""
        with self._telling():
            return [_trial(frozen) for frozen in self._study.get_trials(deepcopy=False)]

    def places(self) -> dict[int, Place]:
        """Places of the trials, by their numbers."""
        with self._telling():
            frozen = self._study.get_trials(deepcopy=False)
            return {f.number: Place(**f.user_attrs["place"]) for f in frozen}

    def add(
        self, values: dict[str, Any], distributions: dict[str, Any], seed: int, of: int | None, place: Place
    ) -> None:
        """Begin a trial."""
        labels = {name: label(value) for name, value in values.items()}
        frozen = optuna.trial.create_trial(
            state=optuna.trial.TrialState.RUNNING, params=labels, distributions=distributions,
            user_attrs={"seed": int(seed), "of": of, "place": dataclasses.asdict(place)},
        )  # fmt: skip
        frozen.datetime_complete = None
        with self._telling():
            self._study.add_trial(frozen)

    def report(self, trial: Trial, step: int, row: dict[str, Any]) -> None:
        """Store a round of a trial: the row of its curve, after ``step`` steps of every episode."""
        with self._telling():
            handle = self._handle(trial)
            if row["objective"] is not None:
                self._study._storage.set_trial_intermediate_value(handle, step, row["objective"])
            # Last: a round counts once this is there.
            self._study._storage.set_trial_user_attr(handle, f"round {len(trial.curve):05}", row)

    def end(self, trial: Trial, state: str) -> None:
        """End a trial. state: stopped, complete or broken."""
        name = {found: name for name, found in _STATES.items()}[state]
        with self._telling():
            value = trial.objective if state == "complete" else None
            self._study.tell(trial.number, value, state=optuna.trial.TrialState[name])

    def _handle(self, trial: Trial) -> int:
        return self._study._storage.get_trial_id_from_study_id_trial_number(self._study._study_id, trial.number)

    def sampler(self, seed: int, startup: int) -> "Sampler":
        """A `Sampler` that knows the present trials."""
        with self._telling():
            return Sampler(self._study.direction, self._study.get_trials(deepcopy=False), seed, startup)


class Sampler:
    """Proposes values by Optuna's TPE (Bergstra et al. 2011).

    A proposal follows from the trials and the number of the next one: so a sweep that was killed goes on as if it
    hadn't been. startup: trials that are drawn at random first.
    """

    def __init__(self, direction: Any, trials: list[Any], seed: int, startup: int) -> None:
        self._study = optuna.create_study(direction=direction)
        self._study.add_trials(trials)
        self._seed, self._startup = seed, startup

    def ask(self, number: int, distributions: dict[str, Any], fixed: dict[str, Any]) -> dict[str, Any]:
        """Values by name for trial ``number``; those in ``fixed`` are kept."""
        fixed = {name: label(value) for name, value in fixed.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            tpe = optuna.samplers.TPESampler(
                seed=(self._seed + number) % 2**32, n_startup_trials=self._startup, constant_liar=True
            )
            self._study.sampler = optuna.samplers.PartialFixedSampler(fixed, tpe)
            found = self._study.ask(distributions).params
        return {name: _value(value) for name, value in found.items()}


class HasValues(Protocol):
    """Has values by dotted name."""

    @property
    def values(self) -> dict[str, Any]: ...


def distributions(sweep: Sweep, trials: Iterable[HasValues] = ()) -> dict[str, Any]:
    """Optuna's distributions of the searched values, by name; widened so that they hold the values of ``trials``."""
    trials = list(trials)
    floats, sizes = {}, {}
    for name, found in sweep.space.items():
        values = [trial.values[name] for trial in trials]
        low, high = min([found.low, *values]), max([found.high, *values])
        floats[name] = optuna.distributions.FloatDistribution(low, high, log=found.log and not trials)
    for name, values in sweep.sizes.items():
        values = dict.fromkeys([*values, *(trial.values[name] for trial in trials)])
        sizes[name] = optuna.distributions.CategoricalDistribution([label(value) for value in values])
    return sizes | floats


def label(value: Any) -> Any:
    """The form of a value in the store, which takes no tuples."""
    return json.dumps(list(value)) if isinstance(value, tuple) else value


def _value(value):
    return tuple(json.loads(value)) if isinstance(value, str) and value.startswith("[") else value


def _trial(frozen) -> Trial:
    attributes = frozen.user_attrs
    curve = tuple(attributes[name] for name in sorted(attributes) if name.startswith("round "))
    known = [row["objective"] for row in curve if row["objective"] is not None]
    return Trial(
        number=frozen.number,
        state=_STATES[frozen.state.name],
        values={name: _value(value) for name, value in frozen.params.items()},
        seed=attributes["seed"],
        of=attributes["of"],
        objective=known[-1] if known else None,
        curve=curve,
        device=curve[-1]["device"] if curve else "",
    )


def _database(url):
    if "://" not in url:
        raise UserError(f"--storage is {url!r}: give the URL of a database, as in postgresql://user@host/name")
    return optuna.storages.RDBStorage(url)


def _file(path, mend):
    if mend and path.exists():
        whole = path.read_bytes()
        if not whole.endswith(b"\n"):  # a line that a full disk cut off: the next would be glued to it
            with open(path, "r+b") as file:
                file.truncate(whole.rfind(b"\n") + 1)
    backend = optuna.storages.journal.JournalFileBackend(str(path))
    return optuna.storages.JournalStorage(backend)
