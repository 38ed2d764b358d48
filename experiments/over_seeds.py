"""Numbers over seeds: means, interquartile means and their bootstrap intervals."""

import numpy as np
from scipy.stats import bootstrap, trim_mean

from jaxnav.statistics import wilson_interval

RESAMPLES = 9999
REACHED = 0.95  # success of a run that learnt its scene


def measure(per_seed, trials=None):
    """A measure over seeds: `mean`, its `ci95`, `per_seed`, `iqm` (interquartile mean); of proportions `wilson95`, too.

    ci95 is the percentile bootstrap's over seeds; with one seed it is Wilson's of a proportion, else None.

    per_seed: a value each, None where there is none. The rest is of the others, None if there are none.
    trials: episodes that each seed played, where values are proportions of them.
    Raises ValueError: a value isn't finite.
    """
    values = [None if value is None else float(value) for value in per_seed]
    known = np.sort(np.array([value for value in values if value is not None]))  # seeds have no order
    if not np.isfinite(known).all():
        raise ValueError(f"per_seed is {values}: leave out what isn't finite")
    result = {"mean": None, "ci95": None, "per_seed": values, "iqm": None}
    if trials is not None:
        result["wilson95"] = [None if v is None else wilson_interval(round(v * trials), trials) for v in values]
    if known.size:
        result |= {"mean": _inside(known, known.mean()), "iqm": _inside(known, trim_mean(known, 0.25))}
    if known.size > 1:
        found = bootstrap((known,), np.mean, n_resamples=RESAMPLES, method="percentile", random_state=0)
        result["ci95"] = _inside(known, found.confidence_interval)
    elif known.size and trials is not None:
        result["ci95"] = wilson_interval(round(known[0] * trials), trials)
    return result


def _inside(values, means):
    """Means of values, which may be rounded away from equal ones."""
    return np.clip(means, values.min(), values.max()).tolist()


def suite_iqm(rows):
    """Interquartile mean of success over runs (a seed in a scene each), as rliable's (Agarwal et al. 2021).

    rows: of one method, suite and budget, a scene each. Returns `iqm`, its `ci95` (bootstrap stratified by scene; None
    where no scene has two seeds) and what they hide: `min` and `reached`, the share of runs with success >= `REACHED`;
    `runs` and `scenes` say how many there are. None: no run is left.
    """
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
        "min": float(runs.min()), "reached": float(np.mean(runs >= REACHED)), "runs": runs.size, "scenes": len(scenes),
    }  # fmt: skip
