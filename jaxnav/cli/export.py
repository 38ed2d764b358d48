"""jaxnav export: a run's policy as a folder for a robot, and the check of such a folder."""

import dataclasses
import functools
import json
import pathlib
from typing import Annotated

import tyro
from rich.console import Console

from ..errors import UserError
from .options import check_policy, enable_compilation_cache, parse


@dataclasses.dataclass(frozen=True)
class _ExportOptions:
    """Write a run's policy as a folder that a robot can run with torch and numpy alone, or check such a folder.

    jaxnav export runs/quick-0                       writes runs/quick-0/bundle
    jaxnav export --verify runs/quick-0/bundle       hashes, contract, and the recorded outputs once more
    On the robot: python3 policy.py --selftest; README.md in the folder says the rest.

    Args:
        run: the run's folder.
        out: the folder to write; RUN/bundle if not given, which is replaced if it is there.
        policy: last, or best: the one with the best evaluation during training.
        onnx: add policy.onnx, opset 13, checked with onnxruntime (pip install "jaxnav[export]").
        torchscript: a Python that has torch 1.10 or older: add policy.pt, written by it.
        verify: a bundle to check instead of writing one.
    """

    run: Annotated[str, tyro.conf.Positional] = ""
    out: str = ""
    policy: str = "last"
    onnx: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    torchscript: str = ""
    verify: str = ""


def command(arguments):
    options = parse(_ExportOptions, arguments, "export")
    check_policy(options.policy)
    if options.verify:
        if options.run or options.out or options.onnx or options.torchscript:
            raise UserError("--verify checks a bundle and writes nothing: give it alone")
        from ..export.verify import verify

        with Console(stderr=True).status("verifying"):
            said = verify(options.verify)
        print(f"{options.verify} is whole; {said}")
        return
    if not options.run:
        raise UserError("no run is given: jaxnav export RUN, or jaxnav export --verify BUNDLE")
    from ..export import bundle, formats
    from ..training.run import Run

    folder = pathlib.Path(options.out or pathlib.Path(options.run) / "bundle")
    own = not options.out
    bundle.check_folder(folder, replace=own)
    add = [formats.add_onnx] if options.onnx else []
    if options.torchscript:
        add.append(functools.partial(formats.add_torchscript, python=options.torchscript))
    enable_compilation_cache()
    run = Run.open(options.run)
    actor = run.actor(run.restore(), options.policy)
    with Console(stderr=True).status("exporting"):
        write(run, actor, options.policy, folder, replace=own, add=add)
    print(f"{folder}: {sum(path.stat().st_size for path in folder.iterdir()) / 1e6:.1f} MB")
    print(f"check it here with jaxnav export --verify {folder}, on the robot with python3 policy.py --selftest")


def write(run, actor, policy, folder, replace=True, add=()):
    """Write the bundle of a run's policy, with what its folder knows of where it comes from."""
    from ..export.bundle import write_bundle
    from ..export.contract import origin_of

    stored, evaluation = (_read(run.folder / name) for name in ("config.json", "evaluation.json"))
    if evaluation and evaluation.get("policy") != policy:
        evaluation = None  # it is the other one's
    write_bundle(run, actor, folder, origin_of(run, policy, stored or {}, evaluation), replace, add)


def _read(path):
    """A JSON file of a run; None if there is none, or it can't be read: it tells of a policy, and is no part of it."""
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return None
