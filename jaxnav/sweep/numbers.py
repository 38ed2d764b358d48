"""Numbers and names of a report, as text."""


def number(value, signed=False):
    """A measured value with three decimals, or, where it is large, with fewer."""
    if value is None:
        return "-"
    return f"{value:{'+' if signed else ''},.{3 if abs(value) < 10 else 1 if abs(value) < 1000 else 0}f}"


def with_interval(value, interval, signed=False):
    """A measured value, in brackets its interval, if it has one."""
    if interval is None:
        return number(value, signed)
    return f"{number(value, signed)} ({number(interval[0], signed)} to {number(interval[1], signed)})"


def searched(value):
    """A value of what was searched: of a float four digits."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def name_of(trial):
    """What a candidate is called. trial: its number in the search, None for base."""
    return "base" if trial is None else f"trial {trial}"
