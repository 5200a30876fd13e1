"""Recorded motions one after another, as one person without a rest would do them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from localreg.motion.motion import Motion
from localreg.view.cameras import heading

_RATE: Final = 40.0
_BLEND: Final = 0.6
_LEVEL: Final = np.array([1.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Walk:
    """Poses at 40 Hz, over and over.

    Attributes:
        qpos: the poses.
    """

    qpos: Float[ndarray, "frames 63"]

    @classmethod
    def of(cls, motions: Sequence[Motion]) -> Self:
        """Motions one after another, each begun where and whither the one before ended.

        Args:
            motions: of two frames or more.
        """
        rows = [motions[0].resampled(_RATE).qpos]
        for motion in motions[1:]:
            more = _begun_at(motion.resampled(_RATE).qpos, rows[-1][-1])
            count = round(_BLEND * _RATE)
            blend = [between(rows[-1][-1], more[0], k / count) for k in range(1, count)]
            rows += [np.array(blend), more]
        return cls(np.concatenate(rows))

    def from_pose(self, qpos: Float[ndarray, "63"]) -> "Walk":
        """The same, begun where a body stands."""
        return replace(self, qpos=_begun_at(self.qpos, qpos))

    def at(self, t: float) -> Float[ndarray, "63"]:
        """The pose after so much time [s]."""
        at = (max(t, 0.0) * _RATE) % (len(self.qpos) - 1)
        row = int(at)
        return _mixed(self.qpos[row], self.qpos[row + 1], at - row)


def between(
    before: Float[ndarray, "63"], after: Float[ndarray, "63"], share: float
) -> Float[ndarray, "63"]:
    """On the way from one pose to another with least jerk; shares beyond 0 and 1 are the ends."""
    share = float(np.clip(share, 0.0, 1.0))
    return _mixed(before, after, share**3 * (10.0 - 15.0 * share + 6.0 * share**2))


def _mixed(
    before: Float[ndarray, "63"], after: Float[ndarray, "63"], share: float
) -> Float[ndarray, "63"]:
    qpos = (1.0 - share) * before + share * after
    ends = Rotation.from_quat([before[3:7], after[3:7]], scalar_first=True)
    qpos[3:7] = Slerp([0.0, 1.0], ends)(share).as_quat(scalar_first=True)
    return qpos


def _begun_at(
    qpos: Float[ndarray, "frames 63"], where: Float[ndarray, "63"]
) -> Float[ndarray, "frames 63"]:
    """Moved on the floor and turned about the vertical, so as to begin at a pose."""
    facing, wanted = heading(qpos[0]), heading(where)
    turn = 0.0 if facing is None or wanted is None else wanted - facing
    about = Rotation.from_euler("z", turn)
    moved = qpos.copy()
    moved[:, :3] = about.apply(qpos[:, :3] - qpos[0, :3] * _LEVEL) + where[:3] * _LEVEL
    turned = about * Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
    moved[:, 3:7] = turned.as_quat(scalar_first=True)
    return moved
