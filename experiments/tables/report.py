"""Our three tables as Markdown, beside the paper's numbers.

A result is what table.py writes, a dict: `table`, `rows` (a scene, method and budget each), `pairs` and provenance.
"""

import dataclasses
import itertools

from jaxnav import SCENES, SUITES
from jaxnav.statistics import REACHED, suite_iqm

TITLES = {"table1": "Methods", "table2": "Two requests against four", "table3": "With and without language, and muted"}
NAMES = {
    "success": "success", "collision": "collision", "human_collision": "human collisions", "timeout": "time-outs",
    "steps": "steps", "min_distance": "minimum distance (m)", "comfort": "comfort", "train_hours": "training (h)",
}  # fmt: skip
RATES = ("success", "collision", "human_collision", "timeout")
# What a method hears and may ask, where its name doesn't tell.
MEANINGS = {
    "HSAC": "HSAC: hybrid soft actor-critic, hearing phrases of the test split, with all that there is to ask.",
    "HSAC, 2 requests": "2 requests: it may ask to stop, or for nothing.",
    "HSAC muted": "Muted: HSAC, whose requests nobody hears when it is played.",
    "HSAC told what is meant": "Told what is meant: HSAC, given the message itself when it is played.",
    "HSAC that only hears": "Only hears: trained with nothing to ask.",
    "HSAC without language": "Without language: trained deaf, with nothing to ask; people behave as elsewhere. In "
    "whose reach it is, and who may speak first, it is told: what it lacks are words.",
    "TD3": "TD3, PPO and A2C are given the message itself, and can't ask.",
    "planner": "The planner knows the map and the message itself, and asks; straight line and ORCA do neither.",
}

# The paper's Tables I to III: {table: {scene: {method: {field: number}}}}.
_PAPER = {
    "table1": (("success", "collision", "steps", "train_hours", "human_collision", "min_distance", "comfort"), {
        "square": {"A2C": (.69, .28, 27.38, .9, .28, .25, .81), "TD3": (.85, .14, 21.21, 2.6, .14, .28, .80),
                   "PPO": (.58, .42, 37.81, 8.0, .39, .23, .82), "HSAC-LLM": (.91, .08, 19.96, 1.6, .07, .31, .85)},
        "hallway": {"A2C": (.28, .59, 58.85, .9, .32, .42, .91), "TD3": (.77, .20, 41.12, 5.0, .21, .30, .89),
                    "PPO": (.63, .37, 30.30, 6.6, .08, .50, .91), "HSAC-LLM": (.93, .07, 27.10, 1.9, .06, .32, .93)},
        "crosswalk": {"A2C": (.14, .77, 43.83, 1.1, .58, 1.28, .99), "TD3": (.85, .14, 41.67, 3.0, .14, .33, .90),
                      "PPO": (.46, .53, 33.33, 10.8, .53, .54, .91), "HSAC-LLM": (.91, .09, 32.80, 2.0, .08, .40, .92)},
    }),
    "table2": (("success", "collision", "steps", "train_hours"), {
        "square": {"2 requests": (.90, .10, 20.84, 1.45), "4 requests": (.91, .08, 19.96, 1.60)},
        "hallway": {"2 requests": (.92, .08, 29.56, 1.67), "4 requests": (.93, .07, 27.10, 1.89)},
        "crosswalk": {"2 requests": (.87, .13, 35.22, 1.78), "4 requests": (.91, .09, 32.80, 2.04)},
    }),
    "table3": (("success", "collision", "steps", "human_collision"), {
        "square": {"without language": (.86, .14, 20.02, .14), "with language": (.91, .08, 19.96, .07)},
        "hallway": {"without language": (.91, .09, 29.00, .09), "with language": (.93, .07, 27.10, .06)},
        "crosswalk": {"without language": (.87, .13, 34.78, .13), "with language": (.91, .09, 32.80, .08)},
    }),
}  # fmt: skip
PAPER = {
    table: {s: {m: dict(zip(fields, row, strict=True)) for m, row in rows.items()} for s, rows in scenes.items()}
    for table, (fields, scenes) in _PAPER.items()
}


@dataclasses.dataclass(frozen=True)
class Grid:
    """The places of a table: all scenes of its suites, with all methods and budgets that its rows name.

    suites: {suite: its scenes}; methods: {budget of training: learnt methods, "none": scripted robots}.
    rows: {(suite, budget, scene, method): row}, of scripted robots for every budget.
    """

    suites: dict
    methods: dict
    rows: dict

    @classmethod
    def of(cls, result):
        """The grid of a result."""
        rows, suites = result["rows"], {}
        learnt, scripted = ([row for row in rows if (row["budget"] == "none") == none] for none in (False, True))
        for row in rows:
            names = {row["scene"], *suites.get(row["suite"], SUITES.get(row["suite"], ()))}
            suites[row["suite"]] = sorted(names, key=lambda name: ([*SCENES, name].index(name), name))
        methods = {row["budget"]: list(dict.fromkeys(row["method"] for row in learnt)) for row in learnt}
        methods["none"] = list(dict.fromkeys(row["method"] for row in scripted))
        places = {(row["suite"], row["budget"], row["scene"], row["method"]): row for row in learnt}
        places |= {(row["suite"], budget, row["scene"], row["method"]): row for row in scripted for budget in methods}
        return cls(suites, methods, places)

    def found(self, suite, budget, methods):
        """The rows of these methods in a suite that are there."""
        keys = itertools.product([suite], [budget], self.suites[suite], methods)
        return [self.rows[key] for key in keys if key in self.rows]

    def title(self, suite, budget):
        """Suite and budget with its steps, and whether it was run at all."""
        rows = self.found(suite, budget, self.methods[budget])
        steps = "" if budget == "none" or not rows else f" of {_span(rows, 'env_steps')} steps"
        text = "scripted robots" if budget == "none" else f"{budget} budget{steps}"
        return f"{suite} suite, {text}{'' if rows else ': not run'}"


def _span(rows, field):
    """The least and the most of a field, as text."""
    values = [row[field] for row in rows]
    return " to ".join(dict.fromkeys(f"{value:,.0f}" for value in (min(values), max(values))))


def _each(rows, field):
    """The different values of a field, as text."""
    return ", ".join(dict.fromkeys(str(row[field]) for row in rows))


def _number(value, digits=3):
    return "-" if value is None else f"{value:.{digits}f}"


def _with_interval(value, interval):
    return _number(value) + ("" if interval is None else f" ({interval[0]:.3f}-{interval[1]:.3f})")


def _table(header, rows):
    return ["", *(f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows))]


def markdown(result):
    """The result as Markdown: facts, a table a suite and budget, the paper's numbers, suites, pairs, seeds left out."""
    grid = Grid.of(result)
    lines = _facts(result)
    for suite in grid.suites:
        for budget, methods in grid.methods.items():
            if methods:
                lines += ["", f"**{grid.title(suite, budget)}**"]
            if grid.found(suite, budget, methods):
                lines += _measures(grid, suite, budget)
        if suite == "parity" and result["table"] in PAPER:
            lines += _paper(result["table"])
    lines += _suites(grid) + _pairs(result["pairs"]) + _left_out(result["rows"])
    return "\n".join(lines) + "\n"


def _facts(result):
    """The facts needed to read the tables: a list of Markdown."""
    rows, facts = result["rows"], []
    learnt = [row for row in rows if row["budget"] != "none"]
    if learnt:
        budgets = dict.fromkeys(row["budget"] for row in learnt)
        steps = {b: _span([row for row in learnt if row["budget"] == b], "env_steps") for b in budgets}
        seeds = [{"seeds": len({*map(str, row["seeds"]), *row["excluded"]})} for row in learnt]
        facts += [
            f"Budgets: {', '.join(f'{budget} ({count} environment steps)' for budget, count in steps.items())}. "
            f"{_span(seeds, 'seeds')} seeds, trained at once: training (s) is of all of them together, from the start, "
            "with compilation in the first scene of those that share a program. All trainings of this table took "
            f"{result['train_seconds'] / 60:,.0f} min; plays are not counted.",
            f"Encoder {_each(learnt, 'encoder')}; sizes of the preset quick; learning rates and the like as tuned "
            "([tuning.md](tuning.md)).",
        ]
    facts += [MEANINGS[method] for method in MEANINGS if method in {row["method"] for row in rows}]
    return [
        f"{TITLES.get(result['table'], result['table'])}. Our scenes are not the paper's.", "",
        *(f"- {fact}" for fact in facts),
        "- All play the same episodes; who plays fewer plays the first of them. Comfort is the share of steps at 0.5 m "
        "or more from everybody; steps, of 0.4 s, and minimum distance are of the episodes that arrived.",
        "- Intervals of 95 %: percentile bootstrap of the mean over seeds (a point where all seeds agree; of five "
        "seeds it covers less than 95 %); of a scripted robot or one seed Wilson's over episodes. Bold: the highest "
        "mean success of a learnt method in a scene, as printed; no test of significance.",
        "- Paths that every method drove, of six episodes a scene: [trajectories](trajectories), a figure for each "
        "method and group of scenes.",
        f"- Device: {_each(rows, 'device')}. Commits of the rows (with +: and changes that were not committed): "
        f"{_each(rows, 'commit')}.",
    ]  # fmt: skip


def _measures(grid, suite, budget):
    fields = {"collision": 3, "human_collision": 3, "timeout": 3, "steps": 2, "min_distance": 2, "comfort": 3}
    header = [
        "scene", "method", "seeds x episodes", "success (95 % interval)", *(NAMES[f] for f in fields), "training (s)",
    ]  # fmt: skip
    lines, learnt = [], budget != "none"
    for scene in grid.suites[suite]:
        rows = {method: grid.rows.get((suite, budget, scene, method)) for method in grid.methods[budget]}
        shown = {method: _number(row["success"]["mean"]) for method, row in rows.items() if row}
        best = max((success for success in shown.values() if learnt and success != "-"), default=None)
        for method, row in rows.items():
            if row is None:
                lines.append([scene, method, "not run", *[""] * (len(header) - 3)])
                continue
            bold = "**" if shown[method] == best else ""
            lines.append([
                scene, f"{bold}{method}{bold}",
                f"{len(row['success']['per_seed'])} x {row['episodes']:,}" if learnt else f"{row['episodes']:,}",
                f"{bold}{_with_interval(row['success']['mean'], row['success']['ci95'])}{bold}",
                *(_number(row[field]["mean"], digits) for field, digits in fields.items()),
                f"{row['train_seconds']:,.0f}" if learnt else "-",
            ])  # fmt: skip
    return _table(header, lines)


def _paper(table):
    rows = [
        [scene, method, *(f"{number:.2f}" for number in numbers.values())]
        for scene, methods in PAPER[table].items()
        for method, numbers in methods.items()
    ]
    silent = " Whether its A2C, TD3 and PPO could hear or ask is not said." if table == "table1" else ""
    return [
        "", f"**The paper's Table {'I' * int(table[-1])}: another simulator's numbers, not comparable with ours** (500 "
        f"tests a scene, 128,000 training steps, RTX 2070).{silent}",
        *_table(["scene", "method", *(NAMES[field] for field in _PAPER[table][0])], rows),
    ]  # fmt: skip


def _suites(grid):
    rows = []
    for suite, scenes in grid.suites.items():
        for budget, method in ((budget, method) for budget, methods in grid.methods.items() for method in methods):
            if found := suite_iqm(grid.found(suite, budget, [method])):
                rows.append([
                    suite, budget, method, _with_interval(found["iqm"], found["ci95"]), _number(found["min"]),
                    f"{100 * found['reached']:.0f} %", f"{found['runs']} in {found['scenes']} of {len(scenes)} scenes",
                ])  # fmt: skip
    header = ["suite", "budget", "method", "interquartile mean (95 % interval)", "minimum", f"reach {REACHED}", "runs"]
    return [
        "", "**Success over suites**: interquartile mean over runs (a seed in a scene each), bootstrap stratified by "
        "scene, and what it hides; seeds left out are not among the runs", *_table(header, rows),
    ]  # fmt: skip


def _pairs(pairs):
    rows = []
    for pair in pairs:
        scale, unit = (100, " points") if pair["field"] in RATES else (1, "")
        seeds = pair["seeds_ci95"]
        rows.append([
            pair["suite"], pair["scene"], pair["budget"], f"{pair['one']} minus {pair['other']}", NAMES[pair["field"]],
            f"{scale * pair['difference']:+.2f} ± {scale * pair['ci95_half']:.2f}{unit}",
            f"{pair['episodes']:,} x {pair['seeds']}",
            "-" if seeds is None else f"{scale * seeds[0]:+.2f} to {scale * seeds[1]:+.2f}",
        ])  # fmt: skip
    header = [
        "suite", "scene", "budget", "compared", "of", "difference (95 % over episodes)", "episodes x seeds",
        "over seeds",
    ]  # fmt: skip
    title = (
        "**Paired differences** over the same episodes, which all seeds play: with the interval of these very robots "
        "over episodes, and that of the mean over training seeds, which with five of them covers less than 95 %"
    )
    return ["", title, *_table(header, rows)] if rows else []


def _left_out(rows):
    left_out = [
        f"- {row['budget']} budget: seed {seed} of {row['method']} in {row['scene']} turned non-finite by step "
        f"{step:,} and is left out"
        for row in rows
        for seed, step in row["excluded"].items()
    ]
    return ["", *(left_out or ["No seed turned non-finite."])]
