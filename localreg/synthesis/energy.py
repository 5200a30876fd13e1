"""The energy of a pose: small least-squares terms, each with its derivative beside it.

    E(q) = sum over trackers of rho(position error / sigma_p) + rho(rotation error / sigma_r)
         + prior over joint angles + weak root term (+ soft joint limits)

Each term gives a residual r with |r|^2 / 2 its share of the energy, and the residual's
derivative by the pose's 62 tangent coordinates (see `localreg.body.kinematics`).
"""

from abc import abstractmethod
from typing import NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp
import jax.scipy.linalg as jsl
from jaxtyping import Array, Float

from localreg.body import rotations
from localreg.body.kinematics import Kinematics, difference
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.synthesis.observation import Observation


class Linearized(NamedTuple):
    """A term's residual and its derivative at one pose."""

    residual: Float[Array, " r"]
    jacobian: Float[Array, "r 62"]


class Term(eqx.Module):
    """One addend of the energy."""

    @abstractmethod
    def linearize(self, qpos: Float[Array, " 63"]) -> Linearized:
        """The residual and its derivative at a pose."""


def robust_scale(t: Float[Array, "*b"]) -> tuple[Float[Array, "*b"], Float[Array, "*b"]]:
    """s(t) = sqrt(log1p(t) / t) and its derivative, smooth at zero.

    With t = |e|^2 / (2 c) the residual f = s(t) e has |f|^2 / 2 = c log1p(t): the
    Lorentzian, as least squares.
    """
    small = t < 1e-3
    safe = jnp.where(small, 1.0, t)
    ratio = jnp.log1p(safe) / safe
    scale = jnp.sqrt(ratio)
    slope = (1.0 / (1.0 + safe) - ratio) / (2.0 * safe * scale)
    series = 1.0 + t * (-1.0 / 4.0 + t * (13.0 / 96.0 - t * 35.0 / 384.0))
    series_slope = -1.0 / 4.0 + t * (13.0 / 48.0 - t * 35.0 / 128.0)
    return jnp.where(small, series, scale), jnp.where(small, series_slope, slope)


def robustify(
    error: Float[Array, "J 3"], jacobian: Float[Array, "J 3 62"], c: Float[Array, "#J"]
) -> tuple[Float[Array, "J 3"], Float[Array, "J 3 62"]]:
    """The Lorentzian residual of whitened errors, and its derivative."""
    scale, slope = robust_scale(jnp.sum(error * error, axis=-1) / (2.0 * c))
    along = jnp.sum(error[:, :, None] * jacobian, axis=1)
    bend = (slope / c)[:, None, None] * error[:, :, None] * along[:, None, :]
    return scale[:, None] * error, scale[:, None, None] * jacobian + bend


class TrackerTerm(Term):
    """The control energy: predicted against measured tracker poses.

    Attributes:
        kinematics: the subject's body with its trackers.
        observation: what the trackers say.
        sigma_position: expected position error [m].
        sigma_orientation: expected orientation error [rad].
        lorentzian: c of the Lorentzian for position and orientation of each tracker;
            infinity makes it plain squares.
    """

    kinematics: Kinematics
    observation: Observation
    sigma_position: Float[Array, ""]
    sigma_orientation: Float[Array, ""]
    lorentzian: Float[Array, "J 2"]

    def errors(self, qpos: Float[Array, " 63"]) -> tuple[Float[Array, "J 3"], Float[Array, "J 3"]]:
        """Position errors [m] and orientation errors as world rotation vectors [rad]."""
        return self._errors_and_jacobian(qpos)[0]

    def linearize(self, qpos: Float[Array, " 63"]) -> Linearized:
        """Robust whitened errors: positions of all trackers, then orientations."""
        (position, orientation), jacobian = self._errors_and_jacobian(qpos)
        measured = self.observation
        at, turned = self.lorentzian.T
        kinds = (
            (position, jacobian[:, :3], self.sigma_position, at, measured.position_mask),
            (
                orientation,
                jacobian[:, 3:],
                self.sigma_orientation,
                turned,
                measured.orientation_mask,
            ),
        )
        parts = []
        for error, block, sigma, c, mask in kinds:
            f, J = robustify(error / sigma, block / sigma, c)
            parts.append((jnp.where(mask[:, None], f, 0.0), jnp.where(mask[:, None, None], J, 0.0)))
        residual = jnp.concatenate([f.reshape(-1) for f, _ in parts])
        return Linearized(
            residual, jnp.concatenate([J.reshape(-1, TANGENT_SIZE) for _, J in parts])
        )

    def _errors_and_jacobian(
        self, qpos: Float[Array, " 63"]
    ) -> tuple[tuple[Float[Array, "J 3"], Float[Array, "J 3"]], Float[Array, "J 6 62"]]:
        poses, jacobian = self.kinematics.jacobian(qpos, self.kinematics.trackers)
        position = poses.positions - self.observation.positions
        # log(R_predicted R_measured^T): the world rotation still to be undone.
        turn = rotations.multiply(
            poses.quaternions, rotations.conjugate(jnp.asarray(self.observation.quaternions))
        )
        orientation = rotations.log(turn)
        bend = rotations.inverse_left_jacobian(orientation)
        angular = jnp.einsum("jab,jbn->jan", bend, jacobian[:, 3:])
        return (position, orientation), jnp.concatenate([jacobian[:, :3], angular], axis=1)


class Gaussian(eqx.Module):
    """A Gaussian in the form that least squares wants.

    Attributes:
        mean: of n coordinates, normally the 56 joint angles [rad].
        whitening: W with W^T W the inverse covariance.
    """

    mean: Float[Array, " n"]
    whitening: Float[Array, "n n"]

    @classmethod
    def from_deviations(cls, mean: Float[Array, " n"], sigma: Float[Array, " n"]) -> Self:
        """Independent coordinates with standard deviations sigma."""
        return cls(mean, jnp.diag(1.0 / sigma))

    @classmethod
    def from_covariance(cls, mean: Float[Array, " n"], covariance: Float[Array, "n n"]) -> Self:
        """A full covariance, positive definite."""
        lower = jnp.linalg.cholesky(covariance)
        identity = jnp.eye(len(covariance), dtype=mean.dtype)
        return cls(mean, jsl.solve_triangular(lower, identity, lower=True))


class PriorTerm(Term):
    """Minus the logarithm of a Gaussian over the joint angles."""

    gaussian: Gaussian

    def linearize(self, qpos: Float[Array, " 63"]) -> Linearized:
        """Whitened differences from the prior's mean."""
        residual = self.gaussian.whitening @ (qpos[7:] - self.gaussian.mean)
        jacobian = jnp.concatenate(
            [jnp.zeros((DOF_COUNT, 6), dtype=qpos.dtype), self.gaussian.whitening], axis=1
        )
        return Linearized(residual, jacobian)


class StepTerm(Term):
    """Minus the logarithm of a Gaussian over the whole pose's tangent space.

    Attributes:
        qpos: the expected pose.
        gaussian: over the 62 tangent coordinates of the deviation from it.
    """

    qpos: Float[Array, " 63"]
    gaussian: Gaussian

    def linearize(self, qpos: Float[Array, " 63"]) -> Linearized:
        """The whitened deviation."""
        deviation = difference(self.qpos, qpos)
        # log(a exp(d)) = log(a) + J_r^-1 d, and J_r(v)^-1 = J_l(v)^-T.
        bend = rotations.inverse_left_jacobian(deviation[3:6]).T
        W = self.gaussian.whitening
        residual = W @ (deviation - self.gaussian.mean)
        return Linearized(residual, W.at[:, 3:6].set(W[:, 3:6] @ bend))


class RootTerm(Term):
    """Keeps the root near where constant velocity would take it.

    Weak: it defines the root when trackers drop out and calms it when they are noisy.

    Attributes:
        qpos: the expected pose, of which only the root counts.
        sigma_position: [m].
        sigma_orientation: [rad].
    """

    qpos: Float[Array, " 63"]
    sigma_position: Float[Array, ""]
    sigma_orientation: Float[Array, ""]

    def linearize(self, qpos: Float[Array, " 63"]) -> Linearized:
        """Whitened differences of position and rotation vector."""
        turn = rotations.log(rotations.multiply(rotations.conjugate(self.qpos[3:7]), qpos[3:7]))
        residual = jnp.concatenate(
            [(qpos[:3] - self.qpos[:3]) / self.sigma_position, turn / self.sigma_orientation]
        )
        bend = rotations.inverse_left_jacobian(turn).T / self.sigma_orientation  # as in StepTerm
        step = jnp.eye(3, dtype=qpos.dtype) / self.sigma_position
        jacobian = jnp.zeros((6, TANGENT_SIZE), dtype=qpos.dtype)
        return Linearized(residual, jacobian.at[:3, :3].set(step).at[3:, 3:6].set(bend))


class LimitTerm(Term):
    """Soft joint limits: see `localreg.synthesis.belief.Limits`.

    Attributes:
        low: lower ends of the ranges [rad].
        high: upper ends [rad].
        sigma: how far outside counts as one standard deviation [rad].
    """

    low: Float[Array, " 56"]
    high: Float[Array, " 56"]
    sigma: Float[Array, ""]

    def linearize(self, qpos: Float[Array, " 63"]) -> Linearized:
        """Excess over the range, whitened; its square is Huber's function."""
        angles = qpos[7:]
        excess = jnp.maximum(angles - self.high, 0.0) + jnp.minimum(angles - self.low, 0.0)
        far = jnp.abs(excess) / self.sigma
        root = jnp.sqrt(jnp.maximum(2.0 * far - 1.0, 1.0))
        residual = jnp.sign(excess) * jnp.where(far < 1.0, far, root)
        slope = jnp.where(excess != 0.0, 1.0 / (root * self.sigma), 0.0)
        jacobian = jnp.zeros((DOF_COUNT, TANGENT_SIZE), dtype=qpos.dtype)
        return Linearized(residual, jacobian.at[:, 6:].set(jnp.diag(slope)))


def linearize(terms: tuple[Term, ...], qpos: Float[Array, " 63"]) -> Linearized:
    """All terms stacked."""
    parts = [term.linearize(qpos) for term in terms]
    return Linearized(
        jnp.concatenate([part.residual for part in parts]),
        jnp.concatenate([part.jacobian for part in parts]),
    )


def energy(terms: tuple[Term, ...], qpos: Float[Array, " 63"]) -> Float[Array, ""]:
    """The energy of a pose: half the squared length of all residuals."""
    residual = linearize(terms, qpos).residual
    return 0.5 * jnp.sum(residual * residual)
