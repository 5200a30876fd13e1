"""Choose the settings of every rival by the same search over the same tuning clips.

    python -m benchmarks.tune_baselines sample CMU --overrides configs/cmu-overrides.toml \
        --max-frames 120 --out benchmarks/rivals.toml

Every SOURCE is a set of its own: its clips are tested with what is left of it. For each method
one setting after another is walked along its list of values, in both directions, as long as
errors fall, the others held; round after round until nothing is gained. What is best is the
least joint angle error, averaged over the clips of `benchmarks.tuning`, all kinds of signals,
and, for inverse kinematics, over a cold and a true start (where the cold start goes wrong it
can only be measured how wrong). With several sets the search is done for all of them together
(the mean of the errors' logarithms, so that a percent counts alike in each) and once more for
each alone, from where the common one ended.
"""

import json
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import radians
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer

from benchmarks.tuning import tuning_clips
from localreg.commands.console import output
from localreg.commands.reading import OverridesFile, SourceRate, Sources, read
from localreg.compile_cache import keep_compiled_code
from localreg.database import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.execution import default_jobs
from localreg.evaluation.metrics import compare
from localreg.evaluation.playback import play
from localreg.evaluation.protocol import Protocol, Trial, plan_trials
from localreg.evaluation.summaries import badness
from localreg.evaluation.trackers import simulate_trackers
from localreg.evaluation.variants import find_variant
from localreg.evaluation.worker import is_same
from localreg.synthesis.methods import build_synthesizer
from localreg.synthesis.settings import METHODS, Settings

Axes = Mapping[str, tuple[Any, ...]]
"""Names of settings with the values to try, in order."""

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

_ROUNDS: Final = 3  # at most; mostly the second gains nothing


Evaluate = Callable[[Sequence[tuple[Settings, int]]], list[float]]
"""One error for each pair of settings and number of a set [deg]."""


@dataclass(frozen=True, eq=False)
class TuningSet:
    """Clips that settings may be chosen by, and what they are synthesized from.

    Attributes:
        name: the source's.
        trials: the tuning clips.
        database: the whole source.
    """

    name: str
    trials: Sequence[Trial]
    database: PoseDatabase


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
            trackers = simulate_trackers(
                motion, quality, seed=protocol.seed, truth=body.tracker_poses(motion.qpos)
            )
            for start in (None,) if has_database else (None, motion.qpos[0]):
                qpos = play(estimator, trackers, true_start=start).qpos
                errors.append(badness(compare(motion, qpos, body=body).figures))
    return float(np.mean(errors))


class Search:
    """The search for one method's settings; nothing is evaluated twice.

    Args:
        method: whose settings.
        evaluate: errors [deg] of settings on sets, by number.
        tell: is told what was tried, a line for every walk.
    """

    def __init__(
        self, method: str, evaluate: Evaluate, tell: Callable[[str], None] | None = None
    ) -> None:
        self.method = method
        self._evaluate = evaluate
        self._tell = tell
        self._known: dict[tuple[Settings, int], float] = {}

    def best(self, start: Settings, sets: Sequence[int]) -> Settings:
        """The best settings for some sets together.

        Args:
            start: where to begin.
            sets: numbers of the sets.
        """
        best = start
        for _ in range(_ROUNDS):
            before = best
            for name, values in GRID[self.method].items():
                best = self._walk(best, name, values, sets)
            if best == before:
                break
        return best

    def errors(self, settings: Settings, sets: Sequence[int]) -> list[float]:
        """A setting's error on each set [deg]."""
        self._learn([settings], sets)
        return [self._known[settings, number] for number in sets]

    def _walk(
        self, start: Settings, name: str, values: tuple[Any, ...], sets: Sequence[int]
    ) -> Settings:
        """Along one axis, both ways, as long as it pays."""
        at = min(range(len(values)), key=lambda i: abs(values[i] - getattr(start, name)))
        line = [replace(start, **{name: value}) for value in values]
        line[at] = start
        sides = [line[i] for i in (at - 1, at + 1) if 0 <= i < len(line)]
        self._learn([start, *sides], sets)
        best = at
        for step in (-1, 1):
            place = at + step
            while 0 <= place < len(line) and self._cost(line[place], sets) < self._cost(
                line[best], sets
            ):
                best, place = place, place + step
        tried = [one for one in line if all((one, number) in self._known for number in sets)]
        if self._tell is not None:
            cells = (f"{short(getattr(one, name))} {self._line(one, sets)}" for one in tried)
            self._tell(f"{self.method} {name}: {', '.join(cells)}")
        return line[best]

    def _line(self, settings: Settings, sets: Sequence[int]) -> str:
        return "/".join(f"{error:.3f}" for error in self.errors(settings, sets))

    def _cost(self, settings: Settings, sets: Sequence[int]) -> float:
        return float(np.mean(np.log(self.errors(settings, sets))))

    def _learn(self, settings: Sequence[Settings], sets: Sequence[int]) -> None:
        fresh = [
            (one, number)
            for one in dict.fromkeys(settings)
            for number in sets
            if (one, number) not in self._known
        ]
        self._known.update(zip(fresh, self._evaluate(fresh), strict=True))


@contextmanager
def _evaluator(jobs: int, sets: Sequence[TuningSet], protocol: Protocol) -> Iterator[Evaluate]:
    """Evaluates several settings at once, in the processes of a pool."""
    with ProcessPoolExecutor(jobs, get_context("spawn"), _begin_process, (sets, protocol)) as pool:
        yield lambda problems: list(pool.map(_error_in_process, problems))


_PROBLEM: Final[list[Any]] = []


def _begin_process(*problem: Any) -> None:
    _PROBLEM[:] = problem


def _error_in_process(problem: tuple[Settings, int]) -> float:
    settings, number = problem
    sets, protocol = _PROBLEM
    return mean_error(settings, sets[number].trials, sets[number].database, protocol)


def write_settings(path: Path, found: Mapping[str, Mapping[str, Settings]]) -> None:
    """Write what was found as names of variants, a table for each set.

    Args:
        path: a TOML file.
        found: settings by set and method.

    Raises:
        LocalregError: it cannot be written.
    """
    lines = ["# What benchmarks/tune_baselines.py found: for all sets together, and for each.", ""]
    for name, methods in found.items():
        lines.append(f"[{json.dumps(name)}]")
        for method, settings in methods.items():
            changes = "".join(f":{axis}={getattr(settings, axis)}" for axis in GRID[method])
            lines.append(f"{method} = {json.dumps(method + changes)}")
        lines.append("")
    try:
        path.write_text("\n".join(lines), encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write {path}: {reason}; choose another place") from error


def read_settings(path: Path) -> dict[str, dict[str, str]]:
    """Names of variants by set and method, as `write_settings` writes them.

    Raises:
        LocalregError: it is no such file.
    """
    try:
        with path.open("rb") as file:
            found = tomllib.load(file)
        for methods in found.values():
            for name in methods.values():
                find_variant(name)
    except (OSError, tomllib.TOMLDecodeError, AttributeError, TypeError) as error:
        raise LocalregError(
            f"cannot read settings from {path}: {error}; make it with "
            "python -m benchmarks.tune_baselines --out FILE"
        ) from error
    return found


def short(value: Any) -> str:
    """A setting's value in a few characters."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main(
    sources: Sources,
    methods: Annotated[str, typer.Option(help="Methods, with commas.")] = ",".join(GRID),
    signals: Annotated[str, typer.Option(help="Kinds of signals.")] = "both,position,orientation",
    max_frames: Annotated[int | None, typer.Option(help="Only so many frames a clip.")] = None,
    every: Annotated[int, typer.Option(min=1, help="Of the tuning clips every so many.")] = 1,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one a core.")] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Also write what was found, as TOML.")
    ] = None,
) -> None:
    """Print what was tried and what was found, per method."""
    keep_compiled_code()
    names = methods.split(",")
    if unknown := sorted(set(names) - set(GRID)):
        raise typer.BadParameter(f"{unknown[0]} is none of {', '.join(GRID)}")
    protocol = Protocol(("localreg",), tuple(signals.split(",")), max_frames=max_frames)
    sets = []
    for source in sources:
        motions, _ = read([source], source_rate, overrides)
        database = PoseDatabase.build(motions)
        trials, _ = plan_trials(tuning_clips(motions)[::every], database, protocol)
        sets.append(TuningSet(Path(source).name, trials, database))
    console = output()
    together = tuple(range(len(sets)))
    everything: dict[str, dict[str, Settings]] = {}
    with _evaluator(jobs or default_jobs(), sets, protocol) as evaluate:
        for method in names:
            search = Search(method, evaluate, lambda line: console.print(line, soft_wrap=True))
            common = search.best(METHODS[method], together)
            found = {"all": common}
            if len(sets) > 1:
                found |= {sets[n].name: search.best(common, (n,)) for n in together}
            for what, best in found.items():
                chosen = ", ".join(f"{name} {short(getattr(best, name))}" for name in GRID[method])
                errors = "/".join(f"{error:.3f}" for error in search.errors(best, together))
                everything.setdefault(what, {})[method] = best
                console.print(f"best for {what}: {method}: {chosen}: {errors} deg", soft_wrap=True)
    if out is not None:
        write_settings(out, everything)


if __name__ == "__main__":
    typer.run(main)
