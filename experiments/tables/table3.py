"""Table III: with and without language, the half of it that is hearing, the same robot muted, and one that is told what
is meant instead of hearing it said.

python -m experiments.tables.table3 --help
"""

from experiments.tables import table

METHODS = ("HSAC", "HSAC muted", "HSAC told what is meant", "HSAC that only hears", "HSAC without language")
PAIRS = [("HSAC", other) for other in METHODS[1:]] + [("HSAC that only hears", "HSAC without language")]


def main(arguments=None):
    """Entry point."""
    table.main("table3", METHODS, PAIRS, arguments)


if __name__ == "__main__":
    main()
