"""The loop around the training chunk: it logs, evaluates, checkpoints, resumes, and stops on request."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import UserError
from .checkpoint import Checkpoints
from .devices import everybodys, is_first, together
from .evaluation import VALIDATION_SEED
from .run import Best, Progress, Run
from .signals import Interrupted, stop_signals


def train(run: Run, report: Callable[[dict[str, Any]], object], started: float) -> Progress:
    """Train to the end, from the newest checkpoint if the configuration says resume.

    Call `Run.prepare_folder` first. report: called with each line of metrics.jsonl; started: ``time.monotonic()`` from
    which wall_seconds count.

    UserError: numbers turned non-finite, or a file can't be written. Interrupted: a signal came, a checkpoint is saved.
    """
    config, layout, files = run.config, run.layout, run.files
    with together():
        checkpoints = Checkpoints(files.checkpoints_path)
        progress, before, offset = run.start(checkpoints)
        if is_first() and files.metrics_size() < offset:
            raise UserError(f"{files.metrics_path} is shorter than its checkpoint says: train anew with another --out")
        metrics_file = files.open_metrics(writes=is_first())
    chunk = layout.chunk(run.trainer.train_chunk, progress.loop, run.hyper)
    steps, saved = config.train.total_steps, time.monotonic()

    def wall_seconds():
        return before + time.monotonic() - started

    with stop_signals() as stop, metrics_file:
        if is_first():
            metrics_file.truncate(offset)
        while int(progress.loop.counter) < steps:
            began = time.monotonic()
            loop, metrics = chunk(progress.loop, run.hyper)
            metrics, done = jax.device_get((metrics, loop.counter))
            _check_finite(run, metrics, int(done), checkpoints.latest_step())
            progress = progress.replace(loop=loop)
            with together():
                if is_first():
                    line = _line(run, metrics, int(done))
                    progress = _evaluated(run, progress, line, int(done))
                    line["wall_seconds"] = round(wall_seconds(), 3)
                    files.append(metrics_file, line)
                    report(line)
            # Another chunk as long as this one must still fit into what a kill may cost.
            now = time.monotonic()
            due = 2 * now - began - saved >= config.train.checkpoint_seconds
            # Clocks and signals are each process's own: the first one's clock counts, and anybody's signal.
            votes = everybodys([due, stop.number or 0])
            due, number = votes[0, 0], votes[:, 1].max()
            if int(done) == steps or due or number:
                whole = progress.replace(loop=layout.gather(loop))
                with together():
                    if is_first():
                        checkpoints.save(int(done), whole, run.meta(metrics_file.tell(), wall_seconds()))
                saved = time.monotonic()
            if number:
                raise Interrupted(int(number))
        if number := everybodys(stop.number or 0).max():  # while the last checkpoint was saved
            raise Interrupted(int(number))
    return progress


def _evaluated(run: Run, progress: Progress, line: dict[str, Any], counter: int) -> Progress:
    """``progress`` after the evaluation that is due, if one is; its result is added to ``line``."""
    chunks = counter // run.config.train.steps_per_chunk
    if chunks % run.config.train.evaluate_every and counter < run.config.train.total_steps:
        return progress
    policy = run.policy("last", progress)
    line["evaluation"] = run.evaluator.success(policy, VALIDATION_SEED)
    score = np.float32(min(line["evaluation"].values()))
    if score < progress.best.score:
        return progress
    # A copy, since the loop's own arrays are donated to the next chunk.
    actor = jax.tree.map(jnp.copy, policy.parameters)
    return progress.replace(best=Best(actor=actor, score=jnp.float32(score), step=jnp.int32(counter)))


def _line(run: Run, metrics: dict[str, Any], counter: int) -> dict[str, Any]:
    ended, arrived = metrics.pop("episodes_ended"), metrics.pop("episodes_arrived")
    scenes = [scene.name for scene in run.world.scenes]
    return {
        "env_steps": counter * run.config.train.episodes,
        "updates": run.config.agent.updates(counter),
        "success": {name: float(a / n) if n else None for name, a, n in zip(scenes, arrived, ended, strict=True)},
        "episodes": int(ended.sum()),
        **{name: float(value) for name, value in metrics.items()},
    }


def _check_finite(run: Run, metrics: dict[str, Any], counter: int, saved: int | None) -> None:
    broken = [name for name in ("critic_loss", "actor_loss", "q") if not np.isfinite(metrics.get(name, 0.0))]
    if not metrics.pop("finite"):
        broken = broken or ["the learner"]
    if broken:
        kept = "none was saved yet" if saved is None else f"that of step {saved} is kept"
        raise UserError(
            f"{', '.join(broken)} turned non-finite by step {counter} (update "
            f"{run.config.agent.updates(counter)}): train anew with lower hyper.actor_lr and "
            f"hyper.critic_lr and another --out; of the good checkpoints {kept} in {run.folder}"
        )
