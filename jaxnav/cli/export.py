"""jaxnav export: a run's policy as a folder for a robot, and the check of such a folder."""

import dataclasses
import functools
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
    from ..export.of_run import export_run
    from ..training.run import Run

    folder = pathlib.Path(options.out or pathlib.Path(options.run) / "bundle")
    own = not options.out
    bundle.check_folder(folder, replace=own)
    add = [formats.add_onnx] if options.onnx else []
    if options.torchscript:
        add.append(functools.partial(formats.add_torchscript, python=options.torchscript))
    enable_compilation_cache()
    run = Run.open(options.run)
    policy = run.policy(options.policy)
    with Console(stderr=True).status("exporting"):
        export_run(run, policy, options.policy, folder, replace=own, add=add)
    print(f"{folder}: {sum(path.stat().st_size for path in folder.iterdir()) / 1e6:.1f} MB")
    print(f"check it here with jaxnav export --verify {folder}, on the robot with python3 policy.py --selftest")
