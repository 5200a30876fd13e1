"""What goes wrong with one tracker: noise, outliers, gaps, slips, samples at other instants.

Every kind is drawn from a random stream of its own (`Streams`), and frame by frame, so that
one kind never changes another and a clip cut short is disturbed as the whole one is.
"""

import zlib
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

SLIP_AFTER: Final = 2.0
"""How long a tracker stays in its place before it slips, on average [s]."""


class Streams:
    """The random streams of one tracker in one clip.

    Args:
        seed: not negative.
        clip: the clip's name.
        tracker: the tracker's name.
    """

    def __init__(self, seed: int, clip: str, tracker: str) -> None:
        # crc32, because hash() of a string differs from process to process.
        self._key = (seed, zlib.crc32(clip.encode()), zlib.crc32(tracker.encode()))

    def stream(self, kind: str) -> np.random.Generator:
        """The stream of one kind of disturbance, from its beginning."""
        return np.random.default_rng((*self._key, zlib.crc32(kind.encode())))


def sensor_noise(
    position: float, orientation: float, streams: Streams, frames: int
) -> tuple[Float[ndarray, "frames 3"], Rotation]:
    """Normal noise, independent from frame to frame.

    Args:
        position: standard deviation on each axis [m].
        orientation: standard deviation of each component of the rotation vector [rad].
        streams: of the tracker.
        frames: how many.

    Returns:
        What is added to the position [m], and the turn in the tracker's own frame.
    """
    shape = (frames, 3)
    shift = position * streams.stream("position").standard_normal(shape)
    turn = orientation * streams.stream("orientation").standard_normal(shape)
    return shift, Rotation.from_rotvec(turn)


def outliers(
    probability: float, position: float, orientation: float, streams: Streams, frames: int
) -> tuple[Float[ndarray, "frames 3"], Rotation]:
    """Now and then a report that is far off, in any direction and about any axis.

    Args:
        probability: of an outlier in a frame.
        position: how far off the position is then [m].
        orientation: how far off the orientation is then [rad].
        streams: of the tracker.
        frames: how many.
    """
    is_outlier = streams.stream("outlier").random((frames, 1)) < probability
    shift = position * is_outlier * _directions(streams.stream("outlier position"), frames)
    turn = orientation * is_outlier * _directions(streams.stream("outlier orientation"), frames)
    return shift, Rotation.from_rotvec(turn)


def slips(
    position: float, orientation: float, streams: Streams, frames: int, rate: float
) -> tuple[Float[ndarray, "frames 3"], Rotation]:
    """A tracker that slides on its bone once and stays there, as a loose strap does.

    Args:
        position: how far it slides, in any direction [m].
        orientation: how far it turns, about any axis [rad].
        streams: of the tracker.
        frames: how many.
        rate: frames a second [Hz].

    Returns:
        Shift [m] and turn in the tracker's own frame.
    """
    stream = streams.stream("slip")
    has_slipped = np.arange(frames)[:, None] > stream.exponential(SLIP_AFTER) * rate
    shift, turn = _directions(stream, 2)
    return position * has_slipped * shift, Rotation.from_rotvec(orientation * has_slipped * turn)


def measured_early_or_late(
    position: Float[ndarray, "frames 3"], rotation: Rotation, deviation: float, streams: Streams
) -> tuple[Float[ndarray, "frames 3"], Rotation]:
    """Poses at instants that differ from those of the frames, between the true frames.

    Args:
        position: true positions [m].
        rotation: true rotations.
        deviation: standard deviation of the instants [frames].
        streams: of the tracker.
    """
    frames = len(position)
    if frames < 2:
        return position, rotation
    grid = np.arange(frames, dtype=float)
    instants = grid + deviation * streams.stream("time").standard_normal(frames)
    instants = np.clip(instants, 0.0, frames - 1.0)
    moved = np.stack([np.interp(instants, grid, axis) for axis in position.T], axis=1)
    return moved, Slerp(grid, rotation)(instants)


def presence(dropout: float, gap: float, streams: Streams, frames: int) -> Bool[ndarray, " frames"]:
    """Where a tracker is there: a Markov chain, so that gaps last as real ones do.

    Args:
        dropout: share of the time that it is away; it is there in the first frame.
        gap: how long it stays away on average [frames].
        streams: of the tracker.
        frames: how many.
    """
    present = np.ones(frames, dtype=bool)
    if dropout <= 0.0:
        return present
    chance = streams.stream("dropout").random(frames)
    # With mean gap g and mean presence g (1 - d) / d the share of time away is d. Where
    # even gaps a frame apart do not reach d, longer gaps do.
    there = max(gap * (1.0 - dropout) / dropout, 1.0)
    gap = max(there * dropout / (1.0 - dropout), 1.0)
    there = gap * (1.0 - dropout) / dropout
    for frame in range(1, frames):
        leaves = 1.0 / there if present[frame - 1] else 1.0 - 1.0 / gap
        present[frame] = chance[frame] >= leaves
    return present


def _directions(stream: np.random.Generator, count: int) -> Float[ndarray, "count 3"]:
    vectors = stream.standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
