"""The database as regressions see it: reduced inputs and outputs of every pose.

A pose is predicted from its past joint angles and its tracker features, a step from the
past alone; both inputs are measured in units of their noise and reduced to principal
directions. What does not change from frame to frame is worked out here once.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int16
from numba import njit
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.database.block_search import plain
from localreg.database.store import PoseDatabase
from localreg.synthesis.local_fit import LocalFit, within_reach

_BASIS_ROWS = 4000  # windows that principal directions are found from
_CHUNK = 8192  # rows at a time: bounds memory


class Windows(NamedTuple):
    """Poses with their past, as they are.

    Attributes:
        angles: joint angles of all poses [rad].
        features: their features, if these count.
        history: how many poses of the past count.
    """

    angles: Float32[ndarray, "N 56"]
    features: Float32[ndarray, "N f"]
    history: int

    @classmethod
    def of(
        cls, database: PoseDatabase, history: int, features: Float32[ndarray, "N f"] | None = None
    ) -> "Windows":
        """The windows of a database."""
        if features is None:
            features = np.zeros((len(database), 0), dtype=np.float32)
        return cls(plain(database.angles), plain(features), history)

    def at(self, rows: Int[ndarray, " rows"]) -> Float32[ndarray, "rows n"]:
        """Those into some poses: past angles, newest first, then features."""
        return _windows(self, rows)


@njit(cache=True)
@no_type_check
def _windows(windows, rows):
    angles, features, history = windows
    width, beside = angles.shape[1], features.shape[1]
    past = history * width
    out = np.empty((len(rows), past + beside), np.float32)
    for i in range(len(rows)):
        row = rows[i]
        for lag in range(history):
            for n in range(width):
                out[i, lag * width + n] = angles[row - 1 - lag, n]
        for n in range(beside):
            out[i, past + n] = features[row, n]
    return out


class Reduced(NamedTuple):
    """Reduced inputs of a regression.

    Attributes:
        examples: of the neighbours.
        query: the present ones.
    """

    examples: Float32[ndarray, "K r"]
    query: Float32[ndarray, " r"]


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of one kind of regression, for every pose.

    Attributes:
        noise: what each raw input is off by.
        center: what it is on average.
        onto: from raw inputs to the principal directions of inputs in units of their noise.
        windows: what they are of.
        reduced: every pose's inputs along these directions, once they have been worked out,
            in units of `unit`; rows without a full past are not used.
        unit: what one is worth in each direction, far less than the noise.
    """

    noise: Float[ndarray, " n"]
    center: Float32[ndarray, " n"]
    onto: Float32[ndarray, "n r"]
    windows: Windows
    reduced: Int16[ndarray, "N r"] | None = None
    unit: Float32[ndarray, " r"] | None = None

    def of(
        self, rows: Int[ndarray, " rows"], trust: Float[ndarray, " n"] | None = None
    ) -> Float32[ndarray, "rows r"]:
        """Reduced inputs of some rows, with no more trust than the query's; full by default."""
        if self.reduced is not None and trust is None:
            return _read(self.reduced, self.unit, rows)
        return self.reduce(self.windows.at(rows), trust)

    def reduce(
        self, raw: Float[ndarray, "*k n"], trust: Float[ndarray, " n"] | None = None
    ) -> Float32[ndarray, "*k r"]:
        """Raw inputs along the principal directions, those of no trust left out."""
        return (raw - self.center).astype(np.float32) @ self._trusted(trust)

    def _trusted(self, trust: Float[ndarray, " n"] | None) -> Float32[ndarray, "n r"]:
        return self.onto if trust is None else trust.astype(np.float32)[:, None] * self.onto

    def at(
        self,
        rows: Int[ndarray, " K"],
        raw: Float[ndarray, " n"],
        trust: Float[ndarray, " n"] | None = None,
    ) -> "Reduced":
        """Reduced inputs of some rows and of a query, as far as the query's are trusted.

        Args:
            rows: the examples.
            raw: the query's.
            trust: how far each of its entries is believed; fully if None.
        """
        if self.reduced is not None and trust is None:
            return Reduced(*_at(self.reduced, self.unit, self.center, self.onto, rows, raw))
        return Reduced(*_reduce(self.windows, self.center, self._trusted(trust), rows, raw))

    def fit(
        self,
        rows: Int[ndarray, " K"],
        weights: Float[ndarray, " K"],
        raw: Float[ndarray, " n"],
        outputs: Float32[ndarray, "K d"],
        ridge: float,
    ) -> LocalFit:
        """The regression of some rows' outputs on these inputs, at a raw input.

        Args:
            rows: the examples.
            weights: how they count.
            raw: the present input.
            outputs: of the examples.
            ridge: of the regression.
        """
        X, x = self.at(rows, raw)
        return LocalFit(X, outputs, weights, within_reach(X, weights, x), ridge)

    def worked_out(self, targets: Bool[ndarray, " N"]) -> "Inputs":
        """The same with the inputs of all targets reduced beforehand."""
        rows = np.flatnonzero(targets)
        chunks = [rows[begin : begin + _CHUNK] for begin in range(0, len(rows), _CHUNK)]
        largest = np.zeros(self.onto.shape[1], dtype=np.float32)
        for chunk in chunks:
            np.maximum(largest, np.abs(self._along(chunk)).max(axis=0), out=largest)
        unit = np.maximum(largest, 1e-6) / np.float32(np.iinfo(np.int16).max)
        reduced = np.zeros((len(targets), len(unit)), dtype=np.int16)
        for chunk in chunks:
            reduced[chunk] = np.rint(self._along(chunk) / unit)
        reduced.flags.writeable = False  # as a mapped file's, so that one type is compiled for
        return replace(self, reduced=reduced, unit=unit)

    def _along(self, rows: Int[ndarray, " rows"]) -> Float32[ndarray, "rows r"]:
        return (self.windows.at(rows) - self.center) @ self.onto


@njit(cache=True)
@no_type_check
def _at(reduced, unit, center, onto, rows, raw):
    away = np.empty(len(raw), np.float32)
    for n in range(len(raw)):
        away[n] = raw[n] - center[n]
    return _read(reduced, unit, rows), np.dot(away, onto)


@njit(cache=True)
@no_type_check
def _reduce(windows, center, onto, rows, raw):
    examples, away = _windows(windows, rows) - center, np.empty(len(raw), np.float32)
    for n in range(len(raw)):
        away[n] = raw[n] - center[n]
    return np.dot(examples, onto), np.dot(away, onto)


@njit(cache=True)
@no_type_check
def _read(reduced, unit, rows):
    out = np.empty((len(rows), len(unit)), np.float32)
    for i in range(len(rows)):
        row = reduced[rows[i]]
        for j in range(len(unit)):
            out[i, j] = unit[j] * row[j]
    return out


def inputs(
    windows: Windows, targets: Bool[ndarray, " N"], noise: Float[ndarray, " n"], components: int
) -> Inputs:
    """Inputs of a regression, in so many principal directions."""
    rows = np.flatnonzero(targets)
    some = windows.at(rows[:: max(1, len(rows) // _BASIS_ROWS)])
    center = some.mean(axis=0, dtype=float).astype(np.float32)
    scaled = (some - center) / noise
    vectors = np.linalg.eigh(scaled.T @ scaled)[1]
    basis = vectors[:, ::-1][:, :components]
    onto = np.ascontiguousarray(basis / noise[:, None], dtype=np.float32)
    return Inputs(noise, center, onto, windows)


def ranges(
    angles: Float32[ndarray, "N 56"], targets: Bool[ndarray, " N"]
) -> tuple[Float[ndarray, "56"], Float[ndarray, "56"]]:
    """The least and the greatest value of every joint angle among the targets [rad]."""
    low, high = np.full(angles.shape[1], np.inf), np.full(angles.shape[1], -np.inf)
    for begin in range(0, len(angles), _CHUNK):
        chunk = slice(begin, begin + _CHUNK)
        kept = angles[chunk][targets[chunk]]
        low, high = (
            np.minimum(low, kept.min(axis=0, initial=np.inf)),
            np.maximum(high, kept.max(axis=0, initial=-np.inf)),
        )
    return low, high


@dataclass(frozen=True, eq=False)
class Steps:
    """The tangent step into every pose, root translation in the axes of the root before.

    Attributes:
        root: the root's part; zero where there is no pose before.
        angles: joint angles of all poses [rad].
    """

    root: Float32[ndarray, "N 6"]
    angles: Float32[ndarray, "N 56"]

    def of(self, rows: Int[ndarray, " rows"]) -> Float32[ndarray, "rows 62"]:
        """The steps into some poses that have a pose before."""
        return steps_into(self.root, self.angles, rows)


def steps(database: PoseDatabase, targets: Bool[ndarray, " N"]) -> Steps:
    """The steps into all targets."""
    root = np.zeros((len(database), 6), dtype=np.float32)
    rows = np.flatnonzero(targets)
    for begin in range(0, len(rows), _CHUNK):
        chunk = rows[begin : begin + _CHUNK]
        now, before = database.roots[chunk].astype(float), database.roots[chunk - 1].astype(float)
        back = Rotation.from_quat(before[:, 3:], scalar_first=True).inv()
        turn = back * Rotation.from_quat(now[:, 3:], scalar_first=True)
        root[chunk] = np.hstack([back.apply(now[:, :3] - before[:, :3]), turn.as_rotvec()])
    root.flags.writeable = False
    return Steps(root, np.asarray(database.angles))


@njit(cache=True)
@no_type_check
def steps_into(root, angles, rows):
    """`Steps.of` as machine code."""
    out = np.empty((len(rows), root.shape[1] + angles.shape[1]), np.float32)
    whole = np.float32(2.0 * np.pi)
    for i in range(len(rows)):
        row = rows[i]
        out[i, :6] = root[row]
        for j in range(angles.shape[1]):
            bend = angles[row, j] - angles[row - 1, j]
            # Stored angles may jump by a whole turn from one frame to the next.
            if abs(bend) > np.float32(np.pi):
                bend -= whole * np.round(bend / whole)
            out[i, 6 + j] = bend
    return out
