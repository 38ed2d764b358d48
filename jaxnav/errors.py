"""The error a user can mend."""

import errno


class UserError(Exception):
    """One line that names the field or file and the remedy; the command line prints it and exits with code 2."""


def remedy(error: Exception) -> str:
    """The remedy for an error of writing a file."""
    full = getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    # Libraries below Orbax pass on the text of the system's error alone.
    return "free some space" if full or "No space left" in str(error) else "make it writable"
