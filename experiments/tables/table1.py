"""Table I: methods x scenes, with the paper's steps and with more.

python -m experiments.tables.table1 --help
"""

from experiments.tables import table

METHODS = ("HSAC", "TD3", "PPO", "A2C")


def main(arguments=None):
    """Entry point."""
    table.main("table1", METHODS, [("HSAC", other) for other in (*METHODS[1:], "planner")], arguments)


if __name__ == "__main__":
    main()
