"""mink against this project's methods, on the same frames in the same run.

    python -m benchmarks.versus_mink sample --json mink.json
    python -m benchmarks.versus_mink sample --tune

mink gets what inverse kinematics gets here: the trackers with their expected deviations,
anatomical joint limits, eight starts for the first frame, and once more the true first pose
(`mink-truth`). Its posture task, its rounds and its damping were tuned by `--tune` on the
same tuning clips as everything else (`benchmarks.tuning`), for the least joint angle error
with both signals, the mean of a cold and of a true start.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Annotated, Final, cast

import numpy as np
import typer

from benchmarks.mink_estimator import MinkEstimator, MinkSettings
from benchmarks.tuning import tuning_clips
from localreg.commands.console import notes, output, progress_bar
from localreg.commands.evaluation_tables import (
    difference_table,
    mean_table,
    more_table,
    worse_lines,
)
from localreg.commands.grids import Grid
from localreg.commands.reading import OverridesFile, SourceRate, Sources, read
from localreg.compile_cache import keep_compiled_code
from localreg.database import PoseDatabase
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.leave_one_out import Progress, settings_of
from localreg.evaluation.metrics import compare, mean_figures
from localreg.evaluation.playback import play
from localreg.evaluation.protocol import Protocol, Trial, plan_trials
from localreg.evaluation.results import ClipResult, Evaluation, write_json
from localreg.evaluation.summaries import badness, by_kind, to_json
from localreg.evaluation.trackers import simulate_trackers
from localreg.evaluation.worker import Worker
from localreg.motion.motion import Motion
from localreg.synthesis.baselines import InverseKinematics
from localreg.synthesis.methods import build_estimator
from localreg.synthesis.term_prior import FromTerms

TUNED = MinkSettings()
"""What `--tune` found best on the sample set's tuning clips (5.47 degrees over both starts; with
20 rounds the same, drawn to the standing posture 8.4)."""

_MINKS: Final = ("mink", "mink-truth")
_JUDGED: Final = (("joint_angle_error_deg", "deg"), ("mpjpe_cm", "cm"))

_GRID = [
    MinkSettings(float(np.radians(posture)), is_previous, rounds, damping)
    for is_previous, posture, rounds, damping in product(
        (True, False), (3.0, 6.0, 12.0, 25.0, 50.0), (5, 20), (1e-6,)
    )
]


def run_clips(
    motions: Sequence[Motion],
    database: PoseDatabase,
    protocol: Protocol,
    settings: MinkSettings = TUNED,
    progress: Progress | None = None,
) -> Evaluation:
    """Our methods and mink by turns, clip by clip, in this process.

    Args:
        motions: the test clips.
        database: what our methods learn from.
        protocol: of our methods; mink has the same signals, trackers, noise and seed.
        settings: mink's.
        progress: is told after every clip.
    """
    trials, short = plan_trials(motions, database, protocol)
    worker, results = Worker(database), []
    for number, trial in enumerate(trials, start=1):
        results += worker.run(trial, protocol)
        results += mink_results(trial, protocol, settings)
        if progress is not None:
            progress(number, len(trials), trial.motion.provenance.name)
    order = [*protocol.methods, "mink", "mink-truth"]
    results.sort(key=lambda clip: (order.index(clip.method), protocol.signals.index(clip.signals)))
    return Evaluation(
        settings_of(protocol, database),
        tuple(results),
        tuple(short),
        {"mink": settings._asdict(), "trackers": protocol.trackers},
    )


def mink_results(trial: Trial, protocol: Protocol, settings: MinkSettings) -> list[ClipResult]:
    """mink on one clip, from a cold start and from the truth, with every kind of signals."""
    motion = trial.motion
    body = BodyPoints(motion.subject)
    estimator = mink_estimator(motion, settings)
    results = []
    for signals in protocol.signals:
        quality = replace(protocol.quality, signals=signals)
        trackers = simulate_trackers(
            motion, quality, seed=protocol.seed, truth=body.tracker_poses(motion.qpos)
        )
        for name, start in (("mink", None), ("mink-truth", motion.qpos[0])):
            playback = play(estimator, trackers, true_start=start)
            comparison = compare(motion, playback.qpos, body=body)
            made = motion.provenance
            results.append(
                ClipResult(
                    made.name, len(motion), name, signals, comparison, playback.step_ms,
                    made.subject, made.activity,
                )
            )  # fmt: skip
    return results


def mink_estimator(motion: Motion, settings: MinkSettings) -> MinkEstimator:
    """mink with the starts of our own inverse kinematics."""
    prior = cast("FromTerms", build_estimator("ik", motion.subject).prior).prior
    starts = np.asarray(cast("InverseKinematics", prior).starts)
    return MinkEstimator(motion.subject, motion.rate, starts, settings)


def activity_grid(evaluation: Evaluation, signals: str) -> Grid:
    """Our first method beside mink from both starts, by kind of activity."""
    ours = evaluation.methods[0]
    shown = (ours, *_MINKS)
    grid = Grid(
        f"By activity, {signals}",
        ["activity", "clips",
         *(f"{method}\n[{unit}]" for _, unit in _JUDGED for method in shown)],
    )  # fmt: skip
    groups = {method: by_kind(evaluation, method, signals) for method in shown}
    for activity, clips in groups[ours].items():
        means = {method: mean_figures([c.figures for c in groups[method][activity]])
                 for method in shown}  # fmt: skip
        cells = [f"{getattr(means[m], figure):.2f}" for figure, _ in _JUDGED for m in shown]
        grid.add_row(activity, str(len(clips)), *cells)
    return grid


def activity_lines(evaluation: Evaluation, signals: str) -> list[str]:
    """On how many activities and clips our first method has less of both errors than mink."""
    ours, lines = evaluation.methods[0], []
    mine = by_kind(evaluation, ours, signals)
    for rival in _MINKS:
        its = by_kind(evaluation, rival, signals)
        lost = [name for name in mine if not _is_less(mine[name], its[name])]
        pairs = zip(evaluation.of(ours, signals), evaluation.of(rival, signals), strict=True)
        worse = [one.name for one, other in pairs if not _is_less([one], [other])]
        lines.append(
            f"{ours}, {signals}: less of both errors than {rival} on "
            f"{len(mine) - len(lost)} of {len(mine)} activities"
            + (f" (not on {'; '.join(lost)})" if lost else "")
            + f" and {sum(map(len, mine.values())) - len(worse)} of "
            f"{sum(map(len, mine.values()))} clips"
            + (f" (not on {'; '.join(worse)})" if worse else "")
        )
    return lines


def _is_less(ours: Sequence[ClipResult], others: Sequence[ClipResult]) -> bool:
    one, other = (mean_figures([clip.figures for clip in clips]) for clips in (ours, others))
    return all(
        (getattr(one, figure) or 0.0) < (getattr(other, figure) or 0.0) for figure, _ in _JUDGED
    )


def time_lines(evaluation: Evaluation) -> list[str]:
    """How long half of the frames take at most, every method beside mink, on the same frames."""
    medians = {
        method: float(np.median(np.concatenate([clip.step_ms for clip in evaluation.of(method)])))
        for method in dict.fromkeys(clip.method for clip in evaluation.clips)
    }
    mink = medians["mink"]
    return [
        f"{method}: half of the frames within {median:.2f} ms, {median / mink:.2f} of mink's"
        for method, median in medians.items()
    ]


def tune(
    trials: Sequence[Trial], protocol: Protocol, progress: Progress
) -> list[tuple[float, MinkSettings]]:
    """Every setting of the grid with its joint angle error [deg], the best first."""
    found = []
    for number, settings in enumerate(_GRID, start=1):
        clips = [clip for trial in trials for clip in mink_results(trial, protocol, settings)]
        error = float(np.mean([badness(clip.figures) for clip in clips]))
        found.append((error, settings))
        progress(number, len(_GRID), f"{error:.2f} deg")
    return sorted(found, key=lambda entry: entry[0])


def main(
    sources: Sources,
    methods: Annotated[str, typer.Option(help="Ours, with commas.")] = "localreg,ik,ik-truth",
    signals: Annotated[str, typer.Option(help="What trackers measure.")] = "both",
    max_frames: Annotated[int | None, typer.Option(help="Only so many frames a clip.")] = None,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise.")] = 0,
    tuning: Annotated[
        bool, typer.Option("--tune", help="Try mink's settings on the tuning clips instead.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write every figure.")
    ] = None,
) -> None:
    """Compare mink with this project's methods on the same frames."""
    keep_compiled_code()
    motions, _ = read(sources, source_rate, overrides)
    if tuning:
        motions = tuning_clips(motions)
    database = PoseDatabase.build(motions)
    protocol = Protocol(
        methods=tuple(methods.split(",")),
        signals=tuple(signals.split(",")),
        max_frames=max_frames,
        seed=seed,
    )
    console = output()
    if tuning:
        protocol = replace(protocol, methods=("ik",))
        trials, _ = plan_trials(motions, database, protocol)
        with progress_bar("tuning mink") as bar:
            for error, settings in tune(trials, protocol, bar)[:10]:
                console.print(f"{error:.3f} deg  {settings}")
        return
    with progress_bar("mink and ours") as bar:
        evaluation = run_clips(motions, database, protocol, progress=bar)
    if evaluation.too_short:
        notes().print(f"too short to be a test: {', '.join(evaluation.too_short)}")
    for table in (mean_table, difference_table, more_table):
        console.print(table(evaluation).to_rich())
    for kind in protocol.signals:
        console.print(activity_grid(evaluation, kind).to_rich())
        for line in activity_lines(evaluation, kind):
            console.print(line, soft_wrap=True)
    for line in (*worse_lines(evaluation), *time_lines(evaluation)):
        console.print(line, soft_wrap=True)
    if json_file is not None:
        write_json(to_json(evaluation), json_file)


if __name__ == "__main__":
    typer.run(main)
