"""The skeleton of a study: a JSON file that grows row by row and is taken up again, its table, and a command line."""

import contextlib
import json
import pathlib
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import tyro
from rich.console import Console
from rich.progress import Progress

from jaxnav.errors import UserError
from jaxnav.files import write_atomically, write_json
from jaxnav.training import VALIDATION_SEED, Interrupted, Run, differences
from jaxnav.training.provenance import provenance
from jaxnav.training.train import train

RESULTS = pathlib.Path(__file__).parent / "results"


class Study:
    """Rows of a program by name, in a JSON file that is written after each of them.

    Rows that the file holds already are kept if it has the same ``identity``; each says of which commit and device it
    is. Everything else in the file is of the last call.

    program: the module's name below `experiments`; the last part of it names the files.
    identity: what has to be the same for the rows of the file to be kept.
    names: of all rows that there can be, in the order of the file.
    configs: by name the configuration that a row is of, of those rows that have one.
    field: what the rows are called in the file.

    UserError, before anything takes time: the folder ``out`` can't be made, or the file is of another configuration.
    """

    def __init__(
        self, program: str, out: pathlib.Path, identity: dict[str, Any], names: Iterable[str],
        configs: Callable[[str], Any] | None = None, field: str = "rows",
    ):  # fmt: skip
        make_folder(out)
        self.path = out / f"{program.rpartition('.')[2]}.json"
        self._names, self._configs, self._field = list(names), configs, field
        self.result = {"command": command(program), **identity, **provenance(), field: {}}
        self._source = {"git_commit": self.result["git_commit"], "device": self.result["device"]}
        self.rows = self.result[field] = stored(self.path, identity, field, {})
        for name, row in self.rows.items():
            self._check(name, row)

    def _check(self, name, row):
        if name not in self._names:
            raise UserError(f"{self.path} holds {name!r}, which is no row of this program: move it away")
        if self._configs is None:
            return
        changed = differences(row.get("config", {}), plain(self._configs(name)))
        if changed:
            raise UserError(
                f"{self.path} holds a {name} of another configuration ({', '.join(changed)} differ): move it away"
            )

    def missing(self, names: Iterable[str] | None = None) -> list[str]:
        """Those of ``names``, or of all rows, that the file doesn't hold."""
        return [name for name in (self._names if names is None else names) if name not in self.rows]

    def add(self, name: str, row: dict[str, Any]) -> None:
        """Add a row and write the file."""
        config = {} if self._configs is None else {"config": plain(self._configs(name))}
        self.rows[name] = row | config | self._source
        self.write()

    def drop(self, names: Iterable[str]) -> None:
        """Take rows out, and write the file at once: what follows may be interrupted."""
        for name in names:
            self.rows.pop(name, None)
        self.write()

    def write(self) -> None:
        """Write the JSON file, rows in the order of their names."""
        self.rows = self.result[self._field] = {name: self.rows[name] for name in self._names if name in self.rows}
        write_json(self.path, self.result)

    def finish(self, table: Callable[[dict], str], draw: Callable[[dict, pathlib.Path], None] | None = None) -> dict:
        """Write the JSON file, its Markdown and its picture beside it; returns the result."""
        self.write()
        write_atomically(self.path.with_suffix(".md"), table(self.result))
        if draw is not None:
            draw(self.result, self.path.with_suffix(".png"))
        return self.result


def command(program: str) -> str:
    """The command that starts a program."""
    return f"python -m experiments.{program}"


def sources(rows: Iterable[dict[str, Any]]) -> str:
    """Devices and commits of rows, for a table."""
    rows = list(rows)
    devices, commits = (sorted({str(row[name]) for row in rows}) for name in ("device", "git_commit"))
    return f"Device: {', '.join(devices)}; commit: {', '.join(commits)}."


def check_names(names: Iterable[str], option: str, known: Collection[str]) -> None:
    """UserError if one of the ``names`` that an option gives is unknown."""
    for name in names:
        if name not in known:
            raise UserError(f"{option} names {name!r}: choose from {', '.join(known)}")


def check_numbers(options: Any, *limits: tuple[str, int, int]) -> None:
    """UserError if one of the numbers of ``options`` is out of ``limits``: name, least, most."""
    for name, least, most in limits:
        if not least <= getattr(options, name) <= most:
            option = f"--{name.replace('_', '-')}"
            raise UserError(f"{option} is {getattr(options, name)}: give a whole number from {least} to {most}")


def check_multiples(options: Any, *steps: tuple[str, int]) -> None:
    """UserError if one of the numbers of ``options`` is no multiple: name, of what."""
    for name, of in steps:
        if getattr(options, name) % of:
            raise UserError(f"--{name.replace('_', '-')} is {getattr(options, name)}: give a multiple of {of}")


def check_seed(seed: int) -> None:
    """UserError: ``seed`` is none, or its episodes are those of validation."""
    if not 0 <= seed < 2**32:
        raise UserError(f"--seed is {seed}: give a whole number from 0 to {2**32 - 1}")
    if seed == VALIDATION_SEED:
        raise UserError(f"--seed is {seed}, of the validation episodes that choices were made on: give another")


def make_folder(out: pathlib.Path, option: str = "--out") -> None:
    """Make a folder, before anything takes time. UserError: it can't be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{option} is {out}: {error.strerror}: choose a folder that can be written") from None


def stored(path: pathlib.Path, identity: dict[str, Any], field: str, empty: Any) -> Any:
    """Read ``field`` of the JSON file ``path`` of an earlier call; ``empty`` if there is no such file.

    UserError: it is no result of the program, or of another configuration: its values of ``identity`` are others.
    """
    if not path.exists():
        return empty
    try:
        before = json.loads(path.read_text())
        changed = differences({name: before[name] for name in identity}, plain(identity))
        found = before[field]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path} is no result of this program ({error!r}): move it away") from None
    if changed:
        more = f" and {len(changed) - 5} more" if len(changed) > 5 else ""
        raise UserError(
            f"{path} is of another configuration ({', '.join(changed[:5])}{more} differ): give another --out, "
            "or move it away"
        )
    return found


def plain(value: Any) -> Any:
    """A value as JSON gives it back: tuples are lists."""
    return json.loads(json.dumps(value))


def console() -> Console:
    """Where programs say how they get on: lines of any length, their text as it is."""
    return Console(stderr=True, soft_wrap=True, markup=False, highlight=False)


@contextlib.contextmanager
def progress(console: Console, total: int, description: str) -> Iterator[Callable[[], None]]:
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


def trained(config, name: str, console: Console):
    """(run, actor) of a configuration, trained now as far as it isn't yet: its folder is taken up again."""
    run = Run(config)
    run.prepare_folder()

    def report(line):
        if "evaluation" in line:
            success = ", ".join(f"{scene} {rate:.3f}" for scene, rate in line["evaluation"].items())
            console.print(f"{name}: {line['env_steps'] / 1000:.0f}k steps, {success}")

    return run, run.policy("last", train(run, report, time.monotonic())).parameters


def main(options_class: Any, study: Callable, table: Callable[[dict], str], program: str, arguments=None) -> None:
    """Entry point of a program: prints the table of its study; exits with 2 after an error that the user can mend, with
    130 after Ctrl-C."""
    with exits():
        options = tyro.cli(options_class, args=arguments, prog=command(program))
        print(table(study(options)), end="")


@contextlib.contextmanager
def exits() -> Iterator[None]:
    """Turns errors into exit codes: 2 after one that the user can mend, 130 after Ctrl-C."""
    try:
        yield
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except (Interrupted, KeyboardInterrupt):
        print("interrupted: what is done is kept, the same command goes on", file=sys.stderr)
        sys.exit(130)
