"""python -m jaxnav.cli: the command line without its console script."""

from . import main

main()
