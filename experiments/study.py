"""What studies of many scenes share: a file that grows scene by scene and is taken up again, and a command line."""

import json
import pathlib
import sys
import time

import tyro
from rich.console import Console
from rich.progress import Progress

from jaxnav.errors import UserError
from jaxnav.training.dataclass_json import differences
from jaxnav.training.provenance import provenance
from jaxnav.training.run import VALIDATION_SEED, Interrupted
from jaxnav.world import SCENES

RESULTS = pathlib.Path(__file__).parent / "results"


def check_options(options, limits):
    """UserError if ``options`` names an unknown scene or one of its numbers is out of ``limits``: name, least, most."""
    check_names(options.scenes, "--scenes", SCENES)
    check_numbers(options, limits)


def check_names(names, option, known):
    """UserError if one of the ``names`` that an option gives is unknown."""
    for name in names:
        if name not in known:
            raise UserError(f"{option} names {name!r}: choose from {', '.join(known)}")


def check_numbers(options, limits):
    """UserError if one of the numbers of ``options`` is out of ``limits``: name, least, most."""
    for name, least, most in limits:
        if not least <= getattr(options, name) <= most:
            option = f"--{name.replace('_', '-')}"
            raise UserError(f"{option} is {getattr(options, name)}: give a whole number from {least} to {most}")


def check_unseen(seed):
    """UserError: the episodes of that seed are those of validation."""
    if seed == VALIDATION_SEED:
        raise UserError(f"--seed is {seed}, of the validation episodes that choices were made on: give another")


def make_folder(out, option="--out"):
    """Make a folder, before anything takes time. UserError: it can't be."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{option} is {out}: {error.strerror}: choose a folder that can be written") from None


def study(out, program, settings, names, blocks, play_scene, table, draw):
    """Play the scenes that the JSON file of a program lacks, and write its .json, .md and .png into the folder ``out``.

    settings: what has to be the same for a scene in the file to be kept, beside the commit; they are written, too.
    play_scene: a function (name, advance) -> what is written of a scene; it calls ``advance`` ``blocks`` times.
    table, draw: functions (result) -> Markdown and (result, path). Returns the result.
    """
    make_folder(out)
    path = out / f"{program}.json"
    result = {"command": f"python experiments/{program}.py", **settings, **provenance(), "scenes": {}}
    if path.exists():
        result["scenes"] = _scenes_to_keep(path, result, [*settings, "git_commit"])
    missing = [name for name in names if name not in result["scenes"]]
    with Progress(console=Console(stderr=True)) as bar:
        task = bar.add_task("", total=len(missing) * blocks)
        for name in missing:
            bar.update(task, description=name)
            start = time.monotonic()
            found = play_scene(name, lambda: bar.advance(task))
            result["scenes"][name] = found | {"wall_seconds": round(time.monotonic() - start, 1)}
            result["scenes"] = {scene: result["scenes"][scene] for scene in SCENES if scene in result["scenes"]}
            write(path, result)
    path.with_suffix(".md").write_text(table(result))
    draw(result, path.with_suffix(".png"))
    return result


def _scenes_to_keep(path, result, identity):
    try:
        before = json.loads(path.read_text())
        # The mark of uncommitted changes is left out: the file itself is one, once it is committed.
        same = all(str(before[name]).rstrip("+") == str(result[name]).rstrip("+") for name in identity)
        return before["scenes"] if same else {}
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path} is no result of this program ({error!r}): move it away") from None


def stored(path, identity, field, empty):
    """What an earlier call left in ``field`` of the JSON file ``path``; ``empty`` if there is no such file.

    UserError: it is no result of the program, or of another configuration: its values of ``identity`` are others.
    """
    if not path.exists():
        return empty
    try:
        before = json.loads(path.read_text())
        changed = differences({name: before[name] for name in identity}, json.loads(json.dumps(identity)))
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


def write(path, value):
    """Write a JSON file: an interruption leaves the old one or the new one."""
    whole = path.with_suffix(".new")
    whole.write_text(json.dumps(value, indent=1) + "\n")
    whole.replace(path)


def main(options_class, study, table, program, arguments):
    """Entry point of a program: prints the table of its study; exits with 2 after an error that the user can mend, with
    130 after Ctrl-C."""
    try:
        options = tyro.cli(options_class, args=arguments, prog=f"python experiments/{program}.py")
        print(table(study(options)), end="")
    except UserError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except (Interrupted, KeyboardInterrupt):
        print("interrupted: what is done is kept, the same command goes on", file=sys.stderr)
        sys.exit(130)
