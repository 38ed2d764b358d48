"""The importance of each searched value, by Optuna's PED-ANOVA (Watanabe et al. 2023)."""

import math
from typing import Any

import numpy as np

from .results import Results, Trial

LEAST = 10  # with fewer trials shares are noise
BETTER = 0.5  # a smaller share needs more trials: the best tenth of 20 found the right value of five half the time


def importance(results: Results) -> dict[str, Any]:
    """Shares by which the values of the better half of the trials stand out from those of all trials.

    Complete and stopped trials are compared after the steps of the first rung, which all of them have: later
    measurements exist only for trials that went on. Without rungs complete trials are compared at their end. Where most
    trials are equally bad, the better half are only those that are better.

    shares:    {name: share}, the largest first, None if they can't be known.
    why:       the reason why not.
    trials:    number of trials that were compared.
    better:    number of the better ones among them.
    env_steps: steps after which they were compared.
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
    found = {"shares": None, "trials": len(known), "better": 0, "env_steps": env_steps}
    if len(known) < LEAST:
        return found | {"why": f"fewer than {LEAST} trials can be compared"}
    scores = np.sort([results.sign * objective for _, objective in known])[::-1]
    better = min(math.ceil(BETTER * len(known)), int(np.sum(scores > scores[-1])))
    if not better:
        return found | {"why": "all trials are equally good"}
    shares = _shares(known, identity, (better - 0.5) / len(known))  # half a trial less, since it rounds up
    return found | {"shares": shares, "better": int(np.sum(scores >= scores[better - 1]))}


def _at(trial: Trial, env_steps: int) -> float | None:
    """The objective after that many steps, None if there is none."""
    for row in trial.curve:
        if row["env_steps"] == env_steps and row["objective"] is not None and np.isfinite(row["objective"]):
            return row["objective"]
    return None


def _inside(values: dict[str, Any], identity: dict[str, Any]) -> bool:
    floats = all(found["low"] <= values[name] <= found["high"] for name, found in identity["space"].items())
    return floats and all(_label(values[name]) in map(_label, choices) for name, choices in identity["sizes"].items())


def _label(value: Any) -> str:
    return str(list(value)) if isinstance(value, tuple | list) else str(value)


def _shares(known: list[tuple[dict[str, Any], float]], identity: dict[str, Any], quantile: float) -> dict[str, float]:
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
        evaluator = optuna.importance.PedAnovaImportanceEvaluator(target_quantile=quantile)
        return optuna.importance.get_param_importances(study, evaluator=evaluator)
    finally:
        optuna.logging.set_verbosity(before)
