"""The default prior: what the neighbours, the past and the database's record say together.

Two local ridge regressions are fused with what was believed before. The first predicts the
pose from past joint angles and present tracker features, the second the step since the last
frame (root included) from the past alone. Both are believed as far as rehearsal has shown
(`localreg.synthesis.experience`): their covariance is that of their leave-one-out residuals
plus a part that grows with the squared distance of the neighbours. Where that is larger than
usual, joints that hardly move in the database may do so now: a share of their anatomical ranges
is added, and the ranges that the database keeps to become softer.

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

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg.body.chain import Chain, difference
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE, joint_limits
from localreg.database.block_search import plain
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Neighbours, Query
from localreg.synthesis.belief import Belief, Limits
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import Experience
from localreg.synthesis.halves import Measured
from localreg.synthesis.kept_experience import experience_over, half_over
from localreg.synthesis.local_fit import kernel_weights
from localreg.synthesis.look_ahead import (
    NO_DRIFT,
    Drift,
    Memory,
    Outputs,
    Regression,
    blank_ahead,
    blank_drift,
    correct,
    look_ahead,
    regress,
)
from localreg.synthesis.observation import Observation, Signals
from localreg.synthesis.prior import (
    Acquisition,
    Expectation,
    Prior,
    plain_acquisition,
    spread_starts,
)
from localreg.synthesis.rehearsal import NEAR
from localreg.synthesis.settings import Settings
from localreg.synthesis.state import State
from localreg.synthesis.windows import Reduced, ranges

_FARTHEST = 100.0  # squared distance beyond which nothing more is doubted
# Squared distances that are not strange, and no surprise, however near neighbours usually are.
_NOT_STRANGE = 1.0
_NOT_SURPRISING = 10.0


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
        known = self.experience
        near = self.source.search.search(query, self.settings.neighbours)
        distance = self._distance(near, query)
        memory, drift = self._memory, state.drift
        if drift is None:
            memory, drift = memory._replace(lasts=0.0), NO_DRIFT
        fading = state.strain.fading(self.settings.bearable_strain)
        if fading > 1.0:
            memory = memory._replace(fading=fading)
        apart = max(1.0, distance / max(known.usual, 1e-9))
        # Far from all that the database holds, its ranges say little about the joints.
        limits = self.limits._replace(sigma=self.limits.sigma * (fading * apart) ** 0.5)
        ahead = blank_ahead()
        look_ahead(
            np.asarray(state.qpos, dtype=float), np.asarray(state.covariance), drift, near,
            distance, self._pose_inputs(near.rows, query), self._step_inputs(near.rows, query),
            self._pose, self._step, self._outputs, memory, ahead,
        )  # fmt: skip
        return Expectation(
            belief=Belief(ahead.qpos, ahead.mean, ahead.information, limits),
            drift=ahead,
            caution=known.caution,
            confidence=1.0 / apart,
            surprise=distance / max(known.usual, _NOT_SURPRISING),
            near=near,
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
        moved, drift = np.empty(TANGENT_SIZE), blank_drift()
        difference(expectation.belief.qpos, qpos, moved)
        return drift if correct(expectation.drift, moved, covariance, drift) else None

    def most_alike(self, observation: Observation) -> Float[ndarray, "56"] | None:
        """The nearest database pose by positions alone."""
        return self.source.most_alike(observation.positions, observation.position_mask)

    def acquire(self, query: Query) -> Acquisition:
        """The pose regression's answer without a past, and some of the examples themselves."""
        near = self.source.search.search(query, self.settings.neighbours)
        examples = self.source.angles[near.rows]
        # A first pose needs a firm guess of what the trackers do not say.
        regression = self._pose._replace(strange=np.zeros(DOF_COUNT))
        mean, covariance = regress(
            self._pose_inputs(near.rows, query), examples, kernel_weights(near.squared_distances),
            regression, self._distance(near, query),
        )  # fmt: skip
        starts = spread_starts(mean, examples.astype(float))
        return Acquisition(starts, mean, np.linalg.inv(covariance.astype(float)))

    def acquire_plainly(self) -> Acquisition:
        """Easy poses."""
        return plain_acquisition()

    @cached_property
    def _pose(self) -> Regression:
        known, settings = self.experience, self.settings
        # Copies, so that one type is compiled for, whether they come from a file or not.
        share, growth = np.array(known.pose_share), np.array(known.pose_growth)
        usual = max(known.usual, _NOT_STRANGE)
        strange = np.square(settings.strangeness * np.ptp(joint_limits(), axis=1)) / usual
        ridge, floor = float(settings.pose_ridge), float(settings.floor)
        return Regression(ridge, share, growth, floor, usual, strange)

    @cached_property
    def _step(self) -> Regression:
        known = self.experience
        share, growth = np.array(known.step_share), np.array(known.step_growth)
        ridge, nothing = float(self.settings.step_ridge), np.zeros(len(share))
        return Regression(ridge, share, growth, 0.0, known.usual, nothing)

    @cached_property
    def _outputs(self) -> Outputs:
        steps = self.experience.steps
        return Outputs(self.source.angles, plain(steps.root), plain(steps.angles))

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

    def _pose_inputs(self, rows: Int[ndarray, " K"], query: Query) -> Reduced:
        raw, trust = np.concatenate([query.history.ravel(), query.features]), None
        if not query.is_whole:
            past = np.repeat(query.history_valid, DOF_COUNT)
            trust = np.concatenate([past, query.feature_trust])
        return self.experience.pose.at(rows, raw, trust)

    def _step_inputs(self, rows: Int[ndarray, " K"], query: Query) -> Reduced:
        trust = None
        if not query.history_valid.all():
            trust = np.repeat(query.history_valid, DOF_COUNT).astype(float)
        return self.experience.step.at(rows, query.history.ravel(), trust)
