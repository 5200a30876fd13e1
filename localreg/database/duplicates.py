"""The same recording found twice by its content: other rate, format, trim, or mirrored.

Archives hold one recording in several files, cut, resampled and converted, often without
a common name. A clip that is left out of the database must take such copies with it, or
the test is taken from the training set.

The rotations of nine large bones, each relative to its parent (the chest: to the root),
describe a pose whatever the axes, proportions and heading of its skeleton. Short windows
of these are compared: a KD-tree on their leading principal components proposes pairs,
which are then aligned to a fraction of a frame and compared in full. Windows without
movement prove nothing and are passed over: people stand still alike.
"""

from collections.abc import Iterator, Sequence
from functools import reduce
from operator import mul
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONE_NAMES, BONES, DOF_BONES, mirror_name

WINDOW: Final = 0.4
"""Duration of the compared windows [s]; a common run is found from 0.5 s on."""

STRIDE: Final = 0.1
"""Time from one window that is looked up to the next [s]."""

TOLERANCE: Final = np.radians(0.75)
"""Largest root mean square angle between the windows of copies [rad].

Among 110 CMU clips, many of them walks of one person, the closest windows of different
recordings are 1.8 degrees apart; the copy among them, in another format, 0.002 degrees.
"""

RELATIVE_TOLERANCE: Final = 0.15
"""The same as a share of the window's own movement (RMS angle about its mean pose)."""

MIN_MOVEMENT: Final = np.radians(2.5)
"""Least movement of a window that can prove anything [rad]."""

_SPINE: Final = ("lowerback", "upperback", "thorax")
_LIMBS: Final = tuple(s + b for b in ("femur", "tibia", "humerus", "radius") for s in "lr")
_MIRRORED_LIMBS: Final = [_LIMBS.index(mirror_name(bone)) for bone in _LIMBS]
_FEATURES: Final = 4 * (1 + len(_LIMBS))
_COMPONENTS: Final = 10


def fingerprints(
    angles: Float[ndarray, "frames 56"], axis_frames: Float[ndarray, "30 3 3"]
) -> Float32[ndarray, "frames 36"]:
    """What is compared of every pose: unit quaternions of chest, thighs, shanks and arms.

    Args:
        angles: joint angles [rad].
        axis_frames: the axis frames in which they turn the bones.

    Returns:
        Nine quaternions w x y z with w >= 0; the distance of two of them is close to half
        the angle between the rotations [rad].
    """
    spine = [_bone_rotation(bone, angles, axis_frames) for bone in _SPINE]
    limbs = [_bone_rotation(bone, angles, axis_frames) for bone in _LIMBS]
    parts = [
        rotation.as_quat(canonical=True, scalar_first=True)
        for rotation in (reduce(mul, spine), *limbs)
    ]
    return np.hstack(parts).astype(np.float32)


def mirrored_fingerprints(
    prints: Float32[ndarray, "frames 36"],
) -> Float32[ndarray, "frames 36"]:
    """The fingerprints of the mirror image of the same poses."""
    quaternions = prints.reshape(len(prints), -1, 4)
    order = [0, *(1 + limb for limb in _MIRRORED_LIMBS)]
    reflected = quaternions[:, order] * np.array([1, 1, -1, -1], dtype=np.float32)
    return reflected.reshape(prints.shape)


class DuplicateFinder:
    """Finds copies of motion among clips.

    Args:
        prints: the fingerprints of all poses, clip after clip.
        clip_of: for every pose the number of its clip, ascending.
        rate: poses a second [Hz].
    """

    def __init__(
        self, prints: Float32[ndarray, "poses 36"], clip_of: Int[ndarray, " poses"], rate: float
    ) -> None:
        self._prints = prints
        self._clip_of = clip_of
        self._length = max(round(WINDOW * rate), 3)
        self._stride = max(round(STRIDE * rate), 1)
        # A frame before and after each window is needed to align it.
        count = max(len(prints) - self._length - 1, 0)
        first = np.arange(1, count)
        whole = clip_of[first - 1] == clip_of[first + self._length]
        first = first[whole]
        moves, _ = _movement(prints, first, self._length)
        self._first = first[moves >= MIN_MOVEMENT]
        self._sampled = np.unique(np.linspace(0, self._length - 1, 5).round().astype(int))
        self._mean, self._basis = _principal_components(prints, self._first, self._sampled)
        self._points = self._project(prints, self._first)
        self._tree = KDTree(self._points)
        self._path = self._project(prints, self._first + 1, self._first - 1)

    def pairs(self) -> set[tuple[int, int]]:
        """Pairs of different clips that share a run of movement, plain or mirrored."""
        found: set[tuple[int, int]] = set()
        for prints in (self._prints, mirrored_fingerprints(self._prints)):
            queries = self._first[:: self._stride]
            for query, match in self._matches(prints, queries, self._clip_of[queries]):
                pairs = np.stack([self._clip_of[query], self._clip_of[match]], axis=1)
                found.update((min(a, b), max(a, b)) for a, b in np.unique(pairs, axis=0).tolist())
        return found

    def clips_like(self, prints: Float32[ndarray, "frames 36"]) -> set[int]:
        """The clips that share a run of movement with a motion of the same rate."""
        found: set[int] = set()
        first = np.arange(1, max(len(prints) - self._length, 1), self._stride)
        if len(prints) < self._length + 2:
            return found
        for version in (prints, mirrored_fingerprints(prints)):
            for _, match in self._matches(version, first, None):
                found.update(np.unique(self._clip_of[match]).tolist())
        return found

    def _project(
        self,
        prints: Float32[ndarray, "frames 36"],
        first: Int[ndarray, " windows"],
        less: Int[ndarray, " windows"] | None = None,
    ) -> Float32[ndarray, "windows components"]:
        """Windows in principal components: as they differ from the mean, or from others."""
        chunks = []
        for part in _chunks(np.arange(len(first))):
            windows = _gather(prints, first[part], self._sampled)
            zero = self._mean if less is None else _gather(prints, less[part], self._sampled)
            chunks.append((windows - zero) @ self._basis)
        return np.concatenate(chunks) if chunks else np.zeros((0, self._basis.shape[1]), np.float32)

    def _matches(
        self,
        prints: Float32[ndarray, "frames 36"],
        first: Int[ndarray, " windows"],
        own_clip: Int[ndarray, " windows"] | None,
    ) -> Iterator[tuple[Int[ndarray, " n"], Int[ndarray, " n"]]]:
        """First frames of equal windows: in `prints`, and among this finder's clips."""
        if not len(self._first):
            return
        moves, speed = _movement(prints, first, self._length)
        moving = moves >= MIN_MOVEMENT
        first, moves, speed = first[moving], moves[moving], speed[moving]
        own_clip = None if own_clip is None else own_clip[moving]
        # Copies may be sampled up to half a frame apart, which moves the windows by so
        # much; quaternions differ by half the angle.
        radius = 0.5 * (TOLERANCE + 0.5 * speed) * np.sqrt(9 * len(self._sampled))
        for start in range(0, len(first), 4096):
            part = first[start : start + 4096]
            points = self._project(prints, part)
            near = self._tree.query_ball_point(points, radius[start : start + 4096])
            counts = np.array([len(hits) for hits in near])
            if not counts.any():
                continue
            index = np.repeat(np.arange(len(part)), counts)
            hits = np.concatenate([np.asarray(h, dtype=int) for h in near])
            index, hits = self._beside_path(points, index, hits, speed[start : start + 4096])
            match = self._first[hits]
            if own_clip is not None:
                other = own_clip[start + index] != self._clip_of[match]
                index, match = index[other], match[other]
            allowed = np.minimum(TOLERANCE, RELATIVE_TOLERANCE * moves[start + index])
            same = self._is_same(prints, part[index], match, allowed)
            yield part[index[same]], match[same]

    def _beside_path(
        self,
        points: Float32[ndarray, "windows components"],
        index: Int[ndarray, " n"],
        hits: Int[ndarray, " n"],
        speed: Float[ndarray, " windows"],
    ) -> tuple[Int[ndarray, " k"], Int[ndarray, " k"]]:
        """The proposals that are near once shifted along the match's own path.

        Most windows within the radius of a fast one are not behind or before it but beside
        it; to align them in full takes a hundred times as long. The path is straight here,
        for which a tenth of the speed is allowed.
        """
        kept = []
        for part in _chunks(np.arange(len(index)), 65_536):
            away = points[index[part]] - self._points[hits[part]]
            along = 0.5 * self._path[hits[part]]
            shift = np.sum(away * along, axis=1) / (np.sum(along**2, axis=1) + 1e-12)
            away -= np.clip(shift, -0.75, 0.75)[:, None] * along
            allowed = 0.5 * (TOLERANCE + 0.1 * speed[index[part]]) * np.sqrt(9 * len(self._sampled))
            kept.append(part[np.sum(away**2, axis=1) <= allowed**2])
        some = np.concatenate(kept)
        return index[some], hits[some]

    def _is_same(
        self,
        prints: Float32[ndarray, "frames 36"],
        query: Int[ndarray, " n"],
        match: Int[ndarray, " n"],
        allowed: Float[ndarray, " n"],
    ) -> Bool[ndarray, " n"]:
        same = np.zeros(len(query), dtype=bool)
        every = np.arange(self._length)
        for rows in _chunks(np.arange(len(query))):
            target = _gather(prints, query[rows], every)
            before, middle, after = (
                _gather(self._prints, match[rows] + shift, every) for shift in (-1, 0, 1)
            )
            distance = _aligned_distance(target, before, middle, after)
            same[rows] = distance <= allowed[rows]
        return same


def _aligned_distance(
    target: Float32[ndarray, "n size"],
    before: Float32[ndarray, "n size"],
    middle: Float32[ndarray, "n size"],
    after: Float32[ndarray, "n size"],
) -> Float[ndarray, " n"]:
    """RMS angle [rad] between windows after the best shift of less than a frame.

    The shifted window is the parabola through the window a frame before, itself and a
    frame after; three Gauss-Newton steps find the shift.
    """
    slope, bend = 0.5 * (after - before), after - 2.0 * middle + before
    shift = np.zeros((len(target), 1), dtype=np.float32)
    for _ in range(3):
        error = target - middle - shift * slope - 0.5 * shift**2 * bend
        tangent = slope + shift * bend
        step = np.sum(error * tangent, axis=1) / (np.sum(tangent**2, axis=1) + 1e-12)
        shift = np.clip(shift + step[:, None], -0.75, 0.75)
    error = target - middle - shift * slope - 0.5 * shift**2 * bend
    return 2.0 * np.sqrt(np.sum(error**2, axis=1) / (target.shape[1] / 4))


def _movement(
    prints: Float32[ndarray, "frames 36"], first: Int[ndarray, " windows"], length: int
) -> tuple[Float[ndarray, " windows"], Float[ndarray, " windows"]]:
    """RMS angle of windows about their mean pose, and RMS angle from frame to frame [rad]."""
    # Running sums: no window is ever formed.
    total = np.concatenate([np.zeros((1, _FEATURES)), np.cumsum(prints, axis=0, dtype=float)])
    square = np.concatenate([[0.0], np.cumsum(np.sum(prints**2, axis=1), dtype=float)])
    steps = np.sum(np.diff(prints, axis=0, prepend=prints[:1]) ** 2, axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps, dtype=float)])
    last = first + length
    mean = (total[last] - total[first]) / length
    variance = (square[last] - square[first]) / length - np.sum(mean**2, axis=1)
    speed = (path[last] - path[first]) / length
    return (
        2.0 * np.sqrt(np.maximum(variance, 0.0) / 9),
        2.0 * np.sqrt(speed / 9),
    )


def _principal_components(
    prints: Float32[ndarray, "frames 36"],
    first: Int[ndarray, " windows"],
    sampled: Int[ndarray, " sampled"],
) -> tuple[Float32[ndarray, " size"], Float32[ndarray, "size components"]]:
    size = len(sampled) * _FEATURES
    if not len(first):
        return np.zeros(size, np.float32), np.eye(size, _COMPONENTS, dtype=np.float32)
    some = first[:: max(len(first) // 4000, 1)]
    windows = _gather(prints, some, sampled)
    mean = windows.mean(axis=0)
    _, vectors = np.linalg.eigh((windows - mean).T @ (windows - mean))
    return mean, np.ascontiguousarray(vectors[:, -_COMPONENTS:])


def _gather(
    prints: Float32[ndarray, "frames 36"],
    first: Int[ndarray, " windows"],
    offsets: Int[ndarray, " offsets"],
) -> Float32[ndarray, "windows size"]:
    return prints[first[:, None] + offsets].reshape(len(first), -1)


def _chunks(indices: Int[ndarray, " n"], size: int = 8192) -> Iterator[Int[ndarray, " m"]]:
    for start in range(0, len(indices), size):
        yield indices[start : start + size]


def _bone_rotation(
    name: str, angles: Float[ndarray, "frames 56"], axis_frames: Float[ndarray, "30 3 3"]
) -> Rotation:
    """R = C Rz Ry Rx C^T of one bone: turns about the columns of C, the first outermost."""
    index, column = BONE_NAMES.index(name), DOF_BONES.index(name)
    turns = [
        Rotation.from_rotvec(angles[:, column + i, None] * axis_frames[index][:, "xyz".index(dof)])
        for i, dof in enumerate(BONES[index].dofs)
    ]
    return reduce(mul, turns)


def common_clips(prints: Sequence[Float32[ndarray, "_ 36"]], rate: float) -> set[tuple[int, int]]:
    """Pairs of clips, by their number, that hold the same recording or a part of it.

    Args:
        prints: the fingerprints of every clip.
        rate: poses a second [Hz], one for all.
    """
    numbers = np.repeat(np.arange(len(prints)), [len(p) for p in prints])
    return DuplicateFinder(np.concatenate(list(prints)), numbers, rate).pairs()
