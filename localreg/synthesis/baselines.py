"""The published methods as priors over shared parts, and the one without a database.

[P] "Realtime motion control with local regression models and six inertial sensors": the
input-output projection, for every joint angle on its own or for all at once. [CH05] Chai and
Hodgins 2005, "Performance animation from low-dimensional control signals": local principal
component analysis of poses. [L11] Liu et al. 2011, "Realtime human motion control with a
small number of inertial sensors": local principal component regression. All get the
trackers, the noise model, the search, the solver and the starts of every other method; what
is theirs is below.
"""

from collections.abc import Callable
from typing import Final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from localreg import jax_numerics as jax_numerics
from localreg.body.kinematics import integrate
from localreg.body.skeleton import DOF_COUNT
from localreg.synthesis.easy_poses import EASE
from localreg.synthesis.energy import Gaussian, LimitTerm, PriorTerm, RootTerm
from localreg.synthesis.examples import Examples
from localreg.synthesis.prior import STARTS
from localreg.synthesis.regression import joint_projection, per_dof_projection
from localreg.synthesis.state import State
from localreg.synthesis.term_prior import Candidates, Prediction, Question, TermPrior

_NULL = 1e-13  # eigenvalues below this share of the largest are rounding errors ...
_STILL = 1e-20  # ... and so are all below this [rad^2]


def principal_subspace(
    poses: Float[Array, "K d"], rank: int, floor: Float[Array, ""]
) -> tuple[Float[Array, " d"], Float[Array, "d d"]]:
    """Mean and covariance of the Gaussian whose logarithm is the prior energy of [CH05].

    With U the leading principal directions of the poses and L their variances the energy of
    a pose q = mean + U w + rest is w^T L^-1 w + |rest|^2 / floor^2: coefficients weighted by
    their variances, plus the distance from the subspace. That is one Gaussian with
    covariance U L U^T + floor^2 (I - U U^T), known as probabilistic principal component
    analysis (Tipping and Bishop 1999). No variance counts as less than floor^2, or examples
    that nearly agree would outvote the trackers.
    """
    mean = jnp.mean(poses, axis=0)
    rows = poses - mean
    values, vectors = jnp.linalg.eigh(rows.T @ rows / len(poses))
    values, vectors = values[::-1][:rank], vectors[:, ::-1][:, :rank]
    beyond = jnp.maximum(values - floor**2, 0.0)
    identity = jnp.eye(len(mean), dtype=poses.dtype)
    return mean, (vectors * beyond) @ vectors.T + floor**2 * identity


def principal_component_regression(
    X: Float[Array, "K n"], Y: Float[Array, "K d"], x: Float[Array, " n"], rank: int
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    """The regression of [L11]: PCA of the inputs alone, then least squares on the scores.

    With the left singular vectors V of the centered X the fitted outputs are V V^T Y; the
    scores of x are V^T X x / g over the eigenvalues g of X X^T, so nothing n x n is formed.

    Returns:
        The predictions, and the standard deviations of the K training residuals.
    """
    center, mean = jnp.mean(X, axis=0), jnp.mean(Y, axis=0)
    X, Y = X - center, Y - mean
    g, V = jnp.linalg.eigh(X @ X.T)
    g, V = g[::-1][:rank], V[:, ::-1][:, :rank]
    # Directions without variance are neither fitted nor asked.
    there = g > jnp.maximum(_NULL * g[0], _STILL)
    V = jnp.where(there, V, 0.0)
    slopes = V.T @ Y
    scores = (V.T @ (X @ (x - center))) / jnp.where(there, g, 1.0)
    return mean + scores @ slopes, jnp.sqrt(jnp.mean((Y - V @ slopes) ** 2, axis=0))


class PastRegression(TermPrior):
    """A published regression on past poses alone: one of the projections above.

    Attributes:
        project: the regression: inputs, outputs, present input and rank to prediction and
            standard deviations of the training residuals.
        rank: directions kept.
        floor: least standard deviation of a predicted joint angle [rad].
        root_position: deviation of the root from constant velocity [m].
        root_orientation: the same [rad].
    """

    project: Callable[[Array, Array, Array, int], tuple[Array, Array]] = eqx.field(static=True)
    rank: int = eqx.field(static=True)
    floor: Float[Array, ""]
    root_position: Float[Array, ""]
    root_orientation: Float[Array, ""]

    def predict(self, examples: Examples, question: Question, state: State) -> Prediction:
        """The regression's prediction with the residual of its training examples."""
        valid = jnp.repeat(question.history_valid, DOF_COUNT)
        angles = jnp.asarray(examples.angles)
        X = angles[:, 1:].reshape(len(angles), -1) * valid
        x = question.history.ravel() * valid
        mean, sigma = self.project(X, angles[:, 0], x, self.rank)
        qpos = jnp.concatenate([_coasting_root(state), mean])
        terms = (
            PriorTerm(Gaussian.from_deviations(mean, jnp.maximum(sigma, self.floor))),
            RootTerm(qpos, self.root_position, self.root_orientation),
        )
        return Prediction(qpos, terms)

    def acquire(self, examples: Examples, question: Question) -> Candidates:
        """Mean and deviation of the examples found by the trackers."""
        return _pose_statistics(examples, self.floor)


PAST_REGRESSIONS: Final = {
    "paper": per_dof_projection,
    "joint": joint_projection,
    "lpcr": principal_component_regression,
}
"""The published regressions by the name of their prior."""


class InverseKinematics(TermPrior):
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

    def predict(self, examples: Examples, question: Question, state: State) -> Prediction:
        """Where the body was, moving on with the root."""
        angles = jnp.asarray(state.qpos[7:])
        qpos = jnp.concatenate([_coasting_root(state), angles])
        terms = (
            PriorTerm(Gaussian.from_deviations(angles, jnp.full(DOF_COUNT, self.previous_pose))),
            LimitTerm(self.low, self.high, self.limit_softness),
            RootTerm(qpos, self.root_position, self.root_orientation),
        )
        return Prediction(qpos, terms)

    def acquire(self, examples: Examples, question: Question) -> Candidates:
        """A wide pull to an easy standing pose, from several starts."""
        wide = jnp.full(DOF_COUNT, EASE)
        return Candidates(self.starts, Gaussian.from_deviations(self.starts[0], wide))


class LocalSubspace(TermPrior):
    """LPCA [CH05]: a local subspace of poses, and smoothness.

    Attributes:
        rank: principal directions kept.
        floor: least deviation in the subspace, and deviation from it [rad].
        smoothness: deviation of q_t - 2 q_(t-1) + q_(t-2) [rad].
        root_position: deviation of the root from constant velocity [m].
        root_orientation: the same [rad].
    """

    rank: int = eqx.field(static=True)
    floor: Float[Array, ""]
    smoothness: Float[Array, ""]
    root_position: Float[Array, ""]
    root_orientation: Float[Array, ""]

    def predict(self, examples: Examples, question: Question, state: State) -> Prediction:
        """The subspace of the neighbours, pulled towards where the last two poses lead."""
        poses = jnp.asarray(examples.angles[:, 0])
        mean, covariance = principal_subspace(poses, self.rank, self.floor)
        now, before = question.history[0], question.history[1]
        # With one pose known there is no velocity yet, with none nothing to be smooth with.
        coasting = jnp.where(question.history_valid[1], 2.0 * now - before, now)
        slack = jnp.where(question.history_valid[0], self.smoothness, 1e3)
        qpos = jnp.concatenate([_coasting_root(state), mean])
        terms = (
            PriorTerm(Gaussian.from_covariance(mean, covariance)),
            PriorTerm(Gaussian.from_deviations(coasting, jnp.full(DOF_COUNT, slack))),
            RootTerm(qpos, self.root_position, self.root_orientation),
        )
        return Prediction(qpos, terms)

    def acquire(self, examples: Examples, question: Question) -> Candidates:
        """The subspace of the examples found by the trackers."""
        return _pose_statistics(examples, self.floor)


def _pose_statistics(examples: Examples, floor: Float[Array, ""]) -> Candidates:
    """Mean and deviation of the examples; starts are the mean and, near to far, examples."""
    poses = examples.angles[:, 0]
    mean = jnp.mean(poses, axis=0)
    sigma = jnp.maximum(jnp.std(poses, axis=0), floor)
    stride = max(1, len(poses) // (STARTS - 1))
    starts = jnp.concatenate([mean[None], poses[::stride][: STARTS - 1]])
    return Candidates(starts, Gaussian.from_deviations(mean, sigma))


def _coasting_root(state: State) -> Float[Array, " 7"]:
    """The root moved on with its last velocity."""
    step = jnp.concatenate([jnp.asarray(state.velocity), jnp.zeros(DOF_COUNT)])
    return integrate(jnp.asarray(state.qpos), step)[:7]
