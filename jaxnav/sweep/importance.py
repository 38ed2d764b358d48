"""How much each searched value mattered, by Optuna's PED-ANOVA (Watanabe et al. 2023)."""

import warnings
from typing import Any

import numpy as np

LEAST = 10  # trials, below which shares are noise
BETTER = 0.5  # a smaller part of the trials needs more of them: with 20 a tenth named the right value in half of cases


def importance(results):
    """Shares of what the better half of the trials has in common, compared with all: {name: share}, the largest first.

    Of trials that are complete or stopped, after the steps of the first rung, which all of them have: later ones know
    only what was let go on. Without rungs, of complete ones at their end.

    Returns `shares` (None if they can't be known, with `why`), `trials`, how many were compared, and `env_steps`, after
    which.
    """
    identity = results.identity
    steps = (identity["rungs"] or [identity["base"]["train"]["total_steps"]])[0]
    env_steps = steps * identity["base"]["train"]["episodes"]
    # Base may lie outside of what was searched.
    known = [
        (trial.values, objective)
        for trial in results.phases.get("search", ())
        if trial.state in ("complete", "stopped") and _inside(trial.values, identity)
        for objective in [_at(trial, env_steps)]
        if objective is not None
    ]
    found = {"shares": None, "trials": len(known), "env_steps": env_steps}
    if len(known) < LEAST:
        return found | {"why": f"fewer than {LEAST} trials can be compared"}
    if len({objective for _, objective in known}) == 1:
        return found | {"why": "all trials are equally good"}
    shares = _shares(known, identity)
    return found | ({"shares": shares} if shares else {"why": "more than half of the trials are equally good"})


def _at(trial, env_steps):
    """The objective after those steps; None if the trial hasn't one."""
    for row in trial.curve:
        if row["env_steps"] == env_steps and row["objective"] is not None and np.isfinite(row["objective"]):
            return row["objective"]
    return None


def _inside(values, identity):
    floats = all(found["low"] <= values[name] <= found["high"] for name, found in identity["space"].items())
    return floats and all(_label(values[name]) in map(_label, choices) for name, choices in identity["sizes"].items())


def _label(value):
    return str(list(value)) if isinstance(value, tuple | list) else str(value)


def _shares(known, identity):
    import optuna
    from optuna.distributions import CategoricalDistribution, FloatDistribution

    kinds: dict[str, Any] = {name: FloatDistribution(**found) for name, found in identity["space"].items()}
    kinds |= {name: CategoricalDistribution([_label(v) for v in values]) for name, values in identity["sizes"].items()}
    before = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)  # or each report begins with a line on a study in memory
    try:
        study = optuna.create_study(direction=identity["direction"])
        for values, objective in known:
            params = {name: values[name] if name in identity["space"] else _label(values[name]) for name in kinds}
            study.add_trial(optuna.trial.create_trial(params=params, distributions=kinds, value=objective))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            evaluator = optuna.importance.PedAnovaImportanceEvaluator(target_quantile=BETTER)
            shares = optuna.importance.get_param_importances(study, evaluator=evaluator)
    finally:
        optuna.logging.set_verbosity(before)
    # Where ties leave no better half, it warns and gives equal shares, which mean nothing.
    return None if any("equal" in str(warning.message) for warning in told) else shares
