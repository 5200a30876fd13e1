"""Which database pose looks most like some tracker positions, whichever way the body faces.

Features are what is seen from the reference tracker, so without its orientation they cannot be
told, and nothing can be sought by them. But up is known, and how far two sets of positions
are apart after the best turn about the vertical has a closed form: with the horizontal
coordinates of both as complex numbers a and b, centered,

    min over turns of sum |a - turn b|^2 = sum |a|^2 + sum |b|^2 - 2 |sum conj(a) b|

(Procrustes in the plane).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from localreg.database.features import PER_TRACKER, FeatureLayout

LEAST: Final = 3
"""Fewer positions say too little of a pose."""

_LOOKED_AT: Final = 10_000
"""So many poses are compared; of larger databases every second, third ..."""


@dataclass(frozen=True, eq=False)
class Lineup:
    """Poses to compare with.

    Attributes:
        rows: of the database.
        places: their tracker positions from the reference, the third axis pointing up [m].
    """

    rows: Int[ndarray, " n"]
    places: Float[ndarray, "n J 3"]

    @classmethod
    def of(
        cls,
        layout: FeatureLayout,
        features: Float[ndarray, "N f"],
        targets: Bool[ndarray, " N"],
    ) -> "Lineup":
        """Poses from all over a database.

        Args:
            layout: which feature column means what.
            features: of the database's poses.
            targets: which may be found.
        """
        rows = np.flatnonzero(targets)
        rows = rows[:: max(1, -(-len(rows) // _LOOKED_AT))]
        return cls(rows, _upright(layout, np.asarray(features[rows], dtype=float)))

    def most_alike(self, positions: Float[ndarray, "J 3"], seen: Bool[ndarray, " J"]) -> int | None:
        """The row whose tracker positions are nearest to some after the best turn.

        Args:
            positions: of the trackers, in the world [m].
            seen: whose positions are measured.

        Returns:
            A row, or None where fewer than `LEAST` positions are measured.
        """
        if np.count_nonzero(seen) < LEAST or len(self.rows) == 0:
            return None
        places = self.places[:, seen]
        places = places - places.mean(axis=1, keepdims=True)
        here = positions[seen] - positions[seen].mean(axis=0)
        a, b = here[:, 0] + 1j * here[:, 1], places[..., 0] + 1j * places[..., 1]
        across = np.sum(np.abs(b) ** 2, axis=1) - 2.0 * np.abs(b @ a.conj())  # sum |a|^2 is common
        along = np.sum(np.square(places[..., 2] - here[:, 2]), axis=1)
        return int(self.rows[np.argmin(across + along)])


def _upright(layout: FeatureLayout, features: Float[ndarray, "N f"]) -> Float[ndarray, "N J 3"]:
    """Tracker positions from the reference, in axes of which the third points up."""
    up = features[:, -4:-1]
    # Any axis that is not vertical will do for the first, since every turn is tried.
    least = np.eye(3)[np.argmin(np.abs(up), axis=1)]
    ahead = least - np.sum(least * up, axis=1, keepdims=True) * up
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    axes = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    out = np.zeros((len(features), len(layout.others) + 1, 3))
    blocks = features[:, :-4].reshape(len(features), len(layout.others), PER_TRACKER)
    out[:, list(layout.others)] = np.einsum("nij,nkj->nki", axes, blocks[..., :3])
    return out
