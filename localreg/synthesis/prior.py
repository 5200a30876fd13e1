"""Priors: what each method believes of the present pose before it looks closely.

A prior turns examples, query and belief into terms of the energy; the solver never
knows which prior it got. An example is a database pose (the target) with its m
predecessors and what the trackers would have said.
"""

from abc import abstractmethod
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from localreg.body import rotations
from localreg.body.kinematics import integrate
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.synthesis.energy import (
    Gaussian,
    LimitTerm,
    PriorTerm,
    RootTerm,
    StepTerm,
    Term,
    TrackerTerm,
)
from localreg.synthesis.regression import (
    Normal,
    joint_projection,
    kernel_weights,
    per_dof_projection,
    weighted_ridge,
    within_reach,
)
from localreg.synthesis.state import State


class Examples(NamedTuple):
    """K neighbours, nearest first.

    Attributes:
        angles: joint angles of the pose and its m predecessors, newest first [rad].
        roots: root position and quaternion of the pose and of its predecessor.
        features: what the trackers would have said.
        squared_distances: to the query; infinite for rows that only fill the shape.
    """

    angles: Float[Array, "K m_and_1 56"]
    roots: Float[Array, "K 2 7"]
    features: Float[Array, "K f"]
    squared_distances: Float[Array, " K"]


class Question(NamedTuple):
    """The JAX side of `localreg.database.neighbours.Query`: same fields, same shapes."""

    history: Float[Array, "m 56"]
    history_valid: Bool[Array, " m"]
    features: Float[Array, " f"]
    feature_valid: Bool[Array, " f"]


class Prediction(NamedTuple):
    """What a prior says of the present frame.

    Attributes:
        qpos: the expected pose, from which the solver starts.
        terms: the prior's share of the energy.
        surprise: how far beyond prediction the trackers are (see `State`).
    """

    qpos: Float[Array, "63"]
    terms: tuple[Term, ...]
    surprise: Float[Array, ""]


class Acquisition(NamedTuple):
    """Where to look for a pose from nothing.

    Attributes:
        starts: joint angles to start from, S of them [rad].
        gaussian: the prior over joint angles without a past.
    """

    starts: Float[Array, "S 56"]
    gaussian: Gaussian


class Prior(eqx.Module):
    """One method's belief."""

    @abstractmethod
    def predict(
        self, examples: Examples, question: Question, state: State, trackers: TrackerTerm
    ) -> Prediction:
        """Predict the present frame from the past."""

    @abstractmethod
    def acquire(self, examples: Examples, question: Question) -> Acquisition:
        """Say where to look when there is no past."""


class LocalRegression(Prior):
    """The default: two local ridge regressions fused with what was believed before.

    The first predicts the pose from past joint angles and present tracker features, the
    second the step since the last frame (root included) from the past alone. Errors of
    the first last for many frames, so only a small share of its information counts in
    each; the second carries the belief of the last frame over, as in a Kalman filter, so
    that tracker noise averages out without delay where the database knows the motion.
    When trackers deviate from prediction more than predicted, both are believed less at
    once.

    Attributes:
        history_noise: deviation of reconstructed joint angles, pose regression [rad].
        feature_noise: deviation of each feature column.
        basis: principal directions of the pose regression's inputs, (n, r).
        ridge: multiple of the noise-derived ridge.
        floor: least deviation of a joint angle [rad].
        pose_information: share of the pose regression that is new in each frame.
        step_noise: deviation of joint angles, step regression [rad].
        step_basis: principal directions of the step regression's inputs, (m 56, r).
        step_ridge: multiple of the noise-derived ridge.
        step_spread: factor on the predicted deviation of the step.
        step_floor: least deviation of each tangent coordinate's step.
        surprise_memory: share of a surprise still believed a frame later.
    """

    history_noise: Float[Array, ""]
    feature_noise: Float[Array, " f"]
    basis: Float[Array, "n r"]
    ridge: Float[Array, ""]
    floor: Float[Array, ""]
    pose_information: Float[Array, ""]
    step_noise: Float[Array, ""]
    step_basis: Float[Array, "p s"]
    step_ridge: Float[Array, ""]
    step_spread: Float[Array, ""]
    step_floor: Float[Array, " 62"]
    surprise_memory: Float[Array, ""]

    def predict(
        self, examples: Examples, question: Question, state: State, trackers: TrackerTerm
    ) -> Prediction:
        """Pose and step regression, both believed less when surprised."""
        weights = kernel_weights(examples.squared_distances)
        step, step_covariance = self._step(examples, question, weights, state)
        qpos = integrate(jnp.asarray(state.qpos), step)
        covariance = jnp.asarray(state.covariance) + step_covariance
        surprise = jnp.maximum(
            self.surprise_memory * state.surprise, trackers.surprise(qpos, covariance)
        )
        doubt = jnp.clip(surprise, 1.0, 1e4)
        pose = self._pose(examples, question, weights)
        terms = (
            StepTerm(qpos, Gaussian.from_covariance(jnp.zeros(TANGENT_SIZE), doubt * covariance)),
            PriorTerm(Gaussian.from_covariance(pose.mean, pose.covariance / self.pose_information)),
        )
        return Prediction(qpos, terms, surprise)

    def acquire(self, examples: Examples, question: Question) -> Acquisition:
        """The regression's answer, and some of the examples themselves."""
        pose = self._pose(examples, question, kernel_weights(examples.squared_distances))
        return Acquisition(_spread(pose.mean, examples), Gaussian.from_covariance(*pose))

    def _pose(self, examples: Examples, question: Question, weights: Array) -> Normal:
        known = jnp.concatenate(
            [
                jnp.repeat(question.history_valid, DOF_COUNT) / self.history_noise,
                question.feature_valid / self.feature_noise,
            ]
        )

        def inputs(past: Array, features: Array) -> Array:
            flat = past.reshape(*past.shape[:-2], -1)
            return (jnp.concatenate([flat, features], axis=-1) * known) @ self.basis

        X = inputs(examples.angles[:, 1:], examples.features)
        x = within_reach(X, weights, inputs(question.history, question.features))
        mean, covariance = weighted_ridge(X, examples.angles[:, 0], weights, x, self.ridge)
        return Normal(mean, covariance + self.floor**2 * jnp.eye(DOF_COUNT))

    def _step(
        self, examples: Examples, question: Question, weights: Array, state: State
    ) -> tuple[Float[Array, " 62"], Float[Array, "62 62"]]:
        known = jnp.repeat(question.history_valid, DOF_COUNT) / self.step_noise
        past = examples.angles[:, 1:].reshape(len(weights), -1)
        X, x = (
            (past * known) @ self.step_basis,
            (question.history.ravel() * known) @ self.step_basis,
        )
        x = within_reach(X, weights, x)
        mean, covariance = weighted_ridge(X, _steps(examples), weights, x, self.step_ridge)
        # Root translation was regressed in the root's own axes; the tangent has the world's.
        turn = rotations.to_matrix(jnp.asarray(state.qpos[3:7]))
        mean = mean.at[:3].set(turn @ mean[:3])
        frame = jnp.eye(TANGENT_SIZE).at[:3, :3].set(turn)
        covariance = frame @ covariance @ frame.T * self.step_spread**2
        return mean, covariance + jnp.diag(self.step_floor**2)


class PublishedRegression(Prior):
    """The published prior: input-output PCA on past poses alone ([P]).

    Attributes:
        rank: r, the directions kept.
        joint: all outputs in one decomposition, instead of each on its own.
        floor: least deviation of a joint angle [rad].
        root_position: deviation of the root from constant velocity [m].
        root_orientation: the same [rad].
    """

    rank: int = eqx.field(static=True)
    joint: bool = eqx.field(static=True)
    floor: Float[Array, ""]
    root_position: Float[Array, ""]
    root_orientation: Float[Array, ""]

    def predict(
        self, examples: Examples, question: Question, state: State, trackers: TrackerTerm
    ) -> Prediction:
        """The regression's prediction with the residual of its training examples."""
        valid = jnp.repeat(question.history_valid, DOF_COUNT)
        X = examples.angles[:, 1:].reshape(len(examples.angles), -1) * valid
        project = joint_projection if self.joint else per_dof_projection
        mean, sigma = project(X, examples.angles[:, 0], question.history.ravel() * valid, self.rank)
        qpos = jnp.concatenate([_coasting_root(state), mean])
        terms = (
            PriorTerm(Gaussian.from_deviations(mean, jnp.maximum(sigma, self.floor))),
            RootTerm(qpos, self.root_position, self.root_orientation),
        )
        return Prediction(qpos, terms, jnp.ones(()))

    def acquire(self, examples: Examples, question: Question) -> Acquisition:
        """Mean and deviation of the examples found by the trackers."""
        poses = examples.angles[:, 0]
        mean = jnp.mean(poses, axis=0)
        sigma = jnp.maximum(jnp.std(poses, axis=0), self.floor)
        return Acquisition(_spread(mean, examples), Gaussian.from_deviations(mean, sigma))


class InverseKinematics(Prior):
    """No database: a pull to the previous pose, joint limits from anatomy.

    Attributes:
        previous_pose: deviation from the previous pose [rad].
        starts: joint angles to start from where there is no past; the first is an easy
            standing pose [rad].
        low: lower ends of the joint ranges [rad].
        high: upper ends [rad].
        limit_softness: how far outside is one standard deviation [rad].
        root_position: deviation of the root from constant velocity [m].
        root_orientation: the same [rad].
    """

    previous_pose: Float[Array, ""]
    starts: Float[Array, "S 56"]
    low: Float[Array, " 56"]
    high: Float[Array, " 56"]
    limit_softness: Float[Array, ""]
    root_position: Float[Array, ""]
    root_orientation: Float[Array, ""]

    def predict(
        self, examples: Examples, question: Question, state: State, trackers: TrackerTerm
    ) -> Prediction:
        """Where the body was, moving on with the root."""
        angles = jnp.asarray(state.qpos[7:])
        qpos = jnp.concatenate([_coasting_root(state), angles])
        terms = (
            PriorTerm(Gaussian.from_deviations(angles, jnp.full(DOF_COUNT, self.previous_pose))),
            LimitTerm(self.low, self.high, self.limit_softness),
            RootTerm(qpos, self.root_position, self.root_orientation),
        )
        return Prediction(qpos, terms, jnp.ones(()))

    def acquire(self, examples: Examples, question: Question) -> Acquisition:
        """A wide pull to an easy standing pose, from several starts."""
        wide = jnp.full(DOF_COUNT, jnp.radians(25.0))
        return Acquisition(self.starts, Gaussian.from_deviations(self.starts[0], wide))


_STARTS = 8


def _spread(mean: Float[Array, " 56"], examples: Examples) -> Float[Array, "S 56"]:
    """A prediction and, from near to far, some examples."""
    stride = max(1, len(examples.angles) // (_STARTS - 1))
    return jnp.concatenate([mean[None], examples.angles[::stride, 0][: _STARTS - 1]])


def _steps(examples: Examples) -> Float[Array, "K 62"]:
    """The tangent step into each example; root translation in the root's own axes."""
    now, before = examples.roots[:, 0], examples.roots[:, 1]
    back = rotations.conjugate(before[:, 3:])
    move = rotations.rotate(back, now[:, :3] - before[:, :3])
    turn = rotations.log(rotations.multiply(back, now[:, 3:]))
    bend = examples.angles[:, 0] - examples.angles[:, 1]
    # Stored angles may jump by a whole turn from one frame to the next.
    bend = bend - 2.0 * jnp.pi * jnp.round(bend / (2.0 * jnp.pi))
    return jnp.concatenate([move, turn, bend], axis=1)


def _coasting_root(state: State) -> Float[Array, " 7"]:
    """The root moved on with its last velocity."""
    turn = rotations.multiply(
        jnp.asarray(state.qpos[3:7]), rotations.exp(jnp.asarray(state.velocity[3:]))
    )
    return jnp.concatenate([state.qpos[:3] + state.velocity[:3], turn])
