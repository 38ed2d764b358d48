"""Table III: with and without language, the same robot muted, and told what is meant instead of hearing it said.

python experiments/table3.py --help
"""

import tables

METHODS = ("HSAC", "HSAC muted", "HSAC told what is meant", "HSAC without language")


def main(arguments=None):
    """Entry point."""
    tables.main("table3", METHODS, [("HSAC", other) for other in METHODS[1:]], arguments)


if __name__ == "__main__":
    main()
