"""What the trackers would say in a pose, free of where in the room it happens.

Neighbours are sought, and regressions fed, by joint angles of the past and by these
features of the present: poses of all trackers relative to a reference tracker (the one
nearest the root, normally the torso's), the direction of gravity in the reference
tracker's axes, and its height. Global position and heading do not enter.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numba import njit
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.chain import Chain, blank_placed, place
from localreg.body.skeleton import BONES
from localreg.body.subject import Subject

_CHUNK: Final = 8192  # poses a batch: bounds memory
PER_TRACKER: Final = 12
"""Feature columns of a tracker: 3 of its relative position, 9 of its rotation matrix."""

_UP: Final = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class FeatureLayout:
    """Which column of a feature vector means what, for one set of J trackers.

    Columns: for each tracker but the reference its position [m] and its rotation matrix
    (row by row) in the reference's axes; then gravity's direction there (3); then the
    reference's height [m].

    Attributes:
        reference: index of the reference tracker.
        others: indices of the other trackers.
    """

    reference: int
    others: tuple[int, ...]

    @classmethod
    def of(cls, subject: Subject) -> "FeatureLayout":
        """The layout for the trackers that a subject wears."""
        depth, parents = {"root": 0}, {bone.name: bone.parent for bone in BONES}
        for bone in BONES:
            depth[bone.name] = depth[bone.parent] + 1
        carried = Counter({"root": len(BONES)})
        for bone in BONES:
            carrier = bone.parent
            while carrier != "root":
                carried[carrier] += 1
                carrier = parents[carrier]
        # A tibia is as near the root as the thorax; what carries more bones moves less.
        ranks = [(depth[mount.bone], -carried[mount.bone]) for mount in subject.mounts]
        reference = ranks.index(min(ranks))
        return cls(reference, tuple(i for i in range(len(ranks)) if i != reference))

    @property
    def size(self) -> int:
        """Number of columns."""
        return PER_TRACKER * len(self.others) + 4

    def columns(
        self, position: Float[ndarray, " J"], rotation: Float[ndarray, " J"]
    ) -> Float[ndarray, " f"]:
        """Spread one number per tracker and kind over the columns they make."""
        trackers, positions = self._columns
        return np.where(positions, position[trackers], rotation[trackers])

    @cached_property
    def _columns(self) -> tuple[Int[ndarray, " f"], Bool[ndarray, " f"]]:
        """The tracker of every column, and whether the column is about its position."""
        one = [True] * 3 + [False] * 9
        positions = np.array(one * len(self.others) + [False, False, False, True])
        return np.repeat([*self.others, self.reference], [12] * len(self.others) + [4]), positions

    def trust(
        self,
        position_mask: Bool[ndarray, " J"],
        orientation_mask: Bool[ndarray, " J"],
        in_reference: float = 0.0,
    ) -> Float[ndarray, " f"]:
        """How far each column is to be believed when only some trackers are known, 0 to 1.

        Args:
            position_mask: which positions are measured.
            orientation_mask: which orientations are.
            in_reference: trust in what is seen from the reference tracker where a part of
                its pose had to be predicted.
        """
        out = np.empty(self.size)
        masks = np.asarray(position_mask, dtype=bool), np.asarray(orientation_mask, dtype=bool)
        write_trust(self.reference, self.others_array, *masks, float(in_reference), out)
        return out

    def extract(
        self, positions: Float[ndarray, "*b J 3"], quaternions: Float[ndarray, "*b J 4"]
    ) -> Float[ndarray, "*b f"]:
        """Features of tracker poses in the world: positions [m], quaternions w x y z."""
        trackers, size = positions.shape[-2], self.size
        out = np.empty((positions.size // (3 * trackers), size))
        flat = positions.reshape(-1, trackers, 3), quaternions.reshape(-1, trackers, 4)
        _write_all(self.reference, self.others_array, *flat, out)
        return out.reshape(*positions.shape[:-2], size)

    @staticmethod
    def seen_turned(
        features: Float[ndarray, " f"], turn: Float[ndarray, "3"]
    ) -> Float[ndarray, " f"]:
        """Features as they are where the reference is taken to be turned by a rotation vector.

        Args:
            features: of one pose.
            turn: in the reference's own axes [rad].
        """
        R = Rotation.from_rotvec(turn).as_matrix()
        out = np.array(features, dtype=float)
        for column in range(0, len(out) - 4, PER_TRACKER):
            block = out[column : column + PER_TRACKER]
            block[:3] = block[:3] @ R
            block[3:] = (R.T @ block[3:].reshape(3, 3)).ravel()
        out[-4:-1] = out[-4:-1] @ R
        return out

    @cached_property
    def others_array(self) -> Int[ndarray, " others"]:
        """`others` as machine code takes them."""
        return np.array(self.others, dtype=np.int64)


def database_features(
    layout: FeatureLayout,
    chain: Chain,
    root: Float32[ndarray, "N 7"],
    angles: Float32[ndarray, "N 56"],
    tell: Callable[[int, int, str], None] | None = None,
) -> Float32[ndarray, "N f"]:
    """Features of every pose of a database, as if this subject had struck it.

    Args:
        layout: which column means what.
        chain: the subject's body.
        root: root positions [m] and quaternions w x y z.
        angles: joint angles [rad].
        tell: is told how many poses are done, of how many.
    """
    trackers = len(layout.others) + 1
    out = np.empty((len(angles), layout.size), dtype=np.float32)
    positions, quaternions = np.empty((_CHUNK, trackers, 3)), np.empty((_CHUNK, trackers, 4))
    for begin in range(0, len(angles), _CHUNK):
        chunk = slice(begin, begin + _CHUNK)
        qpos = np.hstack([root[chunk], angles[chunk]]).astype(float)
        _place_all(chain, qpos, blank_placed(chain), positions, quaternions)
        out[chunk] = layout.extract(positions[: len(qpos)], quaternions[: len(qpos)])
        if tell is not None:
            tell(begin + len(qpos), len(angles), "placing trackers")
    return out


@njit(cache=True)
@no_type_check
def _place_all(chain, qpos, placed, positions, quaternions):
    """Write where some poses put the trackers."""
    for row in range(len(qpos)):
        place(chain, qpos[row], placed)
        positions[row], quaternions[row] = placed.site_position, placed.site_orientation


@njit(cache=True)
@no_type_check
def _write_all(reference, others, positions, quaternions, out):
    for row in range(len(positions)):
        write_features(reference, others, positions[row], quaternions[row], out[row])


@njit(cache=True)
@no_type_check
def write_features(reference, others, positions, quaternions, out):
    """Write the features of one set of tracker poses."""
    own, turn, seen = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    rotation_matrix(quaternions[reference], own)
    column = 0
    for other in others:
        for i in range(3):
            seen[i] = positions[other, i] - positions[reference, i]
        rotation_matrix(quaternions[other], turn)
        for i in range(3):
            total = 0.0
            for k in range(3):
                total += own[k, i] * seen[k]
            out[column + i] = total
        for i in range(3):
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += own[k, i] * turn[k, j]
                out[column + 3 + 3 * i + j] = total
        column += PER_TRACKER
    for i in range(3):
        out[column + i] = own[2, i]
    out[column + 3] = positions[reference, 2]


@njit(cache=True)
@no_type_check
def write_trust(reference, others, seen, facing, in_reference, out):
    """Write the trust in every column; see `FeatureLayout.trust`."""
    turned = 1.0 if facing[reference] else in_reference
    placed = turned if seen[reference] else in_reference
    column = 0
    for other in others:
        out[column : column + 3] = placed if seen[other] else 0.0
        out[column + 3 : column + PER_TRACKER] = turned if facing[other] else 0.0
        column += PER_TRACKER
    out[column : column + 3] = 1.0 if facing[reference] else 0.0
    out[column + 3] = 1.0 if seen[reference] else 0.0


@njit(cache=True)
@no_type_check
def rotation_matrix(q, out):
    """Write the rotation matrix of a unit quaternion w x y z."""
    w, x, y, z = q
    out[0, 0] = 1 - 2 * (y * y + z * z)
    out[0, 1] = 2 * (x * y - w * z)
    out[0, 2] = 2 * (x * z + w * y)
    out[1, 0] = 2 * (x * y + w * z)
    out[1, 1] = 1 - 2 * (x * x + z * z)
    out[1, 2] = 2 * (y * z - w * x)
    out[2, 0] = 2 * (x * z - w * y)
    out[2, 1] = 2 * (y * z + w * x)
    out[2, 2] = 1 - 2 * (x * x + y * y)
