"""Choose the settings of every method by the same search over the same tuning clips.

    python -m benchmarks.tune_baselines sample
    python -m benchmarks.tune_baselines cmu/ --overrides configs/cmu-overrides.toml --max-frames 120

For each method one setting after another is tried over a list of values, the others held, and
the best is kept; twice round. What is best is the least joint angle error, averaged over the
clips of `benchmarks.tuning`, all kinds of signals, and, for inverse kinematics, over a cold
and a true start (where the cold start goes wrong it can only be measured how wrong). Every
clip is left out of the database while it is the test; the database holds the whole source.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from math import radians
from multiprocessing import get_context
from typing import Annotated, Any, Final

import numpy as np
import typer

from benchmarks.tuning import tuning_clips
from localreg.commands.console import output, progress_bar
from localreg.commands.reading import OverridesFile, SourceRate, Sources, read
from localreg.compile_cache import keep_compiled_code
from localreg.database import PoseDatabase
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.execution import default_jobs
from localreg.evaluation.leave_one_out import Progress
from localreg.evaluation.metrics import compare
from localreg.evaluation.playback import play
from localreg.evaluation.protocol import Protocol, Trial, plan_trials
from localreg.evaluation.summaries import badness
from localreg.evaluation.trackers import simulate_trackers
from localreg.evaluation.worker import is_same
from localreg.synthesis.methods import build_synthesizer
from localreg.synthesis.settings import METHODS, Settings

Axes = Mapping[str, tuple[Any, ...]]
"""Names of settings with the values to try."""

_DEGREES: Final = tuple(radians(value) for value in (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.0, 25.0))
_PROJECTION: Final[Axes] = {
    "floor": _DEGREES,
    "neighbours": (20, 40, 60, 100, 200, 400),
    "rank": (3, 6, 10, 20),
    "search_by_trackers": (False, True),
}

GRID: Final[Mapping[str, Axes]] = {
    # The published search knows the past alone; the trackers would be another method.
    "paper": {name: _PROJECTION[name] for name in ("floor", "neighbours", "rank")},
    "joint": {name: _PROJECTION[name] for name in ("floor", "neighbours", "rank")},
    "lpcr": _PROJECTION,
    "lpca": {**_PROJECTION, "rank": (6, 10, 20, 40), "smoothness": _DEGREES},
    "ik": {
        "previous_pose": tuple(radians(value) for value in (1.0, 2.0, 3.0, 6.0, 12.0, 25.0)),
        "limit_softness": tuple(radians(value) for value in (0.5, 1.0, 3.0, 10.0)),
        "root_position": (0.02, 0.1, 0.5),
    },
}
"""What is searched for each method."""

_ROUNDS: Final = 2


def mean_error(settings: Settings, trials: Sequence[Trial], database: PoseDatabase,
               protocol: Protocol) -> float:  # fmt: skip
    """Joint angle error with some settings, mean over clips, signals and starts [deg]."""
    errors, person = [], None
    has_database = settings.prior != "ik"
    for trial in trials:
        motion = trial.motion
        allowed = trial.allowed(database) if has_database else None
        if person is None or not is_same(person[0], motion.subject):
            built = build_synthesizer(settings, motion.subject, database, allowed)
            person = motion.subject, BodyPoints(motion.subject), built
        _, body, estimator = person
        if allowed is not None:
            estimator = estimator.leave_out(allowed)
        for signals in protocol.signals:
            quality = replace(protocol.quality, signals=signals)
            trackers = simulate_trackers(motion, quality, seed=protocol.seed, body=body)
            for start in (None,) if has_database else (None, motion.qpos[0]):
                qpos = play(estimator, trackers, true_start=start).qpos
                errors.append(badness(compare(motion, qpos, body=body).figures))
    return float(np.mean(errors))


def search(
    method: str, evaluate: "Evaluator", progress: Progress | None = None
) -> tuple[Settings, float, list[str]]:
    """Coordinate search from a method's present settings.

    Returns:
        The best settings, their error [deg], and what was tried, a line each.
    """
    axes, best = GRID[method], METHODS[method]
    lines, least = [], evaluate([best])[0]
    known = {best: least}
    for number in range(_ROUNDS * len(axes)):
        name = list(axes)[number % len(axes)]
        candidates = [replace(best, **{name: value}) for value in axes[name]]
        fresh = [one for one in candidates if one not in known]
        known.update(zip(fresh, evaluate(fresh), strict=True))
        lines.append(
            f"{method} {name}: "
            + ", ".join(f"{_short(getattr(c, name))} {known[c]:.3f}" for c in candidates)
        )
        best = min(known, key=lambda one: known[one])
        least = known[best]
        if progress is not None:
            progress(number + 1, _ROUNDS * len(axes), f"{method} {least:.3f} deg")
    return best, least, lines


class Evaluator:
    """Errors of several settings at once, in the processes of a pool."""

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool

    def __call__(self, settings: Sequence[Settings]) -> list[float]:
        """One error for each [deg]."""
        return list(self._pool.map(_error_in_process, settings))


@contextmanager
def _evaluator(jobs: int, *problem: Any) -> Iterator[Evaluator]:
    with ProcessPoolExecutor(jobs, get_context("spawn"), _begin_process, problem) as pool:
        yield Evaluator(pool)


_PROBLEM: Final[list[Any]] = []


def _begin_process(*problem: Any) -> None:
    _PROBLEM[:] = problem


def _error_in_process(settings: Settings) -> float:
    return mean_error(settings, *_PROBLEM)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main(
    sources: Sources,
    methods: Annotated[str, typer.Option(help="Methods, with commas.")] = ",".join(GRID),
    signals: Annotated[str, typer.Option(help="Kinds of signals.")] = "both,position,orientation",
    max_frames: Annotated[int | None, typer.Option(help="Only so many frames a clip.")] = None,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one a core.")] = None,
) -> None:
    """Search every method's settings on the tuning clips of a source."""
    keep_compiled_code()
    motions, _ = read(sources, source_rate, overrides)
    database = PoseDatabase.build(motions)
    protocol = Protocol(("localreg",), tuple(signals.split(",")), max_frames=max_frames)
    trials, _ = plan_trials(tuning_clips(motions), database, protocol)
    console = output()
    console.print(f"tuning clips: {', '.join(t.motion.provenance.name for t in trials)}")
    with _evaluator(jobs or default_jobs(), trials, database, protocol) as evaluate:
        for method in methods.split(","):
            with progress_bar(f"tuning {method}") as bar:
                best, least, lines = search(method, evaluate, bar)
            for line in lines:
                console.print(line, soft_wrap=True)
            changed = {
                name: _short(getattr(best, name))
                for name in GRID[method]
                if getattr(best, name) != getattr(METHODS[method], name)
            }
            console.print(f"{method}: {least:.3f} deg with {changed or 'what it has'}")


if __name__ == "__main__":
    typer.run(main)
