"""A better subject from ordinary motion: synthesize, choose frames, fit all of them at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from calibration.anthropometry import group_of_bone
from calibration.knowledge import Knowledge
from calibration.motion_fit import MotionFit, MotionSettings, SeenFrames, fit_motion
from calibration.pose_prior import PosePriors
from localreg.body.skeleton import BONE_NAMES
from localreg.body.subject import CalibrationRecord, Subject
from localreg.database.store import PoseDatabase
from localreg.errors import LocalregError
from localreg.synthesis.estimator import AnyEstimator
from sensors.pose import TrackerFrame

_SETTLING = 10
_LEAST_FRAMES = 16

BuildEstimator = Callable[[Subject], AnyEstimator]
Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Stretch:
    """Motion without a gap.

    Attributes:
        frames: at the estimator's rate, of the subject's trackers.
        allowed: which poses of the database may be used for it; all if None.
    """

    frames: Sequence[TrackerFrame]
    allowed: Bool[ndarray, " poses"] | None = None


def refine(
    subject: Subject,
    known: Knowledge,
    stretches: Sequence[Stretch],
    build: BuildEstimator,
    database: PoseDatabase,
    *,
    ignored: Sequence[str] = (),
    settings: MotionSettings | None = None,
    progress: Progress | None = None,
) -> MotionFit:
    """Lengths and mounts that a minute of ordinary motion agrees with.

    Args:
        subject: as calibrated.
        known: how well.
        stretches: motion of the person.
        build: makes an estimator for a subject.
        database: what poses are like.
        ignored: trackers that the first poses are synthesized without.
        settings: beliefs.
        progress: told how many frames or rounds are done, of how many.

    Raises:
        LocalregError: too little motion.
    """
    settings = settings or MotionSettings()
    told = progress or (lambda *_: None)
    seen, sizes = _chosen(build(subject), stretches, ignored, settings, told)
    if len(seen.qpos) < _LEAST_FRAMES:
        raise LocalregError(
            f"{len(seen.qpos) * settings.spacing:.0f} s of motion are too little; move about for "
            "half a minute or more"
        )
    told(0, settings.rounds, "fitting")
    result = _fitted(subject, known, seen, sizes, stretches, database, settings)
    for number in range(1, settings.rounds):
        told(number, settings.rounds, "fitting")
        seen = replace(seen, qpos=np.hstack([seen.qpos[:, :7], result.angles]))
        result = _fitted(subject, known, seen, sizes, stretches, database, settings)
    told(settings.rounds, settings.rounds, "fitting")
    return replace(result, subject=_recorded(result))


def _fitted(
    subject: Subject,
    known: Knowledge,
    seen: SeenFrames,
    sizes: Sequence[int],
    stretches: Sequence[Stretch],
    database: PoseDatabase,
    settings: MotionSettings,
) -> MotionFit:
    """One fit, with the neighbors of the poses as they seem to be."""
    angles = np.split(seen.qpos[:, 7:], np.cumsum(sizes)[:-1])
    found = [
        PosePriors.near(
            own, database, stretch.allowed, neighbors=settings.neighbors, floor=settings.floor
        )
        for own, stretch in zip(angles, stretches, strict=True)
    ]
    priors = PosePriors(
        np.concatenate([p.means for p in found]), np.concatenate([p.covariances for p in found])
    )
    return fit_motion(subject, known, seen, priors, settings)


def _chosen(
    estimator: AnyEstimator,
    stretches: Sequence[Stretch],
    ignored: Sequence[str],
    settings: MotionSettings,
    told: Progress,
) -> tuple[SeenFrames, list[int]]:
    """Frames that are far enough apart, and how many of each stretch."""
    total = sum(len(stretch.frames) for stretch in stretches)
    spacing = max(settings.spacing * estimator.rate, total / settings.most_frames, 1.0)
    hidden = np.isin(estimator.subject.trackers, list(ignored))
    chosen: list[TrackerFrame] = []
    qpos, sizes, done = [], [], 0
    for stretch in stretches:
        if not stretch.frames:
            sizes.append(0)
            continue
        before, due = len(qpos), float(_SETTLING)
        own = estimator if stretch.allowed is None else estimator.leave_out(stretch.allowed)
        state = own.init(without(stretch.frames[0], hidden))
        for index, frame in enumerate(stretch.frames):
            state, pose = own.step(state, without(frame, hidden))
            if index >= due:
                due += spacing
                chosen.append(frame)
                qpos.append(np.asarray(pose.qpos, dtype=float))
            done += 1
            told(done, total, "synthesizing")
        sizes.append(len(qpos) - before)
    J = len(hidden)
    seen = SeenFrames(
        np.array([f.positions for f in chosen], dtype=float).reshape(-1, J, 3),
        np.array([f.quaternions for f in chosen], dtype=float).reshape(-1, J, 4),
        np.array([f.position_mask for f in chosen], dtype=bool).reshape(-1, J),
        np.array([f.orientation_mask for f in chosen], dtype=bool).reshape(-1, J),
        np.array(qpos).reshape(-1, 63),
    )
    return seen, sizes


def without(frame: TrackerFrame, hidden: Bool[ndarray, " J"]) -> TrackerFrame:
    """A frame in which some trackers are not seen."""
    return frame._replace(
        position_mask=frame.position_mask & ~hidden,
        orientation_mask=frame.orientation_mask & ~hidden,
    )


def _recorded(result: MotionFit) -> Subject:
    """The subject with its deviations on record."""
    subject, known = result.subject, result.knowledge
    old = subject.calibration or CalibrationRecord(date="")
    relative = np.sqrt(np.diag(known.log_lengths))[group_of_bone()]
    places, turns = known.position_sd, known.turn_sd
    record = replace(
        old,
        method=f"{old.method or 'unknown'}, refined by motion",
        length_sd=dict(zip(BONE_NAMES, (subject.lengths * relative).tolist(), strict=True)),
        position_sd={n: _three(row) for n, row in zip(known.trackers, places, strict=True)},
        orientation_sd={n: _three(row) for n, row in zip(known.trackers, turns, strict=True)},
    )
    return replace(subject, calibration=record)


def _three(values: ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
