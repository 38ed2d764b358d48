"""Where trials are kept: a phase of a sweep is a study of Optuna, in a file of ours or in any database that it takes.

The only user of Optuna's storage. A trial is added whole, with its values and its place; a round of it is one more
attribute. So a kill between any two lines leaves a store that the next start reads as it is.
"""

import contextlib
import dataclasses
import json
import pathlib
import warnings
from typing import Any

from ..errors import UserError, remedy
from ..training.dataclass_json import differences
from .results import Trial
from .spec import Sweep

try:
    import optuna
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
    """Where and when a trial trains: unit: name of its population; slot in it; round: of the population, before which
    it begins; turn: of all populations, in which it does."""

    unit: str
    slot: int
    round: int
    turn: int


class Store:
    """All studies of one sweep. UserError where they can't be read or written, or belong to another sweep.

    name: of the studies; mend: cut off what a full disk left of a line, which only the one who writes may do.
    """

    def __init__(self, folder: pathlib.Path, name: str, url: str = "", mend=False):
        self._where, self.name = url or str(folder / "store.log"), name
        with self._telling():
            self._storage = _database(url) if url else _file(folder / "store.log", mend)

    def open(self, phase: str, sweep: Sweep):
        """The `Study` of a phase, made if there is none."""
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

    def trials(self, phase):
        """Trials of a phase, if there is one yet: for a report, which needs no sweep."""
        with self._telling():
            names = {summary.study_name for summary in optuna.get_all_study_summaries(self._storage)}
            name = f"{self.name}/{phase}"
            if name not in names:
                return []
            return Study(optuna.load_study(study_name=name, storage=self._storage), self._telling).trials()

    @contextlib.contextmanager
    def _telling(self):
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

    def __init__(self, study, telling):
        self._study, self._telling = study, telling

    def trials(self) -> list[Trial]:
        """All of them."""
        with self._telling():
            return [_trial(frozen) for frozen in self._study.get_trials(deepcopy=False)]

    def places(self) -> dict[int, Place]:
        """Where each trains, or trained, by number."""
        with self._telling():
            frozen = self._study.get_trials(deepcopy=False)
            return {f.number: Place(**f.user_attrs["place"]) for f in frozen}

    def add(self, values: dict[str, Any], distributions, seed, of, place: Place):
        """One more trial, which begins."""
        labels = {name: label(value) for name, value in values.items()}
        frozen = optuna.trial.create_trial(
            state=optuna.trial.TrialState.RUNNING, params=labels, distributions=distributions,
            user_attrs={"seed": int(seed), "of": of, "place": dataclasses.asdict(place)},
        )  # fmt: skip
        frozen.datetime_complete = None
        with self._telling():
            self._study.add_trial(frozen)

    def report(self, trial: Trial, step, row):
        """A round of a trial: its objective after ``step`` steps of all episodes, and the row of its curve."""
        with self._telling():
            handle = self._handle(trial)
            if row["objective"] is not None:
                self._study._storage.set_trial_intermediate_value(handle, step, row["objective"])
            # Last: a round counts once this is there.
            self._study._storage.set_trial_user_attr(handle, f"round {len(trial.curve):05}", row)

    def end(self, trial: Trial, state):
        """The trial is stopped, complete or broken."""
        name = {found: name for name, found in _STATES.items()}[state]
        with self._telling():
            value = trial.objective if state == "complete" else None
            self._study.tell(trial.number, value, state=optuna.trial.TrialState[name])

    def _handle(self, trial):
        return self._study._storage.get_trial_id_from_study_id_trial_number(self._study._study_id, trial.number)

    def sampler(self, seed, startup):
        """A `Sampler` that knows the trials of now."""
        with self._telling():
            return Sampler(self._study.direction, self._study.get_trials(deepcopy=False), seed, startup)


class Sampler:
    """Proposes values by Optuna's TPE (Bergstra et al. 2011). What it proposes follows from the trials and from the
    number of the next: so a sweep that was killed goes on as if it hadn't been."""

    def __init__(self, direction, trials, seed, startup):
        self._study = optuna.create_study(direction=direction)
        self._study.add_trials(trials)
        self._seed, self._startup = seed, startup

    def ask(self, number, distributions, fixed):
        """Values by name for trial ``number``, those of ``fixed`` as they are."""
        fixed = {name: label(value) for name, value in fixed.items()}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            tpe = optuna.samplers.TPESampler(
                seed=(self._seed + number) % 2**32, n_startup_trials=self._startup, constant_liar=True
            )
            self._study.sampler = optuna.samplers.PartialFixedSampler(fixed, tpe)
            found = self._study.ask(distributions).params
        return {name: _value(value) for name, value in found.items()}


def distributions(sweep: Sweep, jobs=None):
    """Optuna's distributions of what is searched, by name; with ``jobs``, that these have values of, also beyond."""
    floats, sizes = {}, {}
    for name, found in sweep.space.items():
        values = [job.values[name] for job in jobs or ()]
        low, high = min([found.low, *values]), max([found.high, *values])
        floats[name] = optuna.distributions.FloatDistribution(low, high, log=found.log and not jobs)
    for name, values in sweep.sizes.items():
        values = dict.fromkeys([*values, *(job.values[name] for job in jobs or ())])
        sizes[name] = optuna.distributions.CategoricalDistribution([label(value) for value in values])
    return sizes | floats


def label(value):
    """What stands for a value in the store, which takes no tuples."""
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
