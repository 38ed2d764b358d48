"""The paired difference of two rows of a table or a study: of the seeds and episodes that both have."""

import numpy as np

from jaxnav.statistics import paired_difference, unpacked


def pair(one: dict, other: dict) -> dict | None:
    """The paired difference of success between two rows, by `paired_difference`; None if they have no seed in common.

    one, other: rows with `seeds`, `episodes` and `arrived`, which `packed` made. The other may be of a scripted robot,
    which has no budget: every seed is then compared with it. Rows with more episodes begin with the same ones.
    """
    episodes = min(one["episodes"], other["episodes"])
    ours, theirs = (unpacked(row["arrived"], episodes) for row in (one, other))
    if other["budget"] == "none":
        pairs = [(row, theirs[0]) for row in ours]
    else:
        by_seed = dict(zip(other["seeds"], theirs, strict=True))
        pairs = [(row, by_seed[seed]) for seed, row in zip(one["seeds"], ours, strict=True) if seed in by_seed]
    if not pairs:
        return None
    found = paired_difference(*map(np.array, zip(*pairs, strict=True)))
    return {
        **{field: one[field] for field in ("suite", "scene", "budget")}, "one": one["method"],
        "other": other["method"], "field": "success", **found,
    }  # fmt: skip
