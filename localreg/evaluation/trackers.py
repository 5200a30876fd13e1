"""Tracker frames simulated from a motion: noise, outliers, gaps, and what is measured at all.

Every disturbance is drawn from a random stream of its own, named by the seed, the clip,
the tracker and the kind of disturbance. So a clip sees the same noise whatever other clips,
trackers, signals or methods are evaluated, and the first N frames are those of the whole.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.errors import SynthesisError
from localreg.evaluation.body_points import BodyPoints, TrackerPoses
from localreg.evaluation.disturbances import (
    Streams,
    measured_early_or_late,
    outliers,
    presence,
    sensor_noise,
    slips,
)
from localreg.motion.motion import Motion
from sensors.pose import TrackerFrame

SIGNALS: Final = ("both", "position", "orientation")
"""What the trackers measure: their whole pose, or one half of it."""

MEAN_GAP: Final = 0.2
"""How long a tracker that drops out stays away on average, unless told otherwise [s]."""


class Loss(NamedTuple):
    """A tracker that is away for once, at a time that is known.

    Attributes:
        tracker: its name.
        begin: when it goes, from the start of the clip [s].
        seconds: how long it stays away [s].
    """

    tracker: str
    begin: float
    seconds: float


@dataclass(frozen=True, slots=True)
class TrackerQuality:
    """How good the simulated trackers are.

    Attributes:
        noise_position: standard deviation on each axis [m].
        noise_orientation: standard deviation of each component of a rotation vector in
            the tracker's own frame [rad].
        signals: one of `SIGNALS`; what is not measured is masked.
        outliers: probability that a tracker reports nonsense in a frame.
        outlier_position: how far off the position is then, in any direction [m].
        outlier_orientation: how far off the orientation is then, about any axis [rad].
        dropout: share of the time that each tracker is away; nobody is away in the
            first frame.
        dropout_seconds: how long a tracker that drops out stays away on average [s].
        slip_position: how far a tracker slides on its bone, once, in any direction [m];
            after `SLIP_AFTER` on average, each tracker at an instant of its own.
        slip_orientation: how far it turns then, about any axis [rad].
        time_jitter: standard deviation of the instants at which trackers really measure,
            about those of the frames, in each frame anew [s].
        losses: trackers that are away at known times.

    Raises:
        SynthesisError: a number that cannot be.
    """

    noise_position: float = 0.003
    noise_orientation: float = float(np.radians(0.5))
    signals: str = "both"
    outliers: float = 0.0
    outlier_position: float = 0.3
    outlier_orientation: float = float(np.radians(60.0))
    dropout: float = 0.0
    dropout_seconds: float = MEAN_GAP
    slip_position: float = 0.0
    slip_orientation: float = 0.0
    time_jitter: float = 0.0
    losses: tuple[Loss, ...] = ()

    def __post_init__(self) -> None:
        if self.signals not in SIGNALS:
            raise SynthesisError(
                f"trackers cannot measure {self.signals!r}; choose one of {', '.join(SIGNALS)}"
            )
        for name in ("noise_position", "noise_orientation", "time_jitter"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise SynthesisError(f"{name} is {value}; give a standard deviation of 0 or more")
        for name in _SIZES:
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise SynthesisError(f"{name} is {value}; give a size of 0 or more")
        if not 0.0 <= self.outliers <= 1.0:
            raise SynthesisError(f"outliers are {self.outliers}; give a probability from 0 to 1")
        if not 0.0 <= self.dropout < 1.0:
            raise SynthesisError(f"dropout is {self.dropout}; give a share of 0 or more, below 1")
        if not 0.0 < self.dropout_seconds < np.inf:
            raise SynthesisError(f"gaps last {self.dropout_seconds} s; give more than 0")


_SIZES: Final = ("outlier_position", "outlier_orientation", "slip_position", "slip_orientation")


@dataclass(frozen=True, eq=False)
class SimulatedTrackers:
    """What the trackers report during a motion, and what they should have.

    Attributes:
        rate: frames a second [Hz].
        positions: what is reported [m]; zero where masked.
        quaternions: what is reported, w x y z; the identity where masked.
        position_mask: where the position was measured.
        orientation_mask: where the orientation was measured.
        true_positions: without noise, measured or not [m].
        true_quaternions: without noise, measured or not, w x y z.
    """

    rate: float
    positions: Float[ndarray, "frames trackers 3"]
    quaternions: Float[ndarray, "frames trackers 4"]
    position_mask: Bool[ndarray, "frames trackers"]
    orientation_mask: Bool[ndarray, "frames trackers"]
    true_positions: Float[ndarray, "frames trackers 3"]
    true_quaternions: Float[ndarray, "frames trackers 4"]

    def __len__(self) -> int:
        return len(self.positions)

    def frame(self, index: int) -> TrackerFrame:
        """The frame of one instant; time starts at 0 with the motion."""
        return TrackerFrame(
            time=index / self.rate,
            positions=self.positions[index],
            quaternions=self.quaternions[index],
            position_mask=self.position_mask[index],
            orientation_mask=self.orientation_mask[index],
        )

    def __iter__(self) -> Iterator[TrackerFrame]:
        return (self.frame(index) for index in range(len(self)))


def simulate_trackers(
    motion: Motion,
    quality: TrackerQuality | None = None,
    *,
    seed: int = 0,
    truth: TrackerPoses | None = None,
) -> SimulatedTrackers:
    """What the trackers of a motion's own subject would report.

    Args:
        motion: at the rate at which frames are wanted.
        quality: how good the trackers are; by default the evaluation's.
        seed: another seed gives other noise; not negative.
        truth: where the motion puts the trackers if that is known, else it is worked out.
    """
    quality = quality or TrackerQuality()
    truth = truth or BodyPoints(motion.subject).tracker_poses(motion.qpos)
    positions, quaternions = truth.positions.copy(), truth.quaternions.copy()
    present = np.ones(positions.shape[:2], dtype=bool)
    for index, tracker in enumerate(motion.subject.trackers):
        streams = Streams(seed, motion.provenance.name, tracker)
        true = TrackerPoses(truth.positions[:, index, None], truth.quaternions[:, index, None])
        positions[:, index], quaternions[:, index] = _reported(true, quality, streams, motion.rate)
        present[:, index] = _is_there(quality, tracker, streams, len(motion), motion.rate)
    position_mask = present & (quality.signals != "orientation")
    orientation_mask = present & (quality.signals != "position")
    # What was not measured must not help anybody: no trace of the truth is left in it.
    positions[~position_mask] = 0.0
    quaternions[~orientation_mask] = (1.0, 0.0, 0.0, 0.0)
    return SimulatedTrackers(
        rate=motion.rate,
        positions=positions,
        quaternions=quaternions,
        position_mask=position_mask,
        orientation_mask=orientation_mask,
        true_positions=truth.positions,
        true_quaternions=truth.quaternions,
    )


def _reported(
    true: TrackerPoses, quality: TrackerQuality, streams: Streams, rate: float
) -> tuple[Float[ndarray, "frames 3"], Float[ndarray, "frames 4"]]:
    """What one tracker reports, present or not; disturbances in the order of their causes."""
    position = true.positions[:, 0]
    rotation = Rotation.from_quat(true.quaternions[:, 0], scalar_first=True)
    frames = len(position)
    if quality.time_jitter > 0.0:
        position, rotation = measured_early_or_late(
            position, rotation, quality.time_jitter * rate, streams
        )
    if quality.slip_position > 0.0 or quality.slip_orientation > 0.0:
        shift, turn = slips(quality.slip_position, quality.slip_orientation, streams, frames, rate)
        # It slides on the bone: the shift turns with the body.
        position, rotation = position + rotation.apply(shift), rotation * turn
    shift, turn = sensor_noise(quality.noise_position, quality.noise_orientation, streams, frames)
    position, rotation = position + shift, rotation * turn
    if quality.outliers > 0.0:
        shift, turn = outliers(
            quality.outliers, quality.outlier_position, quality.outlier_orientation, streams, frames
        )
        position, rotation = position + shift, rotation * turn
    return position, rotation.as_quat(canonical=True, scalar_first=True)


def _is_there(
    quality: TrackerQuality, tracker: str, streams: Streams, frames: int, rate: float
) -> Bool[ndarray, " frames"]:
    present = presence(quality.dropout, quality.dropout_seconds * rate, streams, frames)
    for loss in quality.losses:
        if loss.tracker == tracker:
            begin = round(loss.begin * rate)
            present[begin : begin + round(loss.seconds * rate)] = False
    return present
