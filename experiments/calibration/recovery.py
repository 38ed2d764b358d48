"""Can a fit find parameters that are known? Simulated walkers, several truths, starting values that are far off."""

import jax
import jax.numpy as jnp
import numpy as np

from . import simulated
from .fit import Descent, fit
from .model import Behaviour

FITTED = ("preferred_speed", "awareness", "time_horizon", "radius")

# Truths are drawn from these ranges: m/s, m, s, m. A world keeps starts 0.3 m clear of walls, hence the radius.
_RANGES = ((0.7, 1.4), (1.0, 3.0), (1.5, 5.0), (0.12, 0.28))
_OFF = 0.3, 0.6  # least and largest relative error of a starting value, either way


def study(truths, starts, walkers, episodes, steps, noise, seed, report):
    """Truths, starts and fits, as in `calibrate_simulated.json`. report: called after each step."""
    rows = []
    for number in range(truths):
        generator = np.random.default_rng((seed, number))
        truth = Behaviour(*(float(generator.uniform(*bounds)) for bounds in _RANGES))
        rows.append({"truth": dict(zip(FITTED, truth, strict=False))} | _recover(
            truth, generator, jax.random.key(seed + number), starts, walkers, episodes, steps, noise, report
        ))  # fmt: skip
    largest = {name: max(abs(row["relative_error"][name]) for row in rows) for name in FITTED}
    return {"largest_error": largest, "truths": rows}


def _recover(truth, generator, key, starts, walkers, episodes, steps, noise, report):
    key_record, key_fit = jax.random.split(key)
    windows = simulated.record(key_record, truth, walkers, episodes, noise=noise)
    off = 1.0 + generator.choice((-1.0, 1.0), (starts, len(FITTED))) * generator.uniform(*_OFF, (starts, len(FITTED)))
    values = np.array(truth[: len(FITTED)]) * off
    start = Behaviour(
        *jnp.asarray(values.T, jnp.float32), memory=jnp.full(starts, truth.memory), relaxation=jnp.zeros(starts)
    )
    path = []

    def keep(step, _, behaviour):
        if step % max(1, steps // 100) == 0:
            path.append([step, *(np.asarray(getattr(behaviour, name)) for name in FITTED)])
        report()

    fitted, losses = fit(key_fit, start, windows, simulated.setting(walkers), Descent(FITTED, steps), keep)
    ends = np.stack([np.asarray(getattr(fitted, name)) for name in FITTED], axis=1)
    error = ends / np.array(truth[: len(FITTED)]) - 1.0
    best = int(np.argmin(losses))
    return {
        "relative_error": dict(zip(FITTED, error[best].round(6).tolist(), strict=True)),
        "best": best,
        "starts": [dict(zip(FITTED, row, strict=True)) for row in values.round(6).tolist()],
        "fits": [dict(zip(FITTED, row, strict=True)) for row in ends.round(6).tolist()],
        "losses": np.asarray(losses).round(8).tolist(),
        "path": {
            "step": [row[0] for row in path],
            **{name: np.stack([row[1 + i] for row in path]).round(4).tolist() for i, name in enumerate(FITTED)},
        },
    }
