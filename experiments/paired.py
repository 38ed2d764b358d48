"""Which episodes arrived, kept in a row, and the paired difference of two rows."""

import base64
import math

import numpy as np

from experiments import over_seeds


def packed(arrived):
    """Which episodes `[seeds, episodes]` arrived, a string a seed: what paired differences are made of."""
    return [base64.b64encode(np.packbits(row).tobytes()).decode() for row in arrived]


def unpacked(row):
    """Arrived `[seeds, episodes]` of a row, 0 or 1; a scripted robot has one row."""
    bits = [np.frombuffer(base64.b64decode(text), np.uint8) for text in row["arrived"]]
    return [np.unpackbits(part)[: row["episodes"]].astype(int) for part in bits]


def pair(one, other):
    """The paired difference of success between two rows, over the episodes and seeds that both have; None if none.

    other: may be of a scripted robot, with which every seed is compared.

    Of its intervals one is over episodes, as if these seeds were all there are: all seeds play the same episodes, so
    that their mean is what varies from one to the next. The other is over seeds.
    """
    ours = dict(zip(one["seeds"], unpacked(one), strict=True))
    if other["budget"] == "none":
        theirs = dict.fromkeys(ours, unpacked(other)[0])
    else:
        theirs = dict(zip(other["seeds"], unpacked(other), strict=True))
    episodes = min(one["episodes"], other["episodes"])  # the first n of more episodes are the same n
    both = [ours[seed][:episodes] - theirs[seed][:episodes] for seed in ours if seed in theirs]
    if not both:
        return None
    difference = np.mean(both, axis=0)
    return {
        **{field: one[field] for field in ("suite", "scene", "budget")}, "one": one["method"],
        "other": other["method"], "field": "success", "difference": float(difference.mean()),
        "ci95_half": float(1.96 * difference.std() / math.sqrt(episodes)), "episodes": episodes, "seeds": len(both),
        "seeds_ci95": over_seeds.measure([float(seed.mean()) for seed in both])["ci95"],
    }  # fmt: skip
