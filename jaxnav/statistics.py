"""Numbers and how certain they are: proportions, means over seeds, paired differences. Pure numpy and scipy."""

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

RESAMPLES = 9999  # of a bootstrap
REACHED = 0.95  # success of a run that learnt its scene

_Z95 = 1.959964


def sign(direction: str) -> int:
    """1 of what is maximised, -1 of what is minimised: ``sign(direction) * value`` is the more, the better.

    direction: maximize or minimize. ValueError: neither.
    """
    if direction not in ("maximize", "minimize"):
        raise ValueError(f"direction is {direction!r}: give maximize or minimize")
    return 1 if direction == "maximize" else -1


def wilson_interval(successes: int, trials: int, z: float = _Z95) -> list[float]:
    """95 % confidence interval [low, high] of a proportion (Wilson 1927)."""
    if trials == 0:
        return [0.0, 1.0]
    p, z2 = successes / trials, z * z
    centre = (p + z2 / (2 * trials)) / (1 + z2 / trials)
    half = z / (1 + z2 / trials) * math.sqrt(p * (1 - p) / trials + z2 / (4 * trials * trials))
    # At both ends the interval closes there exactly, without an error of rounding.
    return [0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half]


def mean_or_none(values: np.ndarray) -> float | None:
    """The mean as a float, None of no values."""
    return float(np.mean(values)) if values.size else None


def bootstrap_interval(values: np.ndarray) -> list[float] | None:
    """95 % percentile bootstrap interval [low, high] of the mean of values `[n]`; None of fewer than two."""
    from scipy.stats import bootstrap

    if values.size < 2:
        return None
    values = np.sort(values)  # seeds have no order
    seeded: Any = {"random_state": 0}  # which scipy's types lack
    drawn = bootstrap((values,), np.mean, n_resamples=RESAMPLES, method="percentile", **seeded)
    return _inside(values, drawn.confidence_interval)


def measure(per_seed: Iterable[float | None], trials: int | None = None) -> dict[str, Any]:
    """A measure over seeds: `mean`, its `ci95`, `per_seed`, `iqm` (interquartile mean), and of proportions `wilson95`.

    ci95 is the percentile bootstrap's over seeds; with one seed it is Wilson's of a proportion, else None.

    per_seed: a value each, None where there is none; these count in nothing else.
    trials: episodes that each seed played, where values are proportions of them.
    Raises ValueError: a value isn't finite.
    """
    from scipy.stats import trim_mean

    values = [None if value is None else float(value) for value in per_seed]
    known = np.sort(np.array([value for value in values if value is not None]))
    if not np.isfinite(known).all():
        raise ValueError(f"per_seed is {values}: leave out what isn't finite")
    result: dict[str, Any] = {"mean": None, "ci95": None, "per_seed": values, "iqm": None}
    if trials is not None:
        result["wilson95"] = [None if v is None else wilson_interval(round(v * trials), trials) for v in values]
    if known.size:
        result |= {"mean": _inside(known, known.mean()), "iqm": _inside(known, trim_mean(known, 0.25))}
    if known.size == 1 and trials is not None:
        result["ci95"] = wilson_interval(round(known[0] * trials), trials)
    else:
        result["ci95"] = bootstrap_interval(known)
    return result


def suite_iqm(rows: Iterable[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Interquartile mean of success over runs (a seed in a scene each), as rliable's (Agarwal et al. 2021).

    rows: of one method, suite and budget, one for each scene. Returns `iqm`, its `ci95` (bootstrap stratified by scene;
    None where no scene has two seeds), `min`, `reached` (the share of runs with success >= `REACHED`), and the numbers
    of `runs` and `scenes`. None: no run is left.
    """
    from scipy.stats import trim_mean

    # In an order of their own: a result doesn't depend on that of rows or seeds.
    rows = sorted(rows, key=lambda row: row["scene"])
    scenes = [np.sort(row["success"]["per_seed"]) for row in rows if row["success"]["per_seed"]]
    if not scenes:
        return None
    runs, generator = np.concatenate(scenes), np.random.default_rng(0)
    # Not scipy's `bootstrap`, which refuses a scene with one seed left.
    resampled = [scene[generator.integers(scene.size, size=(RESAMPLES, scene.size))] for scene in scenes]
    iqms = trim_mean(np.concatenate(resampled, axis=1), 0.25, axis=1)
    return {
        "iqm": _inside(runs, trim_mean(runs, 0.25)),
        "ci95": _inside(runs, np.percentile(iqms, (2.5, 97.5))) if runs.size > len(scenes) else None,
        "min": float(runs.min()),
        "reached": float(np.mean(runs >= REACHED)),
        "runs": runs.size,
        "scenes": len(scenes),
    }


def packed(arrived: Iterable[np.ndarray]) -> list[str]:
    """Which episodes `[seeds, episodes]` arrived, one string for each seed: what paired differences are made of."""
    return [base64.b64encode(np.packbits(row).tobytes()).decode() for row in arrived]


def unpacked(arrived: Sequence[str], episodes: int) -> list[np.ndarray]:
    """The inverse of `packed`: 0 or 1, `[episodes]` for each seed."""
    bits = [np.frombuffer(base64.b64decode(text), np.uint8) for text in arrived]
    return [np.unpackbits(part)[:episodes].astype(int) for part in bits]


def paired_difference(one: np.ndarray, other: np.ndarray) -> dict[str, Any]:
    """How much more often ``one`` succeeds than ``other`` on the same episodes `[seeds, episodes]` or `[episodes]`.

    Returns `difference`, `ci95` [low, high] and `ci95_half` over episodes, as if these seeds were all there are: all
    seeds play the same episodes, so that their mean is what varies from one to the next. `seeds_ci95` is the
    bootstrap's over seeds, None of one; `episodes` and `seeds` say how many there are.
    """
    by_seed = np.atleast_2d(np.asarray(one, float) - np.asarray(other, float))
    by_episode = by_seed.mean(axis=0)
    mean, half = float(by_episode.mean()), float(1.96 * by_episode.std() / math.sqrt(by_episode.size))
    return {
        "difference": mean,
        "ci95": [mean - half, mean + half],
        "ci95_half": half,
        "episodes": by_episode.size,
        "seeds": len(by_seed),
        "seeds_ci95": bootstrap_interval(by_seed.mean(axis=1)),
    }


def _inside(values: np.ndarray, means: Any) -> Any:
    """Means of ``values``, which may be rounded away from equal ones."""
    return np.clip(means, values.min(), values.max()).tolist()
