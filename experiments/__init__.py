"""Studies: each a program that is run from the repository's root as `python -m experiments.NAME`; see README.md."""
