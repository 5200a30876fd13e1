"""From tracker frames to poses, one at a time: the same `step` live and offline.

frame -> query -> prior (neighbours, regression) -> belief -> solver -> pose
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.chain import Chain, blank_placed, chain_of, place_trackers
from localreg.body.kinematics import Kinematics
from localreg.body.skeleton import TANGENT_SIZE
from localreg.body.subject import Subject
from localreg.database.features import FeatureLayout, quaternions_to_matrices
from localreg.database.neighbours import Query
from localreg.numerics import host_arrays
from localreg.synthesis.alignment import align_root, snap_to_reference
from localreg.synthesis.belief import Belief
from localreg.synthesis.compiled import Control, energy_at
from localreg.synthesis.energy import Observation
from localreg.synthesis.estimator import Estimator, Pose, Result
from localreg.synthesis.prior import Expectation, Prior
from localreg.synthesis.settings import Settings
from localreg.synthesis.solver import SOLVERS, Problem, Solution
from localreg.synthesis.state import (
    LONG,
    Attention,
    State,
    blank_state,
    coasting,
    remember,
    state_at,
)
from sensors.pose import TrackerFrame

LOST_AFTER: Final = 4
"""Frames in a row far from most trackers after which the pose is sought anew."""

_ROOM: Final = 1000.0
"""No tracker is farther than this from the origin, or its position is nonsense [m]."""

_FAR: Final = 40.0
"""Median squared distance to the trackers, in units of their sigmas, that counts as far:
3 cm or 6 degrees where 0.5 cm and 1 degree are expected."""

_JUMP: Final = 0.12
"""A tracker this far from prediction is doubted [m] ..."""

_TWIST: Final = np.radians(30.0)
"""... as is one turned this far from it [rad] ..."""

_DOUBT: Final = 20
"""... for at most so many frames in a row."""

_LEAST_TRUST: Final = 0.05
"""Trust in what is seen from a reference pose that has long been predicted only."""

_LEAST_INFORMATION: Final = 1e-6
"""Keeps a covariance finite where nothing is observed."""


@dataclass(frozen=True, eq=False)
class Synthesizer(Estimator[State]):
    """An estimator made of a body and a prior.

    Attributes:
        subject: whose body is moved.
        rate: frames a second that `step` expects [Hz].
        settings: the numbers of the method.
        kinematics: the subject's body.
        prior: the method's belief.
        rebuild: makes the same estimator over other poses; None without a database.
    """

    subject: Subject
    rate: float
    settings: Settings
    kinematics: Kinematics
    prior: Prior
    rebuild: Callable[[Bool[ndarray, " poses"]], "Synthesizer"] | None = None

    def leave_out(self, allowed: Bool[ndarray, " poses"]) -> "Synthesizer":
        """The same estimator seeing only the allowed poses of its database."""
        return self if self.rebuild is None else self.rebuild(allowed)

    def init(self, frame: TrackerFrame) -> State:
        """Find the pose from one frame alone, from several starts."""
        return self._acquire(self._blank(), _observe(frame))[0]

    def init_at(self, qpos: Float[ndarray, "63"]) -> State:
        """Begin from a known pose."""
        qpos = np.asarray(qpos, dtype=float)
        return state_at(qpos, self.settings.history, len(self.subject.trackers))

    def step(self, state: State, frame: TrackerFrame) -> tuple[State, Pose]:
        """The next pose."""
        observation = _observe(frame)
        query, attention = self._query(state, observation)
        expectation = self.prior.expect(query, state)
        solution = self._solve(state, observation, expectation)
        solved = solution.ok
        if not solved:
            solution = self._stay(state, observation, expectation)
        covariance = _inverse(solution.hessian)
        after = remember(state, solution.qpos)._replace(
            covariance=covariance,
            attention=attention,
            drift=self.prior.conclude(expectation, solution.qpos, covariance),
            lost=state.lost + 1 if self._is_far(observation, solution) else 0,
        )
        result = Result.SOLVED if solved else Result.FAILED
        if after.lost >= LOST_AFTER:
            after = after._replace(lost=0)
            blank = self._blank()._replace(qpos=after.qpos)
            found, sought = self._acquire(blank, observation)
            if sought.ok and not self._is_far(observation, sought):
                after, solution, result = found, sought, Result.REACQUIRED
        return after, self._pose(frame.time, after, observation, solution, expectation, result)

    @cached_property
    def _chain(self) -> Chain:
        return chain_of(self.kinematics)

    @cached_property
    def _layout(self) -> FeatureLayout:
        return FeatureLayout.of(self.subject)

    @property
    def _control(self) -> Control:
        settings = self.settings
        return Control(settings.sigma_position, settings.sigma_orientation, settings.lorentzian)

    def _problem(self, observation: Observation, belief: Belief) -> Problem:
        return Problem(self.kinematics, self._chain, observation, self._control, belief)

    def _blank(self) -> State:
        return blank_state(self.settings.history, len(self.subject.trackers))

    def _query(self, state: State, observation: Observation) -> tuple[Query, Attention]:
        """What is known before the pose is solved, and whom it was heard from.

        A tracker far from where the motion so far leads is not believed here, or one jump
        would choose the neighbours; the energy, which is robust, hears it all the same.
        Where the reference tracker is masked or doubted, its predicted pose takes its place.
        """
        layout, reference = self._layout, self._layout.reference
        predicted_positions, predicted = place_trackers(self._chain, coasting(state))
        positions, quaternions = map(np.array, (observation.positions, observation.quaternions))
        seen, facing = map(np.array, (observation.position_mask, observation.orientation_mask))
        off = np.linalg.norm(positions - predicted_positions, axis=1)
        turned = 2.0 * np.arccos(np.clip(np.abs((quaternions * predicted).sum(axis=1)), 0.0, 1.0))
        far = (seen & (off > _JUMP)) | (facing & (turned > _TWIST))
        away = np.where(far, np.minimum(state.attention.away + 1, LONG), 0)
        away = np.where(seen | facing, away, LONG)
        believed = ~far | (away > _DOUBT)
        seen, facing = seen & believed, facing & believed
        guided = bool(seen[reference] and facing[reference])
        unguided = 0 if guided else min(state.attention.unguided + 1, LONG)
        if not seen[reference]:
            positions[reference] = predicted_positions[reference]
        if not facing[reference]:
            quaternions[reference] = predicted[reference]
        trust = layout.trust(seen, facing, max(_LEAST_TRUST, 0.5 * 0.8**unguided))
        if not self.settings.search_by_trackers and np.any(state.history_valid):
            trust = np.zeros_like(trust)
        query = Query(
            history=np.asarray(state.history),
            history_valid=np.asarray(state.history_valid),
            features=layout.extract(positions, quaternions_to_matrices(quaternions)),
            feature_trust=trust,
        )
        return query, Attention(away, unguided)

    def _solve(self, state: State, observation: Observation, expectation: Expectation) -> Solution:
        """The solver's answer, from the better of two starts."""
        problem = self._problem(observation, expectation.belief)
        expected = expectation.belief.qpos
        if not np.isfinite(expected).all():
            return self._stay(state, observation, expectation)
        # Constant velocity and the reference tracker disagree when one of them is wrong.
        snapped = snap_to_reference(self._chain, expected, observation, self._layout.reference)
        start = min(expected, snapped, key=lambda qpos: self._energy(problem, qpos))
        return SOLVERS[self.settings.solver].solve(problem, start, self.settings.max_steps)

    def _stay(self, state: State, observation: Observation, expectation: Expectation) -> Solution:
        """The pose of the frame before: what is shown when a frame cannot be solved."""
        qpos = np.array(state.qpos, dtype=float)
        positions, orientations = place_trackers(self._chain, qpos)
        apart = np.where(observation.position_mask[:, None], positions - observation.positions, 0.0)
        covariance = np.asarray(state.covariance)
        known = bool(np.isfinite(covariance).all())
        information = np.linalg.pinv(covariance) if known else np.full_like(covariance, np.nan)
        return Solution(qpos, np.nan, 0, information, apart, np.zeros_like(apart), orientations)

    def _energy(self, problem: Problem, qpos: Float[ndarray, "63"]) -> float:
        placed = blank_placed(problem.chain)
        errors = np.zeros_like(placed.site_position), np.zeros_like(placed.site_position)
        room = np.empty(TANGENT_SIZE), np.empty(TANGENT_SIZE)
        return energy_at(
            problem.chain, problem.observation, problem.control, problem.belief, qpos,
            placed, errors, *room,
        )  # fmt: skip

    def _acquire(self, state: State, observation: Observation) -> tuple[State, Solution]:
        """The best pose without a past.

        Where the reference tracker's orientation is not measured, features cannot be told
        before a pose has been found without them.
        """
        query, _ = self._query(state, observation)
        if not observation.orientation_mask[self._layout.reference]:
            blind = query._replace(feature_trust=np.zeros_like(query.feature_trust))
            found, _ = self._best_of_starts(blind, state, observation)
            query, _ = self._query(found, observation)
            query = query._replace(history_valid=np.zeros_like(query.history_valid))
        return self._best_of_starts(query, state, observation)

    def _best_of_starts(
        self, query: Query, state: State, observation: Observation
    ) -> tuple[State, Solution]:
        acquisition = self.prior.acquire(query)
        information = np.zeros((TANGENT_SIZE, TANGENT_SIZE))
        information[6:, 6:] = acquisition.information
        mean = np.zeros(TANGENT_SIZE)
        solutions = []
        for angles in acquisition.starts:
            start = align_root(self._chain, np.asarray(state.qpos), angles, observation)
            mean[6:] = acquisition.mean - angles
            belief = Belief(start, mean.copy(), information)
            problem = self._problem(observation, belief)
            solver = SOLVERS[self.settings.solver]
            solutions.append(solver.solve(problem, start, self.settings.max_steps_acquire))
        best = min(solutions, key=lambda found: found.energy if found.ok else np.inf)
        found = state_at(best.qpos, self.settings.history, len(self.subject.trackers))
        return found._replace(covariance=_inverse(best.hessian)), best

    def _is_far(self, observation: Observation, solution: Solution) -> bool:
        """Whether most trackers are far from where they are synthesized."""
        distances, angles = _residuals(observation, solution)
        control = self._control
        squared = np.concatenate(
            [distances / control.sigma_position, angles / control.sigma_orientation]
        )
        squared = np.square(squared[np.isfinite(squared)])
        return bool(len(squared) and np.median(squared) > _FAR)

    def _pose(
        self,
        time: float,
        state: State,
        observation: Observation,
        solution: Solution,
        expectation: Expectation,
        result: Result,
    ) -> Pose:
        distances, angles = _residuals(observation, solution)
        measured = np.concatenate([observation.position_mask, observation.orientation_mask])
        return Pose(
            time=time,
            qpos=solution.qpos,
            position_residuals=distances,
            orientation_residuals=angles,
            confidence=expectation.confidence * float(np.mean(measured)),
            predicted_sigma=expectation.caution
            * np.sqrt(np.diagonal(np.asarray(state.covariance))[6:]),
            steps=solution.steps,
            result=result,
        )


def _observe(frame: TrackerFrame) -> Observation:
    """A frame's arrays; what cannot be a position, or a rotation, counts as not measured."""
    positions = np.asarray(frame.positions, dtype=float)
    quaternions = np.asarray(frame.quaternions, dtype=float)
    unit = (np.abs(quaternions) < 2.0).all(axis=1, keepdims=True)  # NaN is not
    quaternions = np.where(unit, quaternions, 0.0)
    norms = np.linalg.norm(quaternions, axis=1, keepdims=True)
    seen = np.asarray(frame.position_mask) & (np.abs(positions) < _ROOM).all(axis=1)
    turned = np.asarray(frame.orientation_mask) & (np.abs(norms[:, 0] - 1.0) < 0.1)
    safe = np.where(turned[:, None], quaternions / np.where(norms > 0, norms, 1.0), _IDENTITY)
    return Observation(*host_arrays(np.where(seen[:, None], positions, 0.0), safe, seen, turned))


_IDENTITY: Final = np.array([1.0, 0.0, 0.0, 0.0])


def _residuals(
    observation: Observation, solution: Solution
) -> tuple[Float[ndarray, " J"], Float[ndarray, " J"]]:
    """Distances [m] and angles [rad] to the trackers; NaN where not measured."""
    distances = np.linalg.norm(solution.position_errors, axis=1)
    angles = np.linalg.norm(solution.orientation_errors, axis=1)
    return (
        np.where(observation.position_mask, distances, np.nan),
        np.where(observation.orientation_mask, angles, np.nan),
    )


def _inverse(information: Float[ndarray, "62 62"]) -> Float[ndarray, "62 62"]:
    """The covariance; of a belief that is not finite, one that knows little.

    Or no later frame could be solved either.
    """
    if not np.isfinite(information).all():
        return np.eye(TANGENT_SIZE)
    covariance = np.linalg.inv(information + _LEAST_INFORMATION * np.eye(TANGENT_SIZE))
    return 0.5 * (covariance + covariance.T)
