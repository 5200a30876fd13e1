"""The default prior: what the neighbours, the past and the database's record say together.

Two local ridge regressions are fused with what was believed before. The first predicts the
pose from past joint angles and present tracker features, the second the step since the last
frame (root included) from the past alone. Both are believed as far as rehearsal has shown
(`localreg.synthesis.experience`): their covariance is that of their leave-one-out residuals
plus a part that grows with the squared distance of the neighbours.

Errors of consecutive frames are alike, which is why they cannot simply be averaged:

* An error of the step lasts. It is a first-order autoregressive process, the *drift*, whose
  estimate is carried along and improved by what the trackers say, as in a Kalman filter with
  coloured process noise (Bryson and Henrikson 1968). On motion that the database knows the
  filter leans on the regression; on any other it moves on with the velocity it has seen.
* Errors of the pose regression last for many frames, so only a small share of its
  information counts in each.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg.body.chain import Chain, difference, integrate
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.database.features import quaternions_to_matrices
from localreg.database.neighbours import Neighbours, Query
from localreg.synthesis.belief import Belief, Limits
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import (
    NEAR,
    POSE_RIDGES,
    STEP_RIDGES,
    Experience,
    learn,
)
from localreg.synthesis.local_fit import LocalFit, Normal, kernel_weights, within_reach
from localreg.synthesis.prior import Acquisition, Expectation, Prior, spread_starts
from localreg.synthesis.settings import Settings
from localreg.synthesis.state import State

_FARTHEST = 100.0  # squared distance beyond which nothing more is doubted


class Drift(NamedTuple):
    """How the step regression has lately been wrong, in world axes.

    Attributes:
        mean: expected error of a step.
        covariance: of that error.
        cross: covariance of the pose with it.
    """

    mean: Float[ndarray, "62"]
    covariance: Float[ndarray, "62 62"]
    cross: Float[ndarray, "62 62"]


@dataclass(frozen=True, eq=False)
class LocalRegression(Prior):
    """The default prior.

    Attributes:
        settings: the numbers of the method.
        source: where neighbours come from.
        experience: what rehearsal has taught.
        limits: the ranges that the database's joint angles keep to.
    """

    settings: Settings
    source: ExampleSource
    experience: Experience
    limits: Limits

    @classmethod
    def over(
        cls,
        source: ExampleSource,
        settings: Settings,
        feature_noise: Float[ndarray, " f"],
        chain: Chain,
    ) -> "LocalRegression":
        """The prior over a database, after rehearsal.

        Args:
            source: where neighbours come from.
            settings: the numbers of the method.
            feature_noise: what each feature column is off by.
            chain: the body that wears the trackers.
        """
        seen = source.database.angles[source.targets]
        low, high = seen.min(axis=0).astype(float), seen.max(axis=0).astype(float)
        limits = Limits(low, high, settings.limit_softness)
        return cls(settings, source, learn(source, settings, feature_noise, chain), limits)

    def expect(self, query: Query, state: State) -> Expectation:
        """Pose and step regression, fused with the belief of the last frame."""
        settings = self.settings
        neighbours = self.source.search.search(query, settings.neighbours)
        weights = kernel_weights(neighbours.squared_distances)
        distance = self._distance(neighbours, query)
        before = np.asarray(state.qpos, dtype=float)
        step = _in_the_world(self._step(neighbours.rows, weights, query, distance), before)
        nothing = np.zeros_like(step.covariance)
        drift = state.drift or Drift(np.zeros(TANGENT_SIZE), step.covariance, nothing)
        lasts = settings.drift_memory
        mean = lasts * drift.mean
        spread = lasts**2 * drift.covariance + (1.0 - lasts**2) * step.covariance
        floor = np.repeat(
            [settings.step_floor_position, settings.step_floor_angle], [3, 3 + DOF_COUNT]
        )
        covariance = np.asarray(state.covariance) + spread + np.diag(floor**2)
        covariance += lasts * (drift.cross + drift.cross.T)
        qpos = np.empty(7 + DOF_COUNT)
        integrate(before, step.mean + mean, qpos)
        carried = np.linalg.inv(covariance)
        carried = 0.5 * (carried + carried.T)
        pose = self._pose(neighbours.rows, weights, query, distance)
        new = settings.pose_information * np.linalg.inv(pose.covariance)
        information = carried.copy()
        information[6:, 6:] += 0.5 * (new + new.T)
        pull = np.zeros(TANGENT_SIZE)
        pull[6:] = new @ (pose.mean - qpos[7:])
        return Expectation(
            belief=Belief(qpos, np.linalg.solve(information, pull), information, self.limits),
            covariance=covariance,
            drift=Drift(mean, spread, lasts * drift.cross + spread),
            caution=self.experience.caution,
            confidence=min(1.0, self.experience.usual / max(distance, 1e-9)),
        )

    def conclude(
        self,
        expectation: Expectation,
        qpos: Float[ndarray, "63"],
        covariance: Float[ndarray, "62 62"],
    ) -> Drift | None:
        """The drift as the solved pose has corrected it."""
        drift = expectation.drift
        if drift is None or expectation.covariance is None:
            return None
        gain = np.linalg.solve(expectation.covariance, drift.cross).T
        moved = np.empty(TANGENT_SIZE)
        difference(expectation.belief.qpos, qpos, moved)
        spread = drift.covariance - gain @ (expectation.covariance - covariance) @ gain.T
        corrected = Drift(drift.mean + gain @ moved, 0.5 * (spread + spread.T), covariance @ gain.T)
        return corrected if all(np.isfinite(part).all() for part in corrected) else None

    def acquire(self, query: Query) -> Acquisition:
        """The pose regression's answer without a past, and some of the examples themselves."""
        neighbours = self.source.search.search(query, self.settings.neighbours)
        weights = kernel_weights(neighbours.squared_distances)
        distance = self._distance(neighbours, query)
        pose = self._pose(neighbours.rows, weights, query, distance)
        examples = self.source.database.angles[neighbours.rows].astype(float)
        return Acquisition(
            spread_starts(pose.mean, examples), pose.mean, np.linalg.inv(pose.covariance)
        )

    def _distance(self, neighbours: Neighbours, query: Query) -> float:
        """How far the neighbours are, squared, as if the whole query were known."""
        near = neighbours.squared_distances[int(NEAR * len(neighbours.rows))]
        whole = self.experience.whole_distance(near, query.history_valid, query.feature_trust)
        return float(min(whole, _FARTHEST))

    def _pose(
        self,
        rows: Int[ndarray, " K"],
        weights: Float[ndarray, " K"],
        query: Query,
        distance: float,
    ) -> Normal:
        inputs = self.experience.pose
        trust = np.concatenate([np.repeat(query.history_valid, DOF_COUNT), query.feature_trust])
        x = inputs.reduce(np.concatenate([query.history.ravel(), query.features]), trust)
        X, Y = inputs.of(rows, trust), self.source.database.angles[rows].astype(float)
        fit = LocalFit(X, Y, weights, within_reach(X, weights, x))
        mean, covariance = fit.normal(POSE_RIDGES, self.experience.pose_ridge)
        covariance = covariance + distance * self.experience.pose_growth
        return Normal(mean, covariance + self.settings.floor**2 * np.eye(DOF_COUNT))

    def _step(
        self,
        rows: Int[ndarray, " K"],
        weights: Float[ndarray, " K"],
        query: Query,
        distance: float,
    ) -> Normal:
        """The step, root translation in the root's own axes."""
        inputs = self.experience.step
        trust = np.repeat(query.history_valid, DOF_COUNT).astype(float)
        x = inputs.reduce(query.history.ravel(), trust)
        X, Y = inputs.of(rows, trust), self.experience.steps[rows].astype(float)
        fit = LocalFit(X, Y, weights, within_reach(X, weights, x))
        mean, covariance = fit.normal(STEP_RIDGES, self.experience.step_ridge)
        return Normal(mean, covariance + distance * self.experience.step_growth)


def _in_the_world(step: Normal, qpos: Float[ndarray, "63"]) -> Normal:
    """The step with its root translation turned from the root's axes into the world's."""
    turn = quaternions_to_matrices(qpos[3:7])
    mean, covariance = step.mean.copy(), step.covariance.copy()
    mean[:3] = turn @ mean[:3]
    covariance[:3] = turn @ covariance[:3]
    covariance[:, :3] = covariance[:, :3] @ turn.T
    return Normal(mean, covariance)
