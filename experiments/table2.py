"""Table II: two codes, none and stop, against four.

python experiments/table2.py --help
"""

import tables


def main(arguments=None):
    """Entry point."""
    tables.main("table2", ("HSAC", "HSAC, 2 codes"), [("HSAC", "HSAC, 2 codes")], arguments)


if __name__ == "__main__":
    main()
