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

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray

from localreg.body.chain import Chain, difference, integrate, rotate
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Neighbours, Query
from localreg.synthesis.belief import Belief, Limits
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import NEAR, Experience
from localreg.synthesis.halves import Measured
from localreg.synthesis.kept_experience import experience_over, half_over
from localreg.synthesis.linear_algebra import factorize, positive_inverse, substitute
from localreg.synthesis.local_fit import Normal, kernel_weights
from localreg.synthesis.observation import Signals
from localreg.synthesis.prior import Acquisition, Expectation, Prior, spread_starts
from localreg.synthesis.settings import Settings
from localreg.synthesis.state import State
from localreg.synthesis.windows import ranges

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


class Ahead(NamedTuple):
    """The drift before a frame is solved, and what the solution will say of it.

    Attributes:
        drift: as expected.
        gain: change of the drift's mean by the deviation of the pose from the expected one.
    """

    drift: Drift
    gain: Float[ndarray, "62 62"]


class Memory(NamedTuple):
    """How the past is carried on.

    Attributes:
        lasts: share of the drift that is still there a frame later.
        floor_position: least deviation of a step's translation [m].
        floor_angle: of its angles [rad].
        pose_information: share of the pose regression's information that counts.
    """

    lasts: float
    floor_position: float
    floor_angle: float
    pose_information: float


@dataclass(frozen=True, eq=False)
class LocalRegression(Prior):
    """The default prior.

    Attributes:
        settings: the numbers of the method.
        source: where neighbours come from.
        experience: what rehearsal has taught.
        limits: the ranges that the database's joint angles keep to.
        chain: the body that wears the trackers.
        layout: which feature column means what.
    """

    settings: Settings
    source: ExampleSource
    experience: Experience
    limits: Limits
    chain: Chain
    layout: FeatureLayout

    @classmethod
    def over(
        cls,
        source: ExampleSource,
        settings: Settings,
        feature_noise: Float[ndarray, " f"],
        chain: Chain,
        layout: FeatureLayout,
    ) -> "LocalRegression":
        """The prior over a database, after rehearsal.

        Args:
            source: where neighbours come from.
            settings: the numbers of the method.
            feature_noise: what each feature column is off by.
            chain: the body that wears the trackers.
            layout: which feature column means what.
        """
        limits = Limits(*ranges(source.angles, source.targets), settings.limit_softness)
        experience = experience_over(source, settings, feature_noise, chain)
        return cls(settings, source, experience, limits, chain, layout)

    def expect(self, query: Query, state: State) -> Expectation:
        """Pose and step regression, fused with the belief of the last frame."""
        prior = self._rehearsed_for(query, state.signals)
        if prior is not self:
            query = prior.experience.as_rehearsed(query)
        return prior._expect(query, state)

    def _expect(self, query: Query, state: State) -> Expectation:
        settings, source = self.settings, self.source
        neighbours = source.search.search(query, settings.neighbours)
        weights = kernel_weights(neighbours.squared_distances)
        distance = self._distance(neighbours, query)
        before = np.asarray(state.qpos, dtype=float)
        step = self._step(neighbours.rows, weights, query, distance)
        to_the_world(before[3:7], step.mean, step.covariance)
        drift = state.drift or Drift(
            np.zeros(TANGENT_SIZE), step.covariance, np.zeros_like(step.covariance)
        )
        pose = self._pose(neighbours.rows, weights, query, distance)
        qpos, covariance, ahead, offset, information, gain = _look_ahead(
            before, np.asarray(state.covariance), drift, step, pose, self._memory
        )
        return Expectation(
            belief=Belief(qpos, offset, information, self.limits),
            covariance=covariance,
            drift=Ahead(Drift(*ahead), gain),
            caution=self.experience.caution,
            confidence=min(1.0, self.experience.usual / max(distance, 1e-9)),
            near=neighbours,
        )

    def conclude(
        self,
        expectation: Expectation,
        qpos: Float[ndarray, "63"],
        covariance: Float[ndarray, "62 62"],
    ) -> Drift | None:
        """The drift as the solved pose has corrected it."""
        if expectation.drift is None:
            return None
        drift, gain = expectation.drift
        moved = np.empty(TANGENT_SIZE)
        difference(expectation.belief.qpos, qpos, moved)
        corrected, finite = _correct(drift, gain, moved, covariance)
        return Drift(*corrected) if finite else None

    def acquire(self, query: Query) -> Acquisition:
        """The pose regression's answer without a past, and some of the examples themselves."""
        neighbours = self.source.search.search(query, self.settings.neighbours)
        weights = kernel_weights(neighbours.squared_distances)
        distance = self._distance(neighbours, query)
        pose = self._pose(neighbours.rows, weights, query, distance)
        examples = self.source.angles[neighbours.rows].astype(float)
        return Acquisition(
            spread_starts(pose.mean, examples), pose.mean, np.linalg.inv(pose.covariance)
        )

    @cached_property
    def _memory(self) -> Memory:
        settings = self.settings
        return Memory(
            lasts=settings.drift_memory,
            floor_position=settings.step_floor_position,
            floor_angle=settings.step_floor_angle,
            pose_information=settings.pose_information,
        )

    @cached_property
    def _halves(self) -> dict[Signals, "LocalRegression"]:
        """The prior as rehearsed with half of the signals, once a stream has begun with them."""
        return {}

    def _rehearsed_for(self, query: Query, signals: Signals | None) -> "LocalRegression":
        """The prior for a stream that began with these signals and has no more of them now."""
        if signals is None or signals == "both":
            return self
        if signals not in self._halves:
            measured = Measured.of(
                self.layout,
                position=signals == "position",
                orientation=signals == "orientation",
            )
            learned = half_over(self.experience, self.source, self.settings, self.chain, measured)
            self._halves[signals] = replace(self, experience=learned)
        found = self._halves[signals]
        return self if query.feature_trust[found.experience.trust == 0.0].any() else found

    def _distance(self, neighbours: Neighbours, query: Query) -> float:
        """How far the neighbours are, squared, as if the whole query were known."""
        near = float(neighbours.squared_distances[int(NEAR * len(neighbours.rows))])
        if query.is_whole:
            return min(near, _FARTHEST)
        whole = self.experience.whole_distance(near, query.history_valid, query.feature_trust)
        return float(min(whole, _FARTHEST))

    def _pose(
        self,
        rows: Int[ndarray, " K"],
        weights: Float[ndarray, " K"],
        query: Query,
        distance: float,
    ) -> Normal:
        known = self.experience
        raw = np.concatenate([query.history.ravel(), query.features])
        trust = None
        if not query.is_whole:
            past = np.repeat(query.history_valid, DOF_COUNT)
            trust = np.concatenate([past, query.feature_trust])
        growth = distance * known.pose_growth
        growth.flat[:: DOF_COUNT + 1] += self.settings.floor**2
        return known.pose.predict(
            rows, weights, raw, trust, self.source.angles[rows],
            self.settings.pose_ridge, known.pose_share, growth,
        )  # fmt: skip

    def _step(
        self,
        rows: Int[ndarray, " K"],
        weights: Float[ndarray, " K"],
        query: Query,
        distance: float,
    ) -> Normal:
        """The step, root translation in the root's own axes."""
        known = self.experience
        trust = None
        if not query.history_valid.all():
            trust = np.repeat(query.history_valid, DOF_COUNT).astype(float)
        return known.step.predict(
            rows, weights, query.history.ravel(), trust, known.steps.of(rows),
            self.settings.step_ridge, known.step_share, distance * known.step_growth,
        )  # fmt: skip


@njit(cache=True)
@no_type_check
def to_the_world(quaternion, mean, covariance):
    """Turn a step's root translation from the root's axes into the world's, in place."""
    turned = np.empty(3)
    rotate(quaternion, mean[:3], turned)
    mean[:3] = turned
    for j in range(covariance.shape[1]):
        rotate(quaternion, covariance[:3, j], turned)
        covariance[:3, j] = turned
    for i in range(len(covariance)):
        rotate(quaternion, covariance[i, :3], turned)
        covariance[i, :3] = turned


@njit(cache=True)
@no_type_check
def _carry(covariance, drift, step, memory):
    """The past carried on: covariance of the pose, and the drift's parts."""
    n, lasts = len(covariance), memory.lasts
    before, crossed = drift.covariance, drift.cross
    ahead, spread, cross = np.empty((n, n)), np.empty((n, n)), np.empty((n, n))
    for i in range(n):
        for j in range(n):
            spread[i, j] = lasts**2 * before[i, j] + (1.0 - lasts**2) * step[i, j]
            cross[i, j] = lasts * crossed[i, j] + spread[i, j]
            both = lasts * (crossed[i, j] + crossed[j, i])
            ahead[i, j] = covariance[i, j] + spread[i, j] + both
        ahead[i, i] += (memory.floor_position if i < 3 else memory.floor_angle) ** 2
    return ahead, (lasts * drift.mean, spread, cross)


@njit(cache=True)
@no_type_check
def _fuse(covariance, cross, pose, qpos, share):
    """What past and pose regression say together of the deviation from a pose.

    Returns:
        Its mean, its information, and the gain of the drift.
    """
    carried = positive_inverse(covariance)
    new = share * positive_inverse(pose.covariance)
    information = carried.copy()
    information[6:, 6:] += new
    pull, mean = np.zeros(len(carried)), np.empty(len(carried))
    pull[6:] = np.dot(new, pose.mean - qpos[7:])
    L = np.zeros_like(information)
    if factorize(information, 0.0, L):
        substitute(L, pull, mean)
    else:
        mean[:] = np.nan
    return mean, information, np.dot(cross.T, carried)


@njit(cache=True)
@no_type_check
def _look_ahead(before, covariance, drift, step, pose, memory):
    """From the last pose and both regressions to a belief.

    Returns:
        The expected pose, its covariance by the past alone, the parts of the drift; mean and
        information of the deviation from that pose, and the gain of the drift.
    """
    ahead, drifting = _carry(covariance, drift, step.covariance, memory)
    qpos = np.empty_like(before)
    integrate(before, step.mean + drifting[0], qpos)
    mean, information, gain = _fuse(ahead, drifting[2], pose, qpos, memory.pose_information)
    return qpos, ahead, drifting, mean, information, gain


@njit(cache=True)
@no_type_check
def _correct(drift, gain, moved, after):
    """The parts of a drift once the pose is known better, and whether they are numbers."""
    mean = drift.mean + np.dot(gain, moved)
    cross = np.dot(after, gain.T)
    less = np.dot(gain, drift.cross - cross)
    before, spread, total = drift.covariance, np.empty_like(less), np.sum(mean)
    for i in range(len(spread)):
        for j in range(len(spread)):
            spread[i, j] = before[i, j] - 0.5 * (less[i, j] + less[j, i])
            total += spread[i, j] + cross[i, j]
    return (mean, spread, cross), np.isfinite(total)
