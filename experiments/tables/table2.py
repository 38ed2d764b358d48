"""Table II: two requests, none and stop, against four.

python -m experiments.tables.table2 --help
"""

import dataclasses

from experiments.tables import table
from jaxnav.agents import LEARNERS
from jaxnav.errors import UserError


@dataclasses.dataclass(frozen=True)
class Options(table.Options):
    __doc__ = f"{table.Options.__doc__}    algo: the learner whose requests are counted; only hsac has any.\n    "

    algo: str = "hsac"

    def __post_init__(self):
        super().__post_init__()
        if self.algo not in LEARNERS:
            raise UserError(f"--algo {self.algo!r} is unknown: choose hsac")
        if self.algo != "hsac":
            raise UserError(f"--algo is {self.algo}: it emits no requests, and Table II compares requests; choose hsac")


def main(arguments=None):
    """Entry point."""
    table.main("table2", ("HSAC", "HSAC, 2 requests"), [("HSAC", "HSAC, 2 requests")], arguments, Options)


if __name__ == "__main__":
    main()
