"""The bundle: a folder with a trained policy that runs on any robot with torch and numpy, and checks itself there."""

import pathlib
import shutil
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import UserError, remedy
from ..language import dialogue_rules, phrases, sides, table
from ..training.run import Run
from .contract import TWIN, check_exportable, contract_of, encoder_of, network_inputs, twin_of
from .readme import readme_of
from .reference import Reference
from .seal import seal
from .weights import grid_tables, torch_weights

GOLDEN = 128  # recorded inputs and outputs
ROBOT = pathlib.Path(__file__).parent / "robot"  # its files travel in every bundle

_GOLDEN_SEED = 0x474F4C44  # of episodes and states; no seed of an evaluation
_REQUIREMENTS = """# What the bundle needs on a Jetson with JetPack 4.6 (Ubuntu 18.04, Python 3.6).
# NVIDIA's own wheel of torch 1.10 knows the GPU; any torch from 1.8 on runs the policy, on the CPU too.
# "Illegal instruction" from numpy on a Jetson: export OPENBLAS_CORETYPE=ARMV8
numpy>=1.13
torch>=1.8
"""


def write_bundle(
    run: Run,
    actor: Any,
    folder: str | pathlib.Path,
    origin: dict[str, Any],
    replace: bool = False,
    add: Sequence[Callable[[pathlib.Path], Any]] = (),
) -> None:
    """Write the bundle of a run's policy ``actor`` into ``folder``, whole or not at all.

    origin: where it comes from (`origin_of`); replace: whether it may replace another bundle; add: functions that add
    files to the finished folder (of `formats`).
    UserError: the folder holds something else, can't be written, the policy can't be exported, or something that is to
    be added can't be made.
    """
    folder = pathlib.Path(folder)
    check_exportable(run.agent)
    check_folder(folder, replace)
    # Beside the folder, so that it only has to be renamed; hidden, so that a half of it isn't taken for a bundle.
    temporary, old = (folder.with_name(f".{folder.name}.{word}") for word in ("new", "old"))
    try:
        for leftover in (temporary, old):
            shutil.rmtree(leftover, ignore_errors=True)
        temporary.mkdir(parents=True)
        contract = contract_of(run, origin)
        _fill(temporary, run, actor, contract)
        seal(temporary, contract)
        for function in add:
            function(temporary)
        if add:
            seal(temporary, contract)
        if folder.exists():
            folder.rename(old)
        temporary.rename(folder)
    except OSError as error:
        raise UserError(f"{folder} can't be written ({error.strerror}): {remedy(error)}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    shutil.rmtree(old, ignore_errors=True)


def check_folder(folder: pathlib.Path, replace: bool = False) -> None:
    """UserError: a bundle can't be written there without loss."""
    if folder.exists() and not folder.is_dir():
        raise UserError(f"--out {folder} is a file: give a folder")
    if folder.exists() and any(folder.iterdir()):
        if not (folder / "contract.json").exists():
            raise UserError(f"--out {folder} is not empty: give another --out")
        if not replace:
            raise UserError(f"--out {folder} already holds a bundle: give another --out")


def travelling() -> list[pathlib.Path]:
    """The Python files that every bundle has."""
    return [*sorted(ROBOT.glob("*.py")), *(pathlib.Path(str(module.__file__)) for module in (dialogue_rules, sides))]


def _fill(folder: pathlib.Path, run: Run, actor: Any, contract: dict[str, Any]) -> None:
    for path in travelling():
        shutil.copyfile(path, folder / path.name)
    source = twin_of(run.agent).source
    if source:
        (folder / f"{TWIN}.py").write_text(source, encoding="utf-8")
    weights = torch_weights(actor, run.agent.requests, encoder_of(run.agent))
    if "maps" in network_inputs(run):
        weights |= grid_tables(run.world.config.beams, run.params.robot_radius)
    _save(folder / "weights.npz", weights)
    reference = Reference(run, actor)
    inputs, outputs = reference.sample(reference.play(_GOLDEN_SEED), GOLDEN, _GOLDEN_SEED)
    _save(folder / "golden.npz", inputs | {f"out.{name}": value for name, value in outputs.items()})
    if run.agent.can_hear:
        shutil.copyfile(table.EMBEDDINGS, folder / "embeddings.npz")
        shutil.copyfile(phrases.PHRASES, folder / "phrases.csv")
    (folder / "requirements-jetson.txt").write_text(_REQUIREMENTS)
    (folder / "README.md").write_text(readme_of(contract), encoding="utf-8")


def _save(path: pathlib.Path, arrays: dict[str, Any]) -> None:
    np.savez_compressed(path, **arrays)
