"""The error a user can mend."""


class UserError(Exception):
    """One line that names the field or file and the remedy; the command line prints it and exits with code 2."""
