"""The database as regressions see it: reduced inputs and outputs of every pose.

A pose is predicted from its past joint angles and its tracker features, a step from the
past alone; both inputs are measured in units of their noise and reduced to principal
directions. What does not change from frame to frame is worked out here once.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import DOF_COUNT
from localreg.database.store import PoseDatabase

_BASIS_ROWS = 4000  # windows that principal directions are found from
_CHUNK = 65_536


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs of one kind of regression, for every pose.

    Attributes:
        noise: what each raw input is off by.
        basis: principal directions of the inputs in units of their noise.
        reduced: every pose's inputs in that basis; rows without a full past are not used.
        raw: reads the inputs of some rows as they are.
    """

    noise: Float[ndarray, " n"]
    basis: Float32[ndarray, "n r"]
    reduced: Float32[ndarray, "N r"]
    raw: Callable[[Int[ndarray, " rows"]], Float32[ndarray, "rows n"]]

    def of(
        self, rows: Int[ndarray, " rows"], trust: Float[ndarray, " n"]
    ) -> Float[ndarray, "rows r"]:
        """Inputs of some rows in the basis, with no more trust than the query's."""
        if np.all(trust == 1.0):
            return self.reduced[rows].astype(float)
        return self.reduce(self.raw(rows).astype(float), trust)

    def reduce(
        self, raw: Float[ndarray, "*k n"], trust: Float[ndarray, " n"]
    ) -> Float[ndarray, "*k r"]:
        """Raw inputs in the basis, those of no trust left out."""
        return (raw * (trust / self.noise)) @ self.basis


def pose_inputs(
    database: PoseDatabase,
    features: Float32[ndarray, "N f"],
    targets: Bool[ndarray, " N"],
    history: int,
    noise: Float[ndarray, " n"],
    components: int,
) -> Inputs:
    """Inputs of the pose regression: past angles, newest first, then features."""

    def raw(rows: Int[ndarray, " rows"]) -> Float32[ndarray, "rows n"]:
        past = database.histories(rows, history).reshape(len(rows), -1)
        return np.hstack([past, features[rows]])

    return _inputs(raw, targets, noise, components)


def step_inputs(
    database: PoseDatabase,
    targets: Bool[ndarray, " N"],
    history: int,
    noise: float,
    components: int,
) -> Inputs:
    """Inputs of the step regression: past angles, newest first."""

    def raw(rows: Int[ndarray, " rows"]) -> Float32[ndarray, "rows n"]:
        return database.histories(rows, history).reshape(len(rows), -1)

    return _inputs(raw, targets, np.full(history * DOF_COUNT, noise), components)


def steps(database: PoseDatabase, rows: Int[ndarray, " rows"]) -> Float[ndarray, "rows 62"]:
    """The tangent step into each pose; root translation in the axes of the root before."""
    now, before = database.roots[rows].astype(float), database.roots[rows - 1].astype(float)
    back = Rotation.from_quat(before[:, 3:], scalar_first=True).inv()
    turn = back * Rotation.from_quat(now[:, 3:], scalar_first=True)
    bend = database.angles[rows].astype(float) - database.angles[rows - 1]
    # Stored angles may jump by a whole turn from one frame to the next.
    bend -= 2.0 * np.pi * np.round(bend / (2.0 * np.pi))
    return np.hstack([back.apply(now[:, :3] - before[:, :3]), turn.as_rotvec(), bend])


def all_steps(database: PoseDatabase, targets: Bool[ndarray, " N"]) -> Float32[ndarray, "N 62"]:
    """`steps` of every target; zero elsewhere."""
    found = np.zeros((len(database), 6 + DOF_COUNT), dtype=np.float32)
    rows = np.flatnonzero(targets)
    for begin in range(0, len(rows), _CHUNK):
        chunk = rows[begin : begin + _CHUNK]
        found[chunk] = steps(database, chunk)
    return found


def _inputs(
    raw: Callable[[Int[ndarray, " rows"]], Float32[ndarray, "rows n"]],
    targets: Bool[ndarray, " N"],
    noise: Float[ndarray, " n"],
    components: int,
) -> Inputs:
    rows = np.flatnonzero(targets)
    scaled = raw(rows[:: max(1, len(rows) // _BASIS_ROWS)]) / noise
    scaled -= scaled.mean(axis=0, dtype=float)
    vectors = np.linalg.eigh(scaled.T @ scaled)[1]
    basis = np.ascontiguousarray(vectors[:, ::-1][:, :components], dtype=np.float32)
    onto = (basis / noise[:, None]).astype(np.float32)
    reduced = np.zeros((len(targets), basis.shape[1]), dtype=np.float32)
    for begin in range(0, len(rows), _CHUNK):
        chunk = rows[begin : begin + _CHUNK]
        reduced[chunk] = raw(chunk) @ onto
    return Inputs(noise, basis, reduced, raw)
