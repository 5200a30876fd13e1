"""From tracker frames to poses, one at a time: the same `step` live and offline.

frame -> query -> prior (neighbours, regression) -> belief -> solver -> pose
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from numpy import ndarray

from localreg.body.chain import Chain, place_trackers
from localreg.body.skeleton import TANGENT_SIZE
from localreg.body.subject import Subject
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Query
from localreg.synthesis.alignment import align_root
from localreg.synthesis.ask import ask
from localreg.synthesis.attention import Attention, observe
from localreg.synthesis.belief import Belief
from localreg.synthesis.compiled import Control
from localreg.synthesis.estimator import Estimator, Pose, Result
from localreg.synthesis.linear_algebra import positive_inverse
from localreg.synthesis.observation import Observation
from localreg.synthesis.prior import Acquisition, Expectation, Prior, plain_expectation
from localreg.synthesis.rival import Doubt, are_apart
from localreg.synthesis.settings import Settings
from localreg.synthesis.solver import SOLVERS, Problem, Solution, Solver
from localreg.synthesis.state import (
    State,
    blank_state,
    remember,
    state_at,
)
from localreg.synthesis.strain import Strain
from sensors.pose import TrackerFrame

LOST_AFTER: Final = 4
"""Frames in a row far from most trackers after which the pose is sought anew."""

_FAR: Final = 40.0
"""Median squared distance to the trackers, in units of their sigmas, that counts as far:
3 cm or 6 degrees where 0.5 cm and 1 degree are expected."""

_LEAST_INFORMATION: Final = 1e-6
"""Keeps a covariance finite where nothing is observed."""


class Residuals(NamedTuple):
    """How far each tracker is from where it is synthesized; NaN where not measured.

    Attributes:
        errors: distances [m], then angles [rad].
        median_square: the upper median of their squares in units of their sigmas; 0 if there
            are none.
        measured: share of positions and orientations that is measured.
    """

    errors: Float[ndarray, "2 J"]
    median_square: float
    measured: float

    @property
    def are_far(self) -> bool:
        """Whether most trackers are far from where they are synthesized."""
        return self.median_square > _FAR


class Advance(NamedTuple):
    """One frame from one state.

    Attributes:
        state: after it.
        solution: the solved pose.
        residuals: of it.
        expectation: what was believed before.
        result: how it went.
    """

    state: State
    solution: Solution
    residuals: Residuals
    expectation: Expectation
    result: Result


@dataclass(frozen=True, eq=False)
class Synthesizer(Estimator[State]):
    """An estimator made of a body and a prior.

    Attributes:
        subject: whose body is moved.
        rate: frames a second that `step` expects [Hz].
        settings: the numbers of the method.
        chain: the subject's body.
        prior: the method's belief.
        rebuild: makes the same estimator over other poses; None without a database.
    """

    subject: Subject
    rate: float
    settings: Settings
    chain: Chain
    prior: Prior
    rebuild: Callable[[Bool[ndarray, " poses"]], "Synthesizer"] | None = None

    def leave_out(self, allowed: Bool[ndarray, " poses"]) -> "Synthesizer":
        """The same estimator seeing only the allowed poses of its database."""
        return self if self.rebuild is None else self.rebuild(allowed)

    def init(self, frame: TrackerFrame) -> State:
        """Find the pose from one frame alone, from several starts."""
        observation = observe(frame)
        blank = self._blank()._replace(signals=observation.signals)
        found, _ = self._acquire(blank, observation)
        return self._challenged(found, blank, observation)

    def init_at(self, qpos: Float[ndarray, "63"]) -> State:
        """Begin from a known pose."""
        qpos = np.asarray(qpos, dtype=float)
        return state_at(qpos, self.settings.history, len(self.subject.trackers))

    def step(self, state: State, frame: TrackerFrame) -> tuple[State, Pose]:
        """The next pose."""
        observation = observe(frame)
        if state.signals is None:
            state = state._replace(signals=observation.signals)
        advance = self._reconsider(state.doubt, self._advance(state, observation), observation)
        return advance.state, self._pose(frame.time, advance)

    def _advance(self, state: State, observation: Observation, *, plainly: bool = False) -> Advance:
        """One frame from one state, by the trackers alone if wanted."""
        query, attention = self._query(state, observation)
        expectation = plain_expectation(state) if plainly else self.prior.expect(query, state)
        solution = self._solve(observation, expectation.belief, state.strain)
        solved = solution.ok
        if not solved:
            solution = self._stay(state, observation, expectation)
        covariance = _inverse(solution.hessian)
        residuals = self._residuals(observation, solution)
        after = remember(state, solution.qpos)._replace(
            covariance=covariance,
            attention=attention,
            drift=self.prior.conclude(expectation, solution.qpos, covariance),
            near=expectation.near,
            strain=self._strain(state.strain, observation, solution),
            lost=state.lost + 1 if residuals.are_far else 0,
        )
        result = Result.SOLVED if solved else Result.FAILED
        if after.lost >= LOST_AFTER:
            after = after._replace(lost=0)
            blank = self._blank_from(after)
            found, sought = self._acquire(blank, observation)
            beside = self._residuals(observation, sought)
            if sought.ok and not beside.are_far:
                after = self._challenged(found, blank, observation)
                solution, residuals, result = sought, beside, Result.REACQUIRED
        return Advance(after, solution, residuals, expectation, result)

    def _reconsider(self, doubt: Doubt, present: Advance, observation: Observation) -> Advance:
        """The frame, or a rival's if that has turned out to be known better."""
        if present.result == Result.REACQUIRED:
            return present
        surprise, bearable = present.expectation.surprise, self.settings.bearable_surprise
        doubt = doubt.after(surprise)
        if doubt.rival is not None:
            other = self._follow(doubt.rival, observation)
            doubt = doubt.beside(surprise, other.state, other.expectation.surprise)
            if doubt.prefers_the_rival and _is_found(other):
                doubt = doubt.settled_on_the_rival
                present = other._replace(result=Result.REACQUIRED)
            elif doubt.is_over or not are_apart(present.solution.qpos, other.solution.qpos):
                doubt = doubt.settled
        after = present.state._replace(doubt=doubt)
        if doubt.wants_a_rival(bearable):
            after = self._challenged(after, self._blank_from(after), observation)
        return present._replace(state=after)

    def _follow(self, rival: State, observation: Observation) -> Advance:
        """A rival a frame later: by the trackers alone while that costs less and is as good.

        Without a past the database takes long to ask, and does not matter yet. Half a signal
        alone would not keep the pose together.
        """
        is_young = not rival.history_valid.all()
        return self._advance(rival, observation, plainly=is_young and rival.signals == "both")

    @cached_property
    def _layout(self) -> FeatureLayout:
        return FeatureLayout.of(self.subject)

    @cached_property
    def _control(self) -> Control:
        settings = self.settings
        lorentzian = np.full((len(self.subject.trackers), 2), settings.lorentzian)
        return Control(settings.sigma_position, settings.sigma_orientation, lorentzian)

    def _problem(self, observation: Observation, belief: Belief, strain: Strain) -> Problem:
        usual, bearable = self._control, self.settings.bearable_strain
        wider = strain.widened(usual.lorentzian, observation, bearable)
        control = usual._replace(lorentzian=wider)
        return Problem(self.chain, observation, control, belief)

    def _strain(self, before: Strain, observation: Observation, solution: Solution) -> Strain:
        errors = solution.position_errors, solution.orientation_errors
        sigmas = self._control.sigma_position, self._control.sigma_orientation
        return before.after(observation, errors, sigmas, self.settings.bearable_strain)

    def _blank(self) -> State:
        return blank_state(self.settings.history, len(self.subject.trackers))

    def _blank_from(self, state: State) -> State:
        """Nothing known but where the body was and what its trackers measure."""
        return self._blank()._replace(qpos=state.qpos, signals=state.signals)

    def _query(self, state: State, observation: Observation) -> tuple[Query, Attention]:
        """What is known before the pose is solved, and whom it was heard from."""
        query, attention = ask(self.chain, self._layout, state, observation)
        if not self.settings.search_by_trackers and np.any(query.history_valid):
            query = query._replace(feature_trust=np.zeros_like(query.feature_trust))
        return query, attention

    @cached_property
    def _solver(self) -> Solver:
        return SOLVERS[self.settings.solver]()

    def _solve(self, observation: Observation, belief: Belief, strain: Strain) -> Solution:
        """The solver's answer."""
        problem = self._problem(observation, belief, strain)
        return self._solver.solve(problem, belief.qpos, self.settings.max_steps)

    def _stay(self, state: State, observation: Observation, expectation: Expectation) -> Solution:
        """The pose of the frame before: what is shown when a frame cannot be solved."""
        qpos = np.array(state.qpos, dtype=float)
        positions, orientations = place_trackers(self.chain, qpos)
        apart = np.where(observation.position_mask[:, None], positions - observation.positions, 0.0)
        covariance = np.asarray(state.covariance)
        known = bool(np.isfinite(covariance).all())
        information = np.linalg.pinv(covariance) if known else np.full_like(covariance, np.nan)
        return Solution(qpos, np.nan, 0, information, apart, np.zeros_like(apart), orientations)

    def _acquire(self, state: State, observation: Observation) -> tuple[State, Solution]:
        """The best pose without a past.

        Where the reference tracker's orientation is not measured, features cannot be told
        before a pose has been found without them.
        """
        if not observation.orientation_mask[self._layout.reference]:
            query = self._unguided_query(state, observation)
            found, _ = self._best_of_starts(self.prior.acquire(query), state, observation)
            query, _ = self._query(found, observation)
            query = query._replace(history_valid=np.zeros_like(query.history_valid))
        else:
            query, _ = self._query(state, observation)
        return self._best_of_starts(self.prior.acquire(query), state, observation)

    def _challenged(self, state: State, blank: State, observation: Observation) -> State:
        """A state beside which a rival is followed, where enough is seen to find one."""
        if self.settings.bearable_surprise == np.inf or not _is_well_seen(observation):
            return state
        plain = self.prior.acquire_plainly()
        if plain is None:
            return state
        rival, _ = self._best_of_starts(plain, blank, observation)
        return state._replace(doubt=state.doubt.challenged_by(rival))

    def _unguided_query(self, state: State, observation: Observation) -> Query:
        """What is asked before it is known which way the reference tracker is turned."""
        angles = self.prior.most_alike(observation)
        if angles is None:
            query, _ = self._query(state, observation)
            return query._replace(feature_trust=np.zeros_like(query.feature_trust))
        placed = align_root(self.chain, np.asarray(state.qpos), angles, observation)
        query, _ = self._query(state._replace(qpos=placed), observation)
        return query

    def _best_of_starts(
        self, acquisition: Acquisition, state: State, observation: Observation
    ) -> tuple[State, Solution]:
        information = np.zeros((TANGENT_SIZE, TANGENT_SIZE))
        information[6:, 6:] = acquisition.information
        mean = np.zeros(TANGENT_SIZE)
        solutions = []
        for angles in acquisition.starts:
            start = align_root(self.chain, np.asarray(state.qpos), angles, observation)
            mean[6:] = acquisition.mean - angles
            belief = Belief(start, mean.copy(), information)
            problem = self._problem(observation, belief, state.strain)
            solutions.append(self._solver.solve(problem, start, self.settings.max_steps_acquire))
        best = min(solutions, key=lambda found: found.energy if found.ok else np.inf)
        found = state_at(best.qpos, self.settings.history, len(self.subject.trackers))
        known = found._replace(covariance=_inverse(best.hessian), signals=state.signals)
        return known, best

    def _residuals(self, observation: Observation, solution: Solution) -> Residuals:
        errors = np.empty((2, len(observation.position_mask)))
        median, measured = _residuals(
            solution.position_errors, solution.orientation_errors, observation, self._control,
            errors,
        )  # fmt: skip
        return Residuals(errors, median, measured)

    def _pose(self, time: float, advance: Advance) -> Pose:
        state, solution, residuals, expectation, result = advance
        return Pose(
            time=time,
            qpos=solution.qpos,
            position_residuals=residuals.errors[0],
            orientation_residuals=residuals.errors[1],
            confidence=expectation.confidence * residuals.measured,
            predicted_sigma=expectation.caution * np.sqrt(np.diagonal(state.covariance)[6:]),
            steps=solution.steps,
            result=result,
        )


def _is_found(rival: Advance) -> bool:
    """Whether a rival meets the trackers."""
    return rival.result != Result.FAILED and not rival.residuals.are_far


def _is_well_seen(observation: Observation) -> bool:
    """Whether at least half of the trackers say something."""
    said = observation.position_mask | observation.orientation_mask
    return 2 * int(said.sum()) >= len(said)


@njit(cache=True)
@no_type_check
def _residuals(positions, orientations, observation, control, errors):
    """Write the lengths of errors; returns the rest of `Residuals`."""
    errors[:] = np.nan
    distances, angles = errors
    squares, count = np.empty(2 * len(distances)), 0
    for j in range(len(distances)):
        if observation.position_mask[j]:
            distances[j] = np.sqrt(np.sum(np.square(positions[j])))
            squares[count] = (distances[j] / control.sigma_position) ** 2
            count += 1
        if observation.orientation_mask[j]:
            angles[j] = np.sqrt(np.sum(np.square(orientations[j])))
            squares[count] = (angles[j] / control.sigma_orientation) ** 2
            count += 1
    median = np.sort(squares[:count])[count // 2] if count else 0.0
    return median, count / len(squares)


@njit(cache=True)
@no_type_check
def _inverse(information):
    """The covariance; of a belief that is not finite, one that knows little.

    Or no later frame could be solved either.
    """
    grown = information.copy()
    for i in range(len(grown)):
        grown[i, i] += _LEAST_INFORMATION
    covariance = positive_inverse(grown)
    if not np.isfinite(np.sum(covariance)):
        return np.eye(len(information))
    return covariance
