"""Which clips of the database hold poses like the present one, for whoever looks on.

The estimator's own neighbors are nobody else's business. These are found anew, a few times a
second, by the joint angles alone, among a bounded number of poses. In between the nearest of
them goes on as it went in its clip.
"""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.database.store import PoseDatabase
from localreg.view.moment import NeighborClip

_MOST: Final = 20_000
"""Poses looked at: 2 ms on one core."""

_NEAREST: Final = 100
_SHOWN: Final = 4


class Found(NamedTuple):
    """What is like the present pose.

    Attributes:
        clips: of the hundred nearest poses, most frequent first, four at most.
        row: of the nearest pose in the database; -1 if there is none.
    """

    clips: tuple[NeighborClip, ...] = ()
    row: int = -1


class NearestClips:
    """Finds clips by pose.

    Args:
        database: the poses.
    """

    def __init__(self, database: PoseDatabase) -> None:
        every = -(-len(database) // _MOST)
        self._rows = np.arange(0, len(database), every)
        self._angles = np.ascontiguousarray(database.angles[self._rows])
        self._squares = np.einsum("ij,ij->i", self._angles, self._angles)
        self._clip_of = database.clip_index[self._rows]
        self._clips = database.clips

    def find(
        self, qpos: Float[ndarray, "63"], allowed: Bool[ndarray, " poses"] | None = None
    ) -> Found:
        """What is like a pose.

        Args:
            qpos: the present pose.
            allowed: poses of the database that count; None for all.
        """
        angles = qpos[7:].astype(np.float32)
        squared = self._squares - 2.0 * (self._angles @ angles)
        if allowed is not None:
            squared = np.where(allowed[self._rows], squared, np.inf)
        count = min(_NEAREST, int(np.isfinite(squared).sum()))
        if not count:
            return Found()
        nearest = np.argpartition(squared, count - 1)[:count]
        clips, counts = np.unique(self._clip_of[nearest], return_counts=True)
        order = np.argsort(-counts, kind="stable")[:_SHOWN]
        return Found(
            tuple(
                NeighborClip(
                    self._clips[clips[i]].name,
                    self._clips[clips[i]].activity,
                    float(counts[i] / count),
                )
                for i in order
            ),
            int(self._rows[nearest[np.argmin(squared[nearest])]]),
        )


class Example:
    """The nearest pose of the database, going on as it went in its clip.

    Args:
        database: the poses.
    """

    def __init__(self, database: PoseDatabase) -> None:
        self._database = database
        self._since, self._row = 0.0, -1

    def begin(self, row: int, time: float) -> None:
        """Go on from a row of the database at an instant [s]; from none if it is -1."""
        self._since, self._row = time, row

    def at(self, qpos: Float[ndarray, "63"], time: float) -> Float[ndarray, "63"] | None:
        """The example where a pose's root is; None once its clip is over.

        Args:
            qpos: the present pose.
            time: of that pose [s].
        """
        database, begun = self._database, self._row
        row = begun + round((time - self._since) * database.rate)
        if begun < 0 or not begun <= row < len(database):
            return None
        if database.clip_index[row] != database.clip_index[begun]:
            return None
        return np.concatenate([qpos[:7], database.angles[row]])
