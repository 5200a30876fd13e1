"""How long a frame takes, and where the time goes: every part of it timed in the same run.

    python -m benchmarks.latency DATABASE PLAYED [--frames 2000] [--json FILE]

PLAYED is a database of clips that are played to the estimator, not learned from (see
`benchmarks.scaling`, which makes both). Frames follow one another without a pause in one
thread, garbage collection as in the live loop (`localreg.live.quiet`); a time is that of one
`step`. First, with the index as it is, so that what a second start takes is known; then, if
wanted, mink on the same frames, and neighbours and accuracy against exact search.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np
import typer
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks.measures import STAGES
from localreg.body.subject import canonical_subject
from localreg.commands.console import output
from localreg.compile_cache import keep_compiled_code
from localreg.database import PoseDatabase
from localreg.evaluation.metrics import compare
from localreg.evaluation.playback import play
from localreg.evaluation.results import write_json
from localreg.evaluation.trackers import SimulatedTrackers, simulate_trackers
from localreg.live.quiet import undisturbed
from localreg.motion.motion import Motion, Provenance
from localreg.synthesis.methods import build_estimator
from localreg.synthesis.synthesizer import Synthesizer

_LONGEST = 400  # frames of a clip that are played


class Stopwatch:
    """Adds up what some functions take, until it is read."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    @contextmanager
    def on(self, stage: str, owner: Any, name: str) -> Iterator[None]:
        """Time a method of a class, or of one object, while inside."""
        original: Callable[..., Any] = getattr(owner, name)

        def timed(*args: Any, **kwargs: Any) -> Any:
            begin = time.perf_counter()
            try:
                return original(*args, **kwargs)
            finally:
                taken = time.perf_counter() - begin
                self.spent[stage] = self.spent.get(stage, 0.0) + taken

        own = name in vars(owner)
        setattr(owner, name, timed)
        try:
            yield
        finally:
            if own:
                setattr(owner, name, original)
            else:
                delattr(owner, name)

    def read(self) -> dict[str, float]:
        """What was spent since the last reading [s]."""
        spent, self.spent = self.spent, {}
        return spent


def played_clips(folder: Path) -> list[Motion]:
    """The clips of a database as motions of the canonical subject."""
    database = PoseDatabase.load(folder)
    motions = []
    for clip in database.clips:
        rows = slice(clip.start, min(clip.stop, clip.start + _LONGEST))
        qpos = np.hstack([database.roots[rows], database.angles[rows]]).astype(float)
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        motions.append(Motion(qpos, database.rate, canonical_subject(), Provenance(clip.name)))
    return motions


def frame_times(
    estimator: Synthesizer, clips: list[Motion], frames: int
) -> tuple[
    Float[ndarray, " steps"], Bool[ndarray, " steps"], dict[str, Float[ndarray, " steps"]],
    list[float],
]:  # fmt: skip
    """Steps and how they went.

    Returns:
        Times of steps [ms], whether they come more than a second after a start, times of their
        stages [ms], and joint angle errors of the clips [deg].
    """
    watch, whole, late, errors = Stopwatch(), [], [], []
    stages: dict[str, list[float]] = {stage: [] for stage in STAGES}
    source = cast("Any", estimator.prior).source
    with (
        watch.on("query", Synthesizer, "_query"),
        watch.on("search", source.search, "search"),
        watch.on("expect", type(estimator.prior), "expect"),
        watch.on("solver", Synthesizer, "_solve"),
        undisturbed(),
    ):
        for seed in range(1 + frames):
            for motion in clips:
                trackers = simulate_trackers(motion, seed=seed)
                state = estimator.init(trackers.frame(0))
                made = [state.qpos]
                watch.read()
                for index in range(1, len(trackers)):
                    frame = trackers.frame(index)
                    begin = time.perf_counter()
                    state, pose = estimator.step(state, frame)
                    taken = 1e3 * (time.perf_counter() - begin)
                    spent = {name: 1e3 * value for name, value in watch.read().items()}
                    expect, search = spent.get("expect", 0.0), spent.get("search", 0.0)
                    parts = {
                        "query": spent.get("query", 0.0),
                        "search": search,
                        "regression": max(expect - search, 0.0),
                        "solver": spent.get("solver", 0.0),
                    }
                    parts["rest"] = max(taken - sum(parts.values()), 0.0)
                    for stage, value in parts.items():
                        stages[stage].append(value)
                    whole.append(taken)
                    late.append(index > estimator.rate)
                    made.append(pose.qpos)
                if seed == 0:
                    errors.append(_error(motion, np.array(made, dtype=float)))
                if len(whole) >= frames:
                    parts = {stage: np.array(times) for stage, times in stages.items()}
                    return np.array(whole), np.array(late), parts, errors
    raise AssertionError("no clip has a second frame")


def mink_ratio(estimator: Synthesizer, clips: list[Motion], frames: int) -> dict[str, float]:
    """Half of our frames take at most so long, and mink's, clip by clip in turns [ms]."""
    from benchmarks.versus_mink import TUNED, mink_estimator

    ours, theirs = [], []
    for motion in clips:
        trackers = simulate_trackers(motion)
        mink = mink_estimator(motion, TUNED)
        start = motion.qpos[0]
        ours.append(play(estimator, trackers, true_start=start).step_ms)
        theirs.append(play(mink, trackers, true_start=start).step_ms)
        if sum(map(len, ours)) >= frames:
            break
    mine, other = (float(np.median(np.concatenate(times))) for times in (ours, theirs))
    return {"ours_p50_ms": mine, "mink_p50_ms": other}


def against_exact(estimator: Synthesizer, clips: list[Motion], count: int) -> dict[str, float]:
    """Recall of neighbours, and errors by those of exact search, on the same clips."""
    source = cast("Any", estimator.prior).source
    exact = type(source.search).search
    search, precise = source.search, source.search.made_exact()
    asked: list[Any] = []

    def remember(query: Any, wanted: int, *rest: Any) -> Any:
        asked.append(query)
        return exact(search, query, wanted, *rest)

    errors: dict[str, list[float]] = {"index": [], "exact": []}
    few = [motion.first(150) for motion in clips]
    for name, function in (
        ("index", remember),
        ("exact", precise.search),
    ):
        vars(search)["search"] = function
        for motion in few:
            made = play(estimator, simulate_trackers(motion), true_start=motion.qpos[0]).qpos
            errors[name].append(_error(motion, made))
    vars(search)["search"] = remember
    for trackers in _trackers_lost(few):
        play(estimator, trackers)
    del vars(search)["search"]
    recalls: dict[bool, list[float]] = {True: [], False: []}
    partial = [query for query in asked if np.any(query.feature_trust != 1.0)]
    whole = [query for query in asked if np.all(query.feature_trust == 1.0)]
    for query in (
        *whole[:: max(1, len(whole) // count)],
        *partial[:: max(1, len(partial) // count)],
    ):
        found = search.search(query, estimator.settings.neighbours)
        true = precise.search(query, estimator.settings.neighbours)
        limit = true.squared_distances[-1] * (1.0 + 1e-6) + 1e-9
        recalls[bool(np.all(query.feature_trust == 1.0))].append(
            float(np.mean(found.squared_distances <= limit))
        )
    found = {
        "recall": float(np.mean(recalls[True])),
        "error_ratio": float(np.mean(errors["index"]) / np.mean(errors["exact"])),
    }
    if recalls[False]:
        found["recall_partial"] = float(np.mean(recalls[False]))
    return found


def _error(motion: Motion, qpos: Float[ndarray, "frames 63"]) -> float:
    """Mean joint angle error [deg]."""
    return float(np.mean(compare(motion, qpos).joint_angle_error_deg))


def _some(queries: list[Any], count: int) -> list[Any]:
    return queries[:: max(1, len(queries) // count)]


def _trackers_lost(clips: list[Motion]) -> list[SimulatedTrackers]:
    """Clips with each tracker away for a while, so that some queries know less."""
    from localreg.evaluation.trackers import TrackerQuality

    return [simulate_trackers(clip, replace(TrackerQuality(), dropout=0.1)) for clip in clips]


def main(
    database: Annotated[Path, typer.Argument(metavar="DATABASE", help="What is learned from.")],
    played: Annotated[Path, typer.Argument(metavar="PLAYED", help="What is played.")],
    frames: Annotated[int, typer.Option(min=1, help="Frames to time.")] = 2000,
    mink: Annotated[bool, typer.Option("--mink", help="Time mink as well.")] = False,
    exact: Annotated[bool, typer.Option("--exact", help="Compare with exact search.")] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write the figures here.")
    ] = None,
) -> None:
    """Time frames and their parts."""
    # From the start of the process, imports included.
    begun = time.clock_gettime(time.CLOCK_BOOTTIME) - _age()
    keep_compiled_code()
    poses = PoseDatabase.load(database)
    estimator = build_estimator("localreg", canonical_subject(), poses)
    clips = played_clips(played)
    first = simulate_trackers(clips[0].first(2))
    state = estimator.init(first.frame(0))
    estimator.step(state, first.frame(1))
    figures: dict[str, Any] = {
        "poses": len(poses),
        "first_pose_s": time.clock_gettime(time.CLOCK_BOOTTIME) - begun,
    }
    play(estimator, simulate_trackers(clips[0].first(30)))
    whole, late, stages, errors = frame_times(estimator, clips, frames)
    figures |= {
        "frames": len(whole),
        "frame_p50_ms": float(np.percentile(whole, 50)),
        "frame_p90_ms": float(np.percentile(whole, 90)),
        "frame_p99_ms": float(np.percentile(whole, 99)),
        "late_frame_p99_ms": float(np.percentile(whole[late], 99)),
        "frame_p999_ms": float(np.percentile(whole, 99.9)),
        "frame_max_ms": float(whole.max()),
        "memory_mb": _peak_memory_mb(),
        "joint_angle_error_deg": float(np.mean(errors)),
    }
    for stage, taken in stages.items():
        figures[f"{stage}_p50_ms"] = float(np.percentile(taken, 50))
        figures[f"{stage}_p99_ms"] = float(np.percentile(taken, 99))
    if mink:
        figures |= mink_ratio(estimator, clips, frames)
    if exact:
        figures |= against_exact(estimator, clips, 300)
    if json_file is not None:
        write_json(figures, json_file)
    output().print_json(data=figures)


def _peak_memory_mb() -> float:
    """The most that this process has had; `getrusage` counts its parent's, too, from before it."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def _age() -> float:
    """How long this process has run [s]."""
    ticks = int(Path("/proc/self/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()[19])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / 100.0


if __name__ == "__main__":
    typer.run(main)
