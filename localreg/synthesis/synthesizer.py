"""From tracker frames to poses, one at a time: the same `step` live and offline.

    frame -> query -> neighbours -> prior -> energy -> solver -> pose

The search runs on the host over memory-mapped poses; all the rest of a frame is one
compiled function of fixed shapes, traced once for all subjects and sessions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Final, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy import ndarray

from localreg.body import rotations
from localreg.body.kinematics import Kinematics, difference
from localreg.body.subject import Subject
from localreg.database.features import FeatureLayout, quaternions_to_matrices
from localreg.database.neighbours import Query
from localreg.numerics import host_arrays
from localreg.synthesis.alignment import align_root, snap_to_reference
from localreg.synthesis.energy import (
    Observation,
    PriorTerm,
    Term,
    TrackerTerm,
    energy,
    linearize,
)
from localreg.synthesis.estimator import Estimator, Pose, Result
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.prior import Examples, Prior, Question
from localreg.synthesis.settings import Settings
from localreg.synthesis.solver import LevenbergMarquardt, Solution
from localreg.synthesis.state import State, blank_state, remember, state_at
from sensors.pose import TrackerFrame

LOST_AFTER: Final = 4
"""Frames in a row far from most trackers after which the pose is sought anew."""

_ROOM: Final = 1000.0
"""No tracker is farther than this from the origin, or its position is nonsense [m]."""

_FAR: Final = 40.0
"""Median squared distance to the trackers, in units of their sigmas, that counts as far:
3 cm or 6 degrees where 0.5 cm and 1 degree are expected."""


class _Solved(NamedTuple):
    """What one compiled call gives back."""

    state: State
    position_residuals: Float[Array, " J"]
    orientation_residuals: Float[Array, " J"]
    sigma: Float[Array, "56"]
    far: Bool[Array, ""]
    energy: Float[Array, ""]
    steps: Array
    ok: Bool[Array, ""]


@dataclass(frozen=True, eq=False)
class Synthesizer(Estimator[State]):
    """An estimator made of a body, a source of examples and a prior.

    Attributes:
        subject: whose body is moved.
        rate: frames a second that `step` expects [Hz].
        settings: the numbers of the method.
        kinematics: the subject's body.
        prior: the method's belief.
        examples: where neighbours come from; None for methods without a database.
    """

    subject: Subject
    rate: float
    settings: Settings
    kinematics: Kinematics
    prior: Prior
    examples: ExampleSource | None
    rebuild: Callable[[Bool[ndarray, " poses"]], "Synthesizer"] | None = None

    def leave_out(self, allowed: Bool[ndarray, " poses"]) -> "Synthesizer":
        """The same estimator seeing only the allowed poses of its database."""
        return self if self.rebuild is None else self.rebuild(allowed)

    def init(self, frame: TrackerFrame) -> State:
        """Find the pose from one frame alone, from several starts."""
        return self._acquire(blank_state(self.settings.history), _observe(frame)).state

    def init_at(self, qpos: Float[ndarray, "63"]) -> State:
        """Begin from a known pose."""
        state = state_at(qpos, self.settings.history)
        trackers = self.kinematics.tracker_poses(jnp.asarray(qpos))
        reference = rotations.to_matrix(trackers.quaternions[self._layout.reference])
        return state._replace(reference=np.asarray(reference))

    def step(self, state: State, frame: TrackerFrame) -> tuple[State, Pose]:
        """The next pose."""
        observation = _observe(frame)
        solved = _step(
            self.settings, self._layout.reference, self.prior, self.kinematics,
            *self._ask(state, observation), _arrays(state), observation,
        )  # fmt: skip
        lost = state.lost + 1 if bool(solved.far) else 0
        result = Result.SOLVED if bool(solved.ok) else Result.FAILED
        if lost >= LOST_AFTER:
            lost = 0
            found = self._acquire(
                blank_state(self.settings.history)._replace(qpos=np.asarray(solved.state.qpos)),
                observation,
            )
            if bool(found.ok) and not bool(found.far):
                solved, result = found, Result.REACQUIRED
        state = solved.state._replace(lost=lost)
        return state, self._pose(frame.time, solved, result)

    @cached_property
    def _layout(self) -> FeatureLayout:
        return FeatureLayout.of(self.subject)

    def _acquire(self, state: State, observation: Observation) -> _Solved:
        return _acquire(
            self.settings, self._layout.reference, self.prior, self.kinematics,
            *self._ask(state, observation), _arrays(state), observation,
        )  # fmt: skip

    def _ask(self, state: State, observation: Observation) -> tuple[Examples, Question]:
        """Neighbours for what is known so far; empty for methods without a database."""
        layout = self._layout
        matrices = quaternions_to_matrices(np.asarray(observation.quaternions))
        if not observation.orientation_mask[layout.reference]:
            matrices[layout.reference] = np.asarray(state.reference)
        valid = layout.mask(
            np.asarray(observation.position_mask), np.asarray(observation.orientation_mask)
        )
        if not self.settings.search_by_trackers and np.any(state.history_valid):
            valid = np.zeros_like(valid)
        query = Query(
            history=np.asarray(state.history),
            history_valid=np.asarray(state.history_valid),
            features=layout.extract(np.asarray(observation.positions), matrices),
            feature_valid=valid,
        )
        if self.examples is None:
            return NO_EXAMPLES, Question(*host_arrays(*query))
        return self.examples.find(query), Question(*host_arrays(*query))

    def _pose(self, time: float, solved: _Solved, result: Result) -> Pose:
        confidence = float("nan")
        if self.examples is not None:
            confidence = 1.0 / max(1.0, float(solved.state.surprise))
        return Pose(
            time=time,
            qpos=np.asarray(solved.state.qpos),
            position_residuals=np.asarray(solved.position_residuals),
            orientation_residuals=np.asarray(solved.orientation_residuals),
            confidence=confidence,
            predicted_sigma=np.asarray(solved.sigma),
            steps=int(solved.steps),
            result=result,
        )


NO_EXAMPLES: Final = Examples(
    *host_arrays(np.zeros((0, 1, 56)), np.zeros((0, 2, 7)), np.zeros((0, 0)), np.zeros(0))
)
"""What methods without a database are given."""


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


def _arrays(state: State) -> State:
    """The state with its Python numbers made harmless to tracing."""
    return state._replace(lost=0)


@partial(jax.jit, static_argnums=(0, 1))
def _step(
    settings: Settings,
    reference: int,
    prior: Prior,
    kinematics: Kinematics,
    examples: Examples,
    question: Question,
    state: State,
    observation: Observation,
) -> _Solved:
    trackers = _tracker_term(settings, kinematics, observation)
    examples = jax.tree.map(lambda a: jnp.asarray(a, dtype=float), examples)
    prediction = prior.predict(examples, question, state, trackers)
    terms = (trackers, *prediction.terms)
    # Constant velocity and the reference tracker disagree when one of them is wrong.
    snapped = snap_to_reference(kinematics, prediction.qpos, observation, reference)
    better = energy(terms, snapped) < energy(terms, prediction.qpos)
    start = jnp.where(better, snapped, prediction.qpos)
    start = jnp.where(jnp.all(jnp.isfinite(start)), start, jnp.asarray(state.qpos))
    solution = LevenbergMarquardt().solve(terms, start, settings.max_steps)
    velocity = difference(jnp.asarray(state.qpos), solution.qpos)[:6]
    history, valid = remember(
        jnp.asarray(state.history), jnp.asarray(state.history_valid), solution.qpos
    )
    state = state._replace(
        velocity=velocity, history=history, history_valid=valid, surprise=prediction.surprise
    )
    return _solved(state, trackers, terms, solution, reference)


@partial(jax.jit, static_argnums=(0, 1))
def _acquire(
    settings: Settings,
    reference: int,
    prior: Prior,
    kinematics: Kinematics,
    examples: Examples,
    question: Question,
    state: State,
    observation: Observation,
) -> _Solved:
    trackers = _tracker_term(settings, kinematics, observation)
    examples = jax.tree.map(lambda a: jnp.asarray(a, dtype=float), examples)
    starts, gaussian = prior.acquire(examples, question)
    terms = (trackers, PriorTerm(gaussian))

    def attempt(angles: Float[Array, " 56"]) -> Solution:
        start = align_root(kinematics, jnp.asarray(state.qpos), angles, observation)
        return LevenbergMarquardt().solve(terms, start, settings.max_steps_acquire)

    attempts = jax.lax.map(attempt, starts)
    best = jnp.argmin(jnp.where(attempts.ok, attempts.energy, jnp.inf))
    solution = jax.tree.map(lambda leaf: leaf[best], attempts)
    history = jnp.broadcast_to(solution.qpos[7:], state.history.shape)
    valid = jnp.zeros_like(state.history_valid).at[0].set(True)
    state = state._replace(
        velocity=jnp.zeros(6), history=history, history_valid=valid, surprise=jnp.ones(())
    )
    return _solved(state, trackers, terms, solution, reference)


def _tracker_term(
    settings: Settings, kinematics: Kinematics, observation: Observation
) -> TrackerTerm:
    return TrackerTerm(
        kinematics,
        jax.tree.map(jnp.asarray, observation),
        jnp.asarray(settings.sigma_position),
        jnp.asarray(settings.sigma_orientation),
        jnp.asarray(settings.lorentzian),
    )


def _solved(
    state: State,
    trackers: TrackerTerm,
    terms: tuple[Term, ...],
    solution: Solution,
    reference: int,
) -> _Solved:
    """Belief and report at the solution."""
    jacobian = linearize(terms, solution.qpos).jacobian
    # A whisper of information keeps the inverse finite where nothing is observed.
    information = jacobian.T @ jacobian + 1e-6 * jnp.eye(jacobian.shape[1])
    covariance = jnp.linalg.inv(information)
    position, orientation = trackers.errors(solution.qpos)
    observation = trackers.observation
    distances = jnp.where(observation.position_mask, jnp.linalg.norm(position, axis=1), jnp.nan)
    angles = jnp.where(observation.orientation_mask, jnp.linalg.norm(orientation, axis=1), jnp.nan)
    squared = jnp.concatenate(
        [distances / trackers.sigma_position, angles / trackers.sigma_orientation]
    )
    far = jnp.nan_to_num(jnp.nanmedian(squared**2)) > _FAR
    poses = trackers.kinematics.tracker_poses(solution.qpos)
    # A belief that is not finite is forgotten, or no later frame could be solved either.
    covariance = jnp.where(jnp.all(jnp.isfinite(covariance)), covariance, jnp.eye(len(covariance)))
    surprise = jnp.asarray(state.surprise)
    state = state._replace(
        qpos=solution.qpos,
        covariance=0.5 * (covariance + covariance.T),
        surprise=jnp.where(jnp.isfinite(surprise), surprise, 1.0),
        reference=rotations.to_matrix(poses.quaternions[reference]),
    )
    sigma = jnp.sqrt(jnp.diagonal(covariance)[6:])
    return _Solved(
        state, distances, angles, sigma, far, solution.energy, solution.steps, solution.ok
    )
