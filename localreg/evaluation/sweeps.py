"""Series of evaluations in which one thing changes: the curves of a report.

They run over a few clips and the first seconds of each, so that all of them take minutes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.database import PoseDatabase
from localreg.evaluation.execution import Run
from localreg.evaluation.leave_one_out import Progress, evaluate
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.robustness import part_of
from localreg.evaluation.variants import SQUARES, TRUTH, find_variant
from localreg.motion.motion import Motion

CLIPS: Final = 6
"""Clips of a series, evenly spread over the source."""

SECONDS: Final = 3.0
"""How much of each is played [s]."""

_METHODS: Final = 3  # of those evaluated, how many a series compares
_NOISES_MM: Final = (0.0, 3.0, 10.0, 20.0, 40.0)
_OUTLIERS: Final = (0.0, 0.02, 0.05, 0.1, 0.2)
_DROPOUTS: Final = (0.0, 0.1, 0.25, 0.5)
_SHARES: Final = (0.05, 0.1, 0.25, 0.5, 1.0)


@dataclass(frozen=True)
class Point:
    """One evaluation of a series.

    Attributes:
        label: of the place on the axis.
        value: where on the axis it is; the index where places have no measure.
        protocol: what is evaluated there.
    """

    label: str
    value: float
    protocol: Protocol


@dataclass(frozen=True)
class Series:
    """What changes, and how.

    Attributes:
        name: for the heading.
        axis: what is on the axis, with its unit.
        points: the evaluations.
        is_measure: whether the axis is one of numbers.
        is_logarithmic: whether its numbers are best seen as ratios.
    """

    name: str
    axis: str
    points: tuple[Point, ...]
    is_measure: bool = True
    is_logarithmic: bool = False


@dataclass(frozen=True, eq=False)
class Curve:
    """One method's errors along a series.

    Attributes:
        method: its name.
        angle_deg: joint angle error at each point, mean over clips [deg].
        mpjpe_cm: MPJPE at each point, mean over clips [cm].
    """

    method: str
    angle_deg: Float[ndarray, " points"]
    mpjpe_cm: Float[ndarray, " points"]


def plan_series(
    protocol: Protocol, trackers: Sequence[str], database: PoseDatabase
) -> list[Series]:
    """The series for the methods of an evaluation, with its first kind of signals.

    Args:
        protocol: of the evaluation; its first method stands in the middle.
        trackers: names of all trackers worn.
        database: what is learned from.
    """
    methods = _compared(protocol.methods)
    first = methods[0]
    squares = () if find_variant(first).has_squares else (first + SQUARES,)
    frames = round(SECONDS * database.rate)
    base = replace(
        protocol,
        methods=methods,
        signals=protocol.signals[:1],
        max_frames=min(frames, protocol.max_frames or frames),
        keep_poses=False,
    )
    quality = base.quality
    noises = [
        Point(f"{mm:g}", mm, replace(base, quality=replace(
            quality, noise_position=1e-3 * mm, noise_orientation=radians(mm / 6.0))))
        for mm in _NOISES_MM
    ]  # fmt: skip
    outliers = [
        Point(f"{share:.0%}", 100 * share, replace(
            base, methods=(first, *squares, *methods[1:]),
            quality=replace(quality, outliers=share)))
        for share in _OUTLIERS
    ]  # fmt: skip
    dropouts = [
        Point(f"{share:.0%}", 100 * share, replace(
            base, quality=replace(quality, dropout=share, dropout_seconds=0.5)))
        for share in _DROPOUTS
    ]  # fmt: skip
    fewer = [
        Point(label, index, replace(base, trackers=names))
        for index, (label, names) in enumerate(_subsets(trackers))
    ]
    learned = tuple(m for m in methods if find_variant(m).needs_database)
    series = [
        Series("Noise", "position noise [mm]; orientation noise is a sixth as many degrees",
               tuple(noises)),
        Series("Outliers", f"outliers of {100 * quality.outlier_position:.0f} cm [%]",
               tuple(outliers)),
        Series("Dropouts", "time that each tracker is away, half a second at once [%]",
               tuple(dropouts)),
        Series("Trackers removed", "trackers worn", tuple(fewer), is_measure=False),
    ]  # fmt: skip
    if learned:
        sizes = [
            Point(
                f"{round(share * len(database)):,}",
                share * len(database),
                replace(base, methods=learned, database_share=share),
            )
            for share in _SHARES
        ]
        series.append(
            Series("Database size", "poses, their mirror images among them", tuple(sizes),
                   is_logarithmic=True)
        )  # fmt: skip
    return series


def run_series(
    series: Sequence[Series],
    motions: Sequence[Motion],
    database: PoseDatabase,
    run: Run,
    *,
    progress: Progress | None = None,
) -> list[list[Curve]]:
    """The curves of every series.

    Args:
        series: as planned.
        motions: the clips; see `some_clips`.
        database: as for `evaluate`.
        run: where to run trials.
        progress: is told after every clip.
    """
    total = sum(len(one.points) for one in series)
    done, found = 0, []
    for one in series:
        rows = []
        for point in one.points:
            means = evaluate(
                motions, database, point.protocol, run=run,
                progress=part_of(progress, done, total),
            ).means()  # fmt: skip
            done += 1
            signals = point.protocol.signals[0]
            rows.append({method: kinds[signals] for method, kinds in means.items()})
        found.append(
            [
                Curve(
                    method,
                    np.array([row[method].joint_angle_error_deg for row in rows], dtype=float),
                    np.array([row[method].mpjpe_cm for row in rows], dtype=float),
                )
                for method in one.points[0].protocol.methods
            ]
        )
    return found


def some_clips(motions: Sequence[Motion], count: int = CLIPS) -> list[Motion]:
    """A few clips, evenly spread."""
    places = (np.arange(count) + 0.5) * len(motions) / count
    return [motions[i] for i in np.unique(np.minimum(places.astype(int), len(motions) - 1))]


def _compared(methods: Sequence[str]) -> tuple[str, ...]:
    """The first methods, none twice for its start."""
    plain = dict.fromkeys(method.removesuffix(TRUTH) for method in methods)
    ordered = list(plain)
    # The last of many is normally the one without a database: the line to stay under.
    return tuple(ordered[: _METHODS - 1] + ordered[_METHODS - 1 :][-1:])


def _subsets(trackers: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """All, each one missing, and from the first on fewer and fewer."""
    everything = tuple(trackers)
    subsets = [("all", everything)]
    if len(everything) > 1:
        for missing in everything:
            kept = tuple(name for name in everything if name != missing)
            subsets.append((f"no {missing}", kept))
    for count in range(len(everything) - 2, 0, -1):
        subsets.append((f"first {count}", everything[:count]))
    return subsets
