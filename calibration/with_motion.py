"""A calibration and ordinary motion together: what poses left open, motion may tell.

The fit of the poses hands on all that it knows as one Gaussian of lengths and mounts
(`knowledge`), and the fit of the motion starts from there (`refinement`); so poses and motion
count as if they had been fitted in one problem, linearized at the poses' result.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.anthropometry import length_of
from calibration.eigen_skeleton import lengths_of
from calibration.motion_fit import MotionFit
from calibration.motion_mounts import apart
from calibration.motion_step import Stretches, at_rate
from calibration.refinement import Progress, Stretch, refine
from calibration.result import (
    REPORTED,
    Calibration,
    Length,
    MountEstimate,
    observable_bones,
    relative_deviation,
    three,
)
from localreg.body.subject import Subject
from localreg.database.store import PoseDatabase
from localreg.motion.motion import Motion
from localreg.synthesis.methods import build_estimator

_SLIPPED: Final = 5.0
"""A mount that motion moves by so many of its deviations was not fixed."""


def with_motion(
    result: Calibration,
    motion: Stretches,
    database: PoseDatabase,
    *,
    hidden: Sequence[Motion] = (),
    progress: Progress | None = None,
) -> Calibration:
    """The same person, better known.

    Args:
        result: of the poses.
        motion: what the trackers said while the person moved about.
        database: what poses are like.
        hidden: motions that are not to be found in it, for they are what is seen.
        progress: told how many frames or rounds are done, of how many.

    Raises:
        LocalregError: too little motion.
    """
    allowed = None
    if hidden:
        allowed = np.all([database.exclude_motion(one) for one in hidden], axis=0)
    stretches = [Stretch(at_rate(frames, database.rate), allowed) for frames in motion]
    found = refine(
        result.subject,
        result.knowledge,
        stretches,
        lambda person: build_estimator("localreg", person, database, allowed),
        database,
        progress=progress,
    )
    seconds = sum(frames[-1].time - frames[0].time for frames in motion)
    return _better(result, found, f"{seconds:.0f} s of motion")


def _better(result: Calibration, found: MotionFit, what: str) -> Calibration:
    """A calibration that says of all its numbers what a refinement found."""
    known, subject = found.knowledge, found.subject
    groups = lengths_of(subject)
    lengths = tuple(
        _length(
            length, length_of(parts, groups), relative_deviation(parts, groups, known.log_lengths)
        )
        for length, parts in zip(result.lengths, REPORTED.values(), strict=True)
    )
    mounts = tuple(
        _mount(mount, places, turns)
        for mount, places, turns in zip(
            result.mounts, known.position_sd, known.turn_sd, strict=True
        )
    )
    record = subject.calibration
    assert record is not None and result.subject.calibration is not None  # noqa: S101, PT018  (a refinement records)
    record = replace(
        record,
        method=f"{result.subject.calibration.method} and {what}",
        observable=observable_bones(lengths),
        notes=record.notes + _slips(result, subject),
    )
    return replace(
        result, subject=replace(subject, calibration=record), lengths=lengths, mounts=mounts,
        log_covariance=known.log_lengths, groups=groups, knowledge=known,
    )  # fmt: skip


def _length(before: Length, value: float, relative: float) -> Length:
    told = _told(before.told_by_trackers, value * relative / before.deviation)
    return replace(before, value=value, deviation=value * relative, told_by_trackers=told)


def _mount(
    before: MountEstimate, places: Float[ndarray, "3"], turns: Float[ndarray, "3"]
) -> MountEstimate:
    told = [
        _told(share, sd / old)
        for share, sd, old in zip(
            before.told_by_trackers, places.tolist(), before.position_sd, strict=True
        )
    ]
    return replace(
        before, position_sd=three(places), orientation_sd=three(turns),
        told_by_trackers=three(np.array(told)),
    )  # fmt: skip


def _told(before: float, ratio: float) -> float:
    """The trackers' share of what is known, a deviation having become so much of what it was.

    What beliefs tell (as an inverse variance) stays the same.
    """
    return 1.0 - (1.0 - before) * min(ratio, 1.0) ** 2


def _slips(result: Calibration, subject: Subject) -> tuple[str, ...]:
    """What to tell of mounts that motion does not find where the poses did."""
    told = []
    for estimate, before, after in zip(
        result.mounts, result.subject.mounts, subject.mounts, strict=True
    ):
        away, turn = apart(before, after)
        known = max(estimate.position_sd), max(estimate.orientation_sd)
        if away > _SLIPPED * known[0] or turn > _SLIPPED * known[1]:
            told.append(
                f"tracker {estimate.tracker} sat elsewhere in motion than in the poses, by about "
                f"{1e3 * away:.0f} mm and {np.degrees(turn):.0f} deg: fasten it, calibrate again"
            )
    return tuple(told)
