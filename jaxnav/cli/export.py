"""jaxnav export: a run's policy as a folder for a robot, and the check of such a folder."""

import dataclasses
import functools
import pathlib
from collections.abc import Callable
from typing import Any

from rich.console import Console

from .. import fields
from ..errors import UserError
from .options import Flag, PolicyOptions, RunFolder, enable_compilation_cache, open_run, parse, scene_field


@dataclasses.dataclass(frozen=True)
class _Options(PolicyOptions):
    """Write a run's policy as a folder that a robot can run with torch and numpy alone, or check such a folder.

    On the robot: python3 policy.py --selftest; README.md in the folder says the rest.
    """

    run: RunFolder = fields.text("", allowed="a path", doc="the run's folder")
    scene: str = scene_field("that the inputs of its self-test come from, if not those of training")
    out: str = fields.text("", allowed="a path", doc="folder to write; without it RUN/bundle, which is replaced")
    onnx: Flag = fields.flag(
        False, doc='add policy.onnx, opset 13, checked with onnxruntime; needs pip install "jaxnav[export]"'
    )
    torchscript: str = fields.text(
        "", allowed="a path", doc="a Python that has torch 1.10 or older, which writes policy.pt beside the rest"
    )
    verify: str = fields.text("", allowed="a path", doc="bundle to check; nothing is written")


_EXAMPLES = """\
  jaxnav export runs/quick-0                       writes runs/quick-0/bundle
  jaxnav export --verify runs/quick-0/bundle       hashes, contract, and the recorded outputs once more
"""


def command(arguments: list[str]) -> None:
    options = parse(_Options, arguments, "export", _EXAMPLES)
    if options.verify:
        if options.run or options.scene or options.out or options.onnx or options.torchscript:
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

    folder = pathlib.Path(options.out or pathlib.Path(options.run) / "bundle")
    own = not options.out
    bundle.check_folder(folder, replace=own)
    add: list[Callable[..., Any]] = [formats.add_onnx] if options.onnx else []
    if options.torchscript:
        add.append(functools.partial(formats.add_torchscript, python=options.torchscript))
    enable_compilation_cache()
    opened = open_run(options.run, options.policy, options.scene)
    with Console(stderr=True).status("exporting"):
        export_run(opened.run, opened.policy, options.policy, folder, replace=own, add=add)
    print(f"{folder}: {sum(path.stat().st_size for path in folder.iterdir()) / 1e6:.1f} MB")
    print(f"check it here with jaxnav export --verify {folder}, on the robot with python3 policy.py --selftest")
