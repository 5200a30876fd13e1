"""Tracker frames simulated from a motion: noise, outliers, gaps, and what is measured at all.

Every disturbance is drawn from a random stream of its own, named by the seed, the clip,
the tracker and the kind of disturbance. So a clip sees the same noise whatever other clips,
trackers, signals or methods are evaluated, and the first N frames are those of the whole.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.errors import SynthesisError
from localreg.evaluation.body_points import BodyPoints
from localreg.motion.motion import Motion
from sensors.pose import TrackerFrame

SIGNALS: Final = ("both", "position", "orientation")
"""What the trackers measure: their whole pose, or one half of it."""

MEAN_GAP: Final = 0.2
"""How long a tracker that drops out stays away on average [s]."""


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
        dropout: share of the time that each tracker is away, in gaps of `MEAN_GAP` on
            average; nobody is away in the first frame.

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

    def __post_init__(self) -> None:
        if self.signals not in SIGNALS:
            raise SynthesisError(
                f"trackers cannot measure {self.signals!r}; choose one of {', '.join(SIGNALS)}"
            )
        for name in ("noise_position", "noise_orientation"):
            value = getattr(self, name)
            if not 0.0 <= value < np.inf:
                raise SynthesisError(f"{name} is {value}; give a standard deviation of 0 or more")
        if not 0.0 <= self.outliers <= 1.0:
            raise SynthesisError(f"outliers are {self.outliers}; give a probability from 0 to 1")
        if not 0.0 <= self.dropout < 1.0:
            raise SynthesisError(f"dropout is {self.dropout}; give a share of 0 or more, below 1")


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
    body: BodyPoints | None = None,
) -> SimulatedTrackers:
    """What the trackers of a motion's own subject would report.

    Args:
        motion: at the rate at which frames are wanted.
        quality: how good the trackers are; by default the evaluation's.
        seed: another seed gives other noise; not negative.
        body: the subject's body if it is at hand, else it is built.
    """
    quality = quality or TrackerQuality()
    truth = (body or BodyPoints(motion.subject)).tracker_poses(motion.qpos)
    positions, quaternions = truth.positions.copy(), truth.quaternions.copy()
    present = np.ones(positions.shape[:2], dtype=bool)
    for index, tracker in enumerate(motion.subject.trackers):
        streams = _Streams(seed, motion.provenance.name, tracker)
        shift, turn = _disturbances(quality, streams, len(motion))
        positions[:, index] += shift
        turned = Rotation.from_quat(quaternions[:, index], scalar_first=True) * turn
        quaternions[:, index] = turned.as_quat(canonical=True, scalar_first=True)
        present[:, index] = _present(quality.dropout, streams, len(motion), motion.rate)
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


class _Streams:
    """The random streams of one tracker in one clip."""

    def __init__(self, seed: int, clip: str, tracker: str) -> None:
        # crc32, because hash() of a string differs from process to process.
        self._key = (seed, zlib.crc32(clip.encode()), zlib.crc32(tracker.encode()))

    def stream(self, kind: str) -> np.random.Generator:
        return np.random.default_rng((*self._key, zlib.crc32(kind.encode())))


def _disturbances(
    quality: TrackerQuality, streams: _Streams, frames: int
) -> tuple[Float[ndarray, "frames 3"], Rotation]:
    """What is added to the position [m], and the turn in the tracker's own frame."""
    shape = (frames, 3)
    shift = quality.noise_position * streams.stream("position").standard_normal(shape)
    noise = quality.noise_orientation * streams.stream("orientation").standard_normal(shape)
    turn = Rotation.from_rotvec(noise)
    if quality.outliers > 0.0:
        is_outlier = streams.stream("outlier").random(frames) < quality.outliers
        directions = _directions(streams.stream("outlier position"), frames)
        shift = shift + quality.outlier_position * is_outlier[:, None] * directions
        axes = _directions(streams.stream("outlier orientation"), frames)
        turn = turn * Rotation.from_rotvec(quality.outlier_orientation * is_outlier[:, None] * axes)
    return shift, turn


def _directions(stream: np.random.Generator, count: int) -> Float[ndarray, "count 3"]:
    vectors = stream.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _present(
    dropout: float, streams: _Streams, frames: int, rate: float
) -> Bool[ndarray, " frames"]:
    """Where a tracker is there: a Markov chain, so that gaps last as real ones do."""
    present = np.ones(frames, dtype=bool)
    if dropout <= 0.0:
        return present
    chance = streams.stream("dropout").random(frames)
    # With mean gap g and mean presence g (1 - d) / d the share of time away is d. Where
    # even gaps a frame apart do not reach d, longer gaps do.
    presence = max(MEAN_GAP * rate * (1.0 - dropout) / dropout, 1.0)
    gap = max(presence * dropout / (1.0 - dropout), 1.0)
    presence = gap * (1.0 - dropout) / dropout
    for frame in range(1, frames):
        leaves = 1.0 / presence if present[frame - 1] else 1.0 - 1.0 / gap
        present[frame] = chance[frame] >= leaves
    return present
