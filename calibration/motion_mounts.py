"""Mounts seen in ordinary motion: where each tracker sits, judged by all the others.

For every tracker the body is synthesized without it; where the tracker is on that body is one
reading of its mount a frame. The other trackers and the database know the bone that carries
it only so well, and a person's habits (how a head is held, how a hand hangs) offset all
readings alike, so a reading is never better than `HABIT` says, however long the motion.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from calibration.fit import robust_mean
from calibration.refinement import BuildEstimator, Progress, without
from localreg.body.subject import Mount, Subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.synthesis.estimator import AnyEstimator
from sensors.pose import TrackerFrame

HABIT: Final = (0.025, float(np.radians(6.0)))
HEAD_HABIT: Final = (0.025, float(np.radians(10.0)))
"""What readings are off by on each axis, all alike: position [m], turn [rad]."""

_SETTLING: Final = 10
_BLOCKS: Final = 5
_LEAST_FRAMES: Final = 80
_SLIPPED: Final = 3.0


@dataclass(frozen=True, eq=False)
class Reading:
    """One tracker's mount as the others see it.

    Attributes:
        tracker: its name.
        position: in the bone's frame [m].
        turn: tracker axes to bone axes.
        position_sd: standard deviation on each axis [m].
        turn_sd: about each axis [rad].
    """

    tracker: str
    position: Float[ndarray, "3"]
    turn: Rotation
    position_sd: float
    turn_sd: float

    def away(self, mount: Mount) -> tuple[float, float]:
        """How far it is from a mount [m], and turned against it [rad]."""
        distance = float(np.linalg.norm(self.position - np.array(mount.position)))
        file = Rotation.from_quat(mount.quaternion, scalar_first=True)
        return distance, float((file.inv() * self.turn).magnitude())


@dataclass(frozen=True, slots=True)
class MountCheck:
    """What became of one tracker's mount.

    Attributes:
        tracker: its name.
        distance: between reading and file [m].
        turn: the same [rad].
        score: the same in standard deviations, the larger of both per axis.
    """

    tracker: str
    distance: float
    turn: float
    score: float

    @property
    def has_slipped(self) -> bool:
        """Whether habits and chance do not explain it."""
        return self.score > _SLIPPED


def apart(one: Mount, other: Mount) -> tuple[float, float]:
    """How far two mounts are from each other [m], and turned against each other [rad]."""
    distance = float(np.linalg.norm(np.array(one.position) - np.array(other.position)))
    turns = Rotation.from_quat([one.quaternion, other.quaternion], scalar_first=True)
    return distance, float((turns[0].inv() * turns[1]).magnitude())


def read_mount(
    estimator: AnyEstimator,
    frames: Sequence[TrackerFrame],
    tracker: str,
    ignored: Sequence[str] = (),
    progress: Callable[[int], None] | None = None,
) -> Reading:
    """Read one tracker's mount.

    Args:
        estimator: of the subject; `frames` have its trackers in its order.
        frames: motion at the estimator's rate.
        tracker: whose mount.
        ignored: further trackers that are not trusted.
        progress: told after every frame how many are done.

    Raises:
        LocalregError: too little motion, or the tracker was hardly seen in it.
    """
    subject = estimator.subject
    names = subject.trackers
    j = names.index(tracker)
    if len(frames) < _LEAST_FRAMES:
        raise LocalregError(
            f"{len(frames)} frames of motion are too few; move about for {_LEAST_FRAMES} or more"
        )
    hidden = np.isin(names, [tracker, *ignored])
    carrier = replace(subject.mounts[j], position=(0.0, 0.0, 0.0), quaternion=(1.0, 0.0, 0.0, 0.0))
    body = BodyPoints(replace(subject, mounts=(carrier,)))
    state = estimator.init(without(frames[0], hidden))
    qpos, seen = [], []
    for index, frame in enumerate(frames):
        state, pose = estimator.step(state, without(frame, hidden))
        if index >= _SETTLING and frame.position_mask[j] and frame.orientation_mask[j]:
            qpos.append(np.asarray(pose.qpos))
            seen.append(index)
        if progress is not None:
            progress(index + 1)
    if len(seen) < _LEAST_FRAMES // 2:
        raise LocalregError(f"tracker {tracker} was hardly seen; see that it is on and not hidden")
    bone = body.tracker_poses(np.array(qpos, dtype=float))
    turned = Rotation.from_quat(bone.quaternions[:, 0], scalar_first=True)
    at = np.array([frames[i].positions[j] for i in seen])
    measured = Rotation.from_quat(
        np.array([frames[i].quaternions[j] for i in seen]), scalar_first=True
    )
    positions = turned.inv().apply(at - bone.positions[:, 0])
    turns = turned.inv() * measured
    return _averaged(tracker, positions, turns, HEAD_HABIT if carrier.bone == "head" else HABIT)


def _averaged(
    tracker: str, positions: Float[ndarray, "n 3"], turns: Rotation, habit: tuple[float, float]
) -> Reading:
    position = np.median(positions, axis=0)
    turn = robust_mean([turns[i] for i in range(0, len(turns), max(1, len(turns) // 60))])
    blocks = np.array_split(np.arange(len(positions)), _BLOCKS)
    by_block = np.array([np.median(positions[b], axis=0) for b in blocks])
    turned = np.array(
        [(turn.inv() * turns[int(b[0]) : int(b[-1]) + 1]).as_rotvec().mean(axis=0) for b in blocks]
    )
    position_sd = float(np.hypot(habit[0], by_block.std(axis=0).mean() / np.sqrt(_BLOCKS)))
    turn_sd = float(np.hypot(habit[1], turned.std(axis=0).mean() / np.sqrt(_BLOCKS)))
    return Reading(tracker, position, turn, position_sd, turn_sd)


def check_mounts(
    subject: Subject,
    build: BuildEstimator,
    frames: Sequence[TrackerFrame],
    progress: Progress | None = None,
) -> list[MountCheck]:
    """Compare every mount with what motion says.

    A tracker that has slipped misleads the readings of the others, so the worst is taken out
    and the rest read again, until nothing stands out.

    Args:
        subject: as calibrated.
        build: makes an estimator for a subject.
        frames: motion at the estimator's rate.
        progress: told how many readings are done, of how many, and of which tracker.

    Raises:
        LocalregError: too little motion.
    """
    estimator = build(subject)
    slipped: list[MountCheck] = []
    while True:
        ignored = [check.tracker for check in slipped]
        names = [name for name in subject.trackers if name not in ignored]
        checks = []
        for done, name in enumerate(names):
            if progress is not None:
                progress(done, len(names), name)
            reading = read_mount(estimator, frames, name, ignored)
            checks.append(_checked(reading, subject))
        worst = max(checks, key=lambda check: check.score)
        if not worst.has_slipped or len(names) <= 3:
            by_name = {check.tracker: check for check in [*checks, *slipped]}
            return [by_name[name] for name in subject.trackers]
        slipped.append(worst)


def _checked(reading: Reading, subject: Subject) -> MountCheck:
    mount = next(m for m in subject.mounts if m.tracker == reading.tracker)
    distance, turn = reading.away(mount)
    position_sd, turn_sd = _known_deviations(subject, reading.tracker)
    # A length of three axes: root three times one axis' deviation.
    far = distance / (np.sqrt(3.0) * np.hypot(reading.position_sd, position_sd))
    askew = turn / (np.sqrt(3.0) * np.hypot(reading.turn_sd, turn_sd))
    return MountCheck(reading.tracker, distance, turn, float(np.sqrt(3.0) * max(far, askew)))


def _known_deviations(subject: Subject, tracker: str) -> tuple[float, float]:
    """What a subject's file says of a mount: deviation of position [m] and turn [rad]."""
    record = subject.calibration
    if record is None or tracker not in record.position_sd:
        return 0.0, 0.0
    position = float(np.sqrt(np.mean(np.square(record.position_sd[tracker]))))
    turn = float(np.sqrt(np.mean(np.square(record.orientation_sd[tracker]))))
    return position, turn


def with_readings(
    subject: Subject,
    build: BuildEstimator,
    frames: Sequence[TrackerFrame],
    slipped: Sequence[str],
) -> Subject:
    """The subject with the mounts of slipped trackers as motion reads them.

    Raises:
        LocalregError: too little motion.
    """
    if not slipped:
        return subject
    estimator = build(subject)
    mounts = list(subject.mounts)
    for name in slipped:
        j = subject.trackers.index(name)
        reading = read_mount(estimator, frames, name, slipped)
        x, y, z = (float(value) for value in reading.position)
        qw, qx, qy, qz = (float(value) for value in reading.turn.as_quat(scalar_first=True))
        mounts[j] = replace(mounts[j], position=(x, y, z), quaternion=(qw, qx, qy, qz))
    return replace(subject, mounts=tuple(mounts))
