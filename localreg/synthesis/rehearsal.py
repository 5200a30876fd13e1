"""Predictions of database poses as if their own clip, with all its copies, were missing."""

from typing import Any, Final, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Neighbours, Query
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.halves import Measured
from localreg.synthesis.local_fit import kernel_weights
from localreg.synthesis.settings import Settings
from localreg.synthesis.windows import Inputs, Steps

NEAR: Final = 0.1
"""The neighbour at this share of K tells how far the neighbours are."""

_LASTING: Final = 0.7  # share of that noise that stays from pose to pose ...
_PASSING: Final = 0.15  # ... and share that does not


class Outcome(NamedTuple):
    """What one regression has said of Q poses.

    Attributes:
        wanted: the truth's deviation from the mean of the neighbours.
        predicted: the regression's.
    """

    wanted: Float[ndarray, "Q d"]
    predicted: Float[ndarray, "Q d"]

    def errors(self, share: Float[ndarray, " d"]) -> Float[ndarray, "Q d"]:
        """What is left where a share of the predicted deviation is believed."""
        return self.wanted - share * self.predicted

    def best_share(self, familiar: Float[ndarray, " Q"]) -> Float[ndarray, " d"]:
        """The share of least weighted squared error, for every output; 0 to 1."""
        weighted = familiar[:, None] * self.predicted
        squares = (weighted * self.predicted).sum(axis=0)
        with np.errstate(invalid="ignore"):
            share = (weighted * self.wanted).sum(axis=0) / squares
        return np.where(squares > 0.0, np.clip(share, 0.0, 1.0), 1.0)


class Rehearsal(NamedTuple):
    """Predictions of database poses without their own clip, Q of them.

    Attributes:
        squared_distance: of the neighbour at `NEAR`.
        feature_share: squared distance of that neighbour along each feature column.
        history_share: the same along each lag of the past.
        pose: the poses' predictions [rad].
        step: the steps' predictions.
        pose_known: variances that the pose regression itself gave its errors [rad^2].
    """

    squared_distance: Float[ndarray, " Q"]
    feature_share: Float[ndarray, "Q f"]
    history_share: Float[ndarray, "Q m"]
    pose: Outcome
    step: Outcome
    pose_known: Float[ndarray, "Q 56"]


class Past(NamedTuple):
    """What past poses are off by.

    Attributes:
        angles: standard deviation of every joint angle [rad].
        turn: times a standard normal vector it is the error of the reference tracker's
            predicted orientation, in its own axes [rad]; zero where it is measured.
    """

    angles: Float[ndarray, "56"]
    turn: Float[ndarray, "3 3"]


def rows_to_rehearse(source: ExampleSource, count: int) -> Int[ndarray, " Q"]:
    """Rows to rehearse on, evenly from all clips."""
    rows = np.flatnonzero(source.targets)
    return rows[np.unique(np.linspace(0, len(rows) - 1, count).astype(int))]


def rehearse(
    source: ExampleSource,
    settings: Settings,
    rows: Int[ndarray, " Q"],
    feature_noise: Float[ndarray, " f"],
    noise: Past,
    measured: Measured,
    pose: Inputs,
    step: Inputs,
    transitions: Steps,
    share: Float[ndarray, "56"],
) -> Rehearsal:
    """Predict each row from the database without its own clip and that clip's copies."""
    database, search = source.database, source.search
    known = np.ones(settings.history, dtype=bool), (measured.trust > 0.0).astype(float)
    rng = np.random.default_rng(0)
    found: list[tuple[Any, ...]] = []
    for row in rows:
        past = database.histories(row[None], settings.history)[0].astype(float)
        lasting = _LASTING * rng.normal(size=(1, DOF_COUNT))
        past += noise.angles * (lasting + _PASSING * rng.normal(size=past.shape))
        features = source.features[row] + 0.5 * feature_noise * rng.normal(size=len(feature_noise))
        if measured.turns:
            turn = _LASTING * noise.turn @ rng.normal(size=3)
            features = FeatureLayout.seen_turned(features, turn)
        group = int(source.view.groups[row])
        available = min(settings.neighbours, search.available(group))
        if available <= int(NEAR * settings.neighbours):
            continue
        query = Query(past, known[0], features, known[1])
        near = search.search(query, available, group)
        found.append(
            _predict(source, settings, int(row), query, near, pose, step, transitions, share)
        )
    if not found:
        return _nothing(settings, len(feature_noise))
    squared, by_feature, by_lag, known, *outcomes = map(np.array, zip(*found, strict=True))
    return Rehearsal(
        squared, by_feature, by_lag, Outcome(*outcomes[:2]), Outcome(*outcomes[2:]), known
    )


def _predict(
    source: ExampleSource,
    settings: Settings,
    row: int,
    query: Query,
    near: Neighbours,
    pose: Inputs,
    step: Inputs,
    transitions: Steps,
    share: Float[ndarray, "56"],
) -> tuple[Any, ...]:
    """One row's entries of a `Rehearsal`."""
    database = source.database
    rows, squared = near
    weights = kernel_weights(squared)
    raw = np.concatenate([query.history.ravel(), query.features])
    angles = pose.fit(rows, weights, raw, source.angles[rows], settings.pose_ridge)
    wanted = source.angles[row].astype(float) - angles.mean
    # The past before a step is known better than its share of lasting noise says.
    past = database.histories(np.array([row]), settings.history)[0].ravel().astype(float)
    into = transitions.of(rows)
    moves = step.fit(rows, weights, past, into, settings.step_ridge)
    middle = rows[int(NEAR * settings.neighbours)]
    apart = database.angles[middle - np.arange(1, settings.history + 1)] - query.history
    metric = source.metric
    return (
        squared[int(NEAR * settings.neighbours)],
        np.square(
            query.feature_trust * metric.features * (source.features[middle] - query.features)
        ),
        np.square(metric.history) * np.square(apart).sum(axis=1),
        np.diagonal(angles.normal(share).covariance).astype(float),
        wanted - 2.0 * np.pi * np.round(wanted / (2.0 * np.pi)),
        angles.deviation.astype(float),
        transitions.of(np.array([row]))[0].astype(float) - moves.mean,
        moves.deviation.astype(float),
    )


def _nothing(settings: Settings, features: int) -> Rehearsal:
    """For a database of a single motion: nothing is familiar, and errors are large."""
    # One coordinate wrong in each, so that together they are independent of each other.
    count = TANGENT_SIZE
    wrong = np.sqrt(count) * np.eye(count)
    nothing = np.zeros((count, count))
    return Rehearsal(
        np.ones(count),
        np.ones((count, features)),
        np.ones((count, settings.history)),
        Outcome(np.radians(10.0) * wrong[:, :DOF_COUNT], nothing[:, :DOF_COUNT]),
        Outcome(np.radians(1.0) * wrong, nothing),
        nothing[:, :DOF_COUNT],
    )
