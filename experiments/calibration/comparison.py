"""How well a calibrated crowd predicts held-out people, next to constant velocity and to ORCA as it comes."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxnav import Params
from jaxnav.world.people.recording import ANNOTATION_PERIOD

from . import measures
from .fit import Descent, fit
from .model import Behaviour, Setting

SETTING = Setting(dt=ANNOTATION_PERIOD)
CONSTANT_VELOCITY = "constant velocity"
CALIBRATED = "calibrated ORCA"
_FOREVER = 1e6  # seconds

# Starting values are drawn from these ranges, log-uniform, in the order of the fields of `Behaviour`.
_RANGES = ((0.7, 2.0), (0.7, 4.0), (1.0, 6.0), (0.1, 0.35), (0.3, 2.0), (2.0, 20.0))


def predictors(calibrated):
    """Name -> `Behaviour` of all that are compared. All see the same frames; none sees the future."""
    world = Params()
    nobody = {"awareness": 0.0}
    return {
        CONSTANT_VELOCITY: calibrated._replace(**nobody, memory=1e-3, relaxation=_FOREVER),
        "constant velocity, mean of all observed": calibrated._replace(
            **nobody, memory=_FOREVER, relaxation=_FOREVER
        ),
        # But for the top speed, which has to leave everybody as fast as they were seen.
        "ORCA, defaults of the world": Behaviour(
            world.preferred_speed, world.neighbor_distance, world.time_horizon, world.body_radius
        ),
        # 10 m, 5 s and 0.3 m are what CrowdNav (Chen et al. 2019) sets; 1 m/s would be far below these people.
        "ORCA, CrowdNav's values, own velocity": Behaviour(1.0, 10.0, 5.0, 0.3, memory=1e-3, relaxation=_FOREVER),
        "calibrated, avoiding nobody": calibrated._replace(**nobody),
        CALIBRATED: calibrated,
    }  # fmt: skip


def study(training, held_out, starts, steps, seed, report):
    """The contents of `calibrate_eth.json`: the fit, and errors of every predictor. report: called after each step."""
    draws = np.random.default_rng(seed).uniform(size=(len(_RANGES), starts))
    low, high = np.log(_RANGES).T[..., None]
    start = Behaviour(*jnp.asarray(np.exp(low + draws * (high - low)), jnp.float32))
    fitted, _ = fit(
        jax.random.key(seed), start, training, SETTING, Descent(Behaviour._fields, steps), lambda *_: report()
    )
    # Batches differ: what decides is the loss over all training people, with the threshold.
    fits = [Behaviour(*(float(leaf[n]) for leaf in fitted)) for n in range(starts)]
    totals = [float(measures.by_person(measures.displacement(one, training, SETTING), training).mean()) for one in fits]
    best = fits[int(np.argmin(totals))]
    curves = {
        name: measures.by_person(measures.displacement(behaviour, held_out, SETTING), held_out)
        for name, behaviour in predictors(best).items()
    }
    gains = {
        name: _intervals(measures.errors(curve) - measures.errors(curves[CALIBRATED]), seed)
        for name, curve in curves.items()
        if name != CALIBRATED
    }
    return {
        "people": {"training": _people(training), "held_out": _people(held_out)},
        "windows": {"training": len(training.instant), "held_out": len(held_out.instant)},
        "calibrated": _rounded(best._asdict()),
        "starts": [_rounded(Behaviour(*(float(leaf[n]) for leaf in start))._asdict()) for n in range(starts)],
        "fits": [
            _rounded(one._asdict() | {"training_ade": total}) for one, total in zip(fits, totals, strict=True)
        ],
        "predictors": {name: _intervals(measures.errors(curve), seed) for name, curve in curves.items()},
        "gain_of_calibration": gains,
        "seconds": (SETTING.dt * np.arange(1, held_out.future.shape[2] + 1)).round(3).tolist(),
        "curves": {
            name: np.stack(measures.bootstrap(curve, seed)).round(4).tolist() for name, curve in curves.items()
        },
        "held_out_ade": {name: measures.errors(curve)[:, 0].round(4).tolist() for name, curve in curves.items()},
    }  # fmt: skip


def _people(windows):
    return len(np.unique(windows.person[windows.weight > 0]))


def _intervals(errors, seed):
    """{"ade": [mean, low, high], "fde": ...} of errors `[N, 2]`."""
    table = np.stack(measures.bootstrap(errors, seed), axis=1).round(4).tolist()
    return dict(zip(("ade", "fde"), table, strict=True))


def _rounded(numbers):
    return {name: round(value, 4) for name, value in numbers.items()}
