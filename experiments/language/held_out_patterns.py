"""Understanding of unheard sentences from embeddings: encoders, layers, heads, with and without sides.

python -m experiments.language.held_out_patterns --help
"""

import dataclasses
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import optax

from experiments import study
from jaxnav.language.encoders import MiniLM, WordLlama
from jaxnav.language.phrases import KINDS, hash_of, read_phrases
from jaxnav.language.sides import clean, without_side
from jaxnav.language.table import Projection
from jaxnav.world.types import LEFT, RIGHT

PROGRAM = "language.held_out_patterns"
STEPS, BATCH, NOISE = 3000, 256, 0.6
# Hidden layers of MiniLM (none: wordllama), hidden width of the head (0: linear), whether sides are taken out first.
WAYS = {
    "linear on the sentence embedding": ((6,), 0, False),
    "MLP on the sentence embedding": ((6,), 96, False),
    "the same, sides taken out": ((6,), 96, True),
    "MLP on layers 2-4": ((2, 3, 4), 96, False),
    "linear on layers 2-4, sides taken out": ((2, 3, 4), 0, True),
    "MLP on layers 2-4, sides taken out (ours)": ((2, 3, 4), 96, True),
    "linear on wordllama": ((), 0, False),
    "MLP on wordllama, sides taken out": ((), 96, True),
}


@dataclasses.dataclass(frozen=True)
class Options:
    """Compare ways to read phrases, by accuracy on sentence patterns that were not learnt from.

    Writes held_out_patterns.json and .md. Every way is learnt `folds` times from all patterns but a part, drawn at
    random, and tested on that part. This is harder than the test split: idioms, which no other pattern explains, are
    among them. A way that the file holds already is not learnt again.

    Args:
        folds: parts of the patterns.
        out: folder of the results.
    """

    folds: int = 4
    out: pathlib.Path = study.RESULTS

    def __post_init__(self):
        study.check_numbers(self, ("folds", 2, 20))


def predictions(vectors, sides, meant, fold, folds, width):
    """Message `[N]` predicted for every phrase by a head that did not learn from its fold.

    sides: `[N]`; None where the vectors hold them: then the head decides among the four messages directly.
    """
    relative = (
        meant if sides is None else np.where(meant < RIGHT, meant, np.where((meant == RIGHT) == (sides > 0), 2, 3))
    )
    size = vectors.shape[1]

    def head(params, x):
        if width:
            x = jax.nn.relu(x @ params[0] + params[1])
        return x @ params[-2] + params[-1]

    @jax.jit
    def learn(x, labels, key):
        key_a, key_b, key = jax.random.split(key, 3)
        shapes = [(size, width), (width, 4)] if width else [(size, 4)]
        params = []
        for shape, k in zip(shapes, (key_a, key_b), strict=False):
            params += [jax.random.normal(k, shape) / np.sqrt(shape[0]), jnp.zeros(shape[1])]
        adam = optax.adam(optax.linear_schedule(2e-3, 0.0, STEPS))

        def step(carry, key):
            params, state = carry
            key_pick, key_noise = jax.random.split(key)
            i = jax.random.randint(key_pick, (BATCH,), 0, x.shape[0])
            noisy = x[i] + NOISE * jax.random.normal(key_noise, (BATCH, size))
            targets = optax.smooth_labels(jax.nn.one_hot(labels[i], 4), 0.05)
            gradient = jax.grad(lambda p: optax.softmax_cross_entropy(head(p, noisy), targets).mean())(params)
            change, state = adam.update(gradient, state)
            return (optax.apply_updates(params, change), state), None

        return jax.lax.scan(step, (params, adam.init(params)), jax.random.split(key, STEPS))[0][0]

    found, x = np.zeros(len(meant), int), vectors * np.sqrt(size)
    for k in range(folds):
        logits = np.array(head(learn(x[fold != k], relative[fold != k], jax.random.key(k)), x[fold == k]))
        if sides is not None:
            logits[sides[fold == k] == 0, 2:] = -np.inf
        found[fold == k] = logits.argmax(axis=1)
    if sides is None:
        return found
    return np.where(found < 2, found, np.where((found == 2) == (sides > 0), RIGHT, LEFT))


def run(options: Options) -> dict:
    """Learn and test what is missing, and write both files."""
    phrases = read_phrases()
    meant, kind = np.array([p.message for p in phrases]), np.array([p.kind for p in phrases])
    patterns = sorted({phrase.pattern for phrase in phrases})
    part = dict(zip(patterns, np.random.default_rng(0).permutation(len(patterns)) % options.folds, strict=True))
    fold = np.array([part[phrase.pattern] for phrase in phrases])
    begun = study.Study(PROGRAM, options.out, {"folds": options.folds, "phrases": hash_of(phrases)}, WAYS)
    missing = begun.missing()
    with study.progress(study.console(), max(len(missing), 1), "held-out patterns") as advance:
        for name in missing:
            layers, width, taken_out = WAYS[name]
            split = [without_side(p.text) if taken_out else (clean(p.text).lower(), 0) for p in phrases]
            distinct = list(dict.fromkeys(sentence for sentence, _ in split))
            features = (MiniLM(layers) if layers else WordLlama()).features(distinct)
            number = {sentence: i for i, sentence in enumerate(distinct)}
            rows = [number[sentence] for sentence, _ in split]
            vectors = Projection.fit(features)(features).astype(np.float32)[rows]
            sides = np.array([side for _, side in split]) if taken_out else None
            found = predictions(vectors, sides, meant, fold, options.folds, width)
            sided = np.isin(meant, (RIGHT, LEFT)) & np.isin(found, (RIGHT, LEFT))
            row = {
                "accuracy": float((found == meant).mean()), "sides_confused": float((sided & (found != meant)).mean()),
                "kinds": {k: float((found == meant)[kind == k].mean()) for k in KINDS},
            }  # fmt: skip
            begun.add(name, row)
            advance()
    return begun.finish(table)


def table(result):
    """The result as Markdown."""
    lines = [
        f"Messages understood of sentence patterns not learnt from, {result['folds']} folds over all patterns, seed 0. "
        f"{study.sources(result['rows'].values())}",
        "", f"| way | all | {' | '.join(KINDS)} | sides confused |", f"|{'---|' * (len(KINDS) + 3)}",
    ]  # fmt: skip
    for name, row in result["rows"].items():
        kinds = " | ".join(f"{row['kinds'][kind]:.3f}" for kind in KINDS)
        lines.append(f"| {name} | {row['accuracy']:.3f} | {kinds} | {row['sides_confused']:.3f} |")
    return "\n".join(lines) + "\n"


def main(arguments=None):
    """Entry point."""
    study.main(Options, run, table, PROGRAM, arguments)


if __name__ == "__main__":
    main()
