"""A made-up result of the three tables, and its parts."""

import functools
import itertools

from jaxnav import statistics
from jaxnav.world import SUITES

LEARNT = ("A2C", "TD3", "PPO", "HSAC-LLM")
SCRIPTED = ("straight line", "planner")


@functools.cache
def measured(values, trials=None):
    """`statistics.measure`, once: most rows have the same numbers."""
    return statistics.measure(values, trials)


def fields(success):
    """Every measure of a row of 200 episodes; half of the failures hit a person."""
    alike = {"timeout": (0.0, 200), "comfort": (0.875, None), "steps": (21.125, None), "min_distance": (0.375, None)}
    return {
        "success": measured(tuple(success), 200), "collision": measured(tuple(1 - s for s in success), 200),
        "human_collision": measured(tuple((1 - s) / 2 for s in success), 200),
        **{field: measured((value,) * len(success), trials) for field, (value, trials) in alike.items()},
    }  # fmt: skip


def success_of(suite, budget, scene, method):
    """Success of seeds 0 to 3, another one everywhere; HSAC-LLM's is the best of those learnt."""
    best = 0.5 + 0.1 * LEARNT.index(method) + 0.05 * (budget == "converged") - 0.3 * (suite == "hard")
    return [best, best + 0.005 * (1 + SUITES[suite].index(scene)), best - 0.05, best + 0.035]


def learnt(suite, budget, scene, method):
    """A row of a learnt method."""
    steps, seconds = {"paper": 128_000, "converged": 1_000_000}[budget], 110 * (1 + LEARNT.index(method))
    return {
        "suite": suite, "scene": scene, "method": method, "budget": budget, "env_steps": steps, "seeds": [0, 1, 2, 3],
        "encoder": "lidar", "excluded": {}, "episodes": 200, **fields(success_of(suite, budget, scene, method)),
        "train_seconds": seconds, "commit": "c0ffee", "device": "Abacus",
    }  # fmt: skip


def scripted(suite, scene, method):
    """A row of a scripted robot; the planner is better than all that is learnt."""
    return {
        "suite": suite, "scene": scene, "method": method, "budget": "none", "env_steps": 0, "seeds": [],
        "excluded": {}, "episodes": 200, **fields([0.995 if method == "planner" else 0.25]), "train_seconds": 0,
        "commit": "decaf", "device": "Abacus",
    }  # fmt: skip


def made_up(suites=("parity", "hard"), budgets=("paper", "converged"), without=(), table="table1"):
    """A result of these suites and budgets, without the rows of some (suite, budget, scene, method)."""
    places = [(suite, scene) for suite in suites for scene in SUITES[suite]]
    rows = [
        learnt(suite, budget, scene, method)
        for budget, (suite, scene), method in itertools.product(budgets, places, LEARNT)
        if (suite, budget, scene, method) not in without
    ]
    rows += [scripted(suite, scene, method) for suite, scene in places for method in SCRIPTED]
    pair = {
        "suite": "hard", "scene": "narrow", "budget": "paper", "one": "HSAC-LLM", "other": "TD3", "field": "success",
        "difference": -0.0525, "ci95_half": 0.0175, "episodes": 600, "seeds": 4, "seeds_ci95": [-0.08, 0.0125],
    }  # fmt: skip
    return {
        "table": table, "rows": rows, "pairs": [pair, pair | {"field": "steps", "difference": 1.5, "ci95_half": 0.25}],
        "config": {}, "commit": "c0ffee", "device": "Abacus", "versions": {}, "train_seconds": 12_345.0,
    }  # fmt: skip


def row_of(result, *place):
    """The row of a (suite, budget, scene, method)."""
    return next(row for row in result["rows"] if tuple(row[n] for n in ("suite", "budget", "scene", "method")) == place)


def scenes(*values):
    """Rows of a scene each with these successes."""
    return [{"scene": f"scene {k}", "success": {"per_seed": list(one)}} for k, one in enumerate(values)]
