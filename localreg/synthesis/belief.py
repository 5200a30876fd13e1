"""What a prior believes of the present pose: one Gaussian, and soft joint limits.

Every prior of this project, published ones included, comes down to this: a quadratic energy
over the 62 tangent coordinates of the deviation from an expected pose,

    E_prior(q) = (d - mean)^T information (d - mean) / 2 + limits,   d = difference(qpos, q).

Solvers see nothing else of a prior, so any solver works with any prior.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg import numerics as numerics
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.errors import SynthesisError
from localreg.synthesis.energy import (
    Gaussian,
    LimitTerm,
    PriorTerm,
    RootTerm,
    StepTerm,
    Term,
)


class Limits(NamedTuple):
    """Soft joint limits: nothing inside the range, a spring outside.

    Attributes:
        low: lower ends of the ranges [rad]; minus infinity where there is none.
        high: upper ends [rad].
        sigma: how far outside counts as one standard deviation [rad].
    """

    low: Float[ndarray, "56"]
    high: Float[ndarray, "56"]
    sigma: float


NO_LIMITS = Limits(np.full(DOF_COUNT, -np.inf), np.full(DOF_COUNT, np.inf), 1.0)
"""Joint angles may be anything."""


class Belief(NamedTuple):
    """A Gaussian over the deviation from an expected pose.

    Attributes:
        qpos: the pose that deviations are measured from, and where solvers start.
        mean: expected deviation from it.
        information: inverse covariance of the deviation.
        limits: soft joint limits.
    """

    qpos: Float[ndarray, "63"]
    mean: Float[ndarray, "62"]
    information: Float[ndarray, "62 62"]
    limits: Limits = NO_LIMITS


def belief_of_terms(qpos: Float[ndarray, "63"], terms: tuple[Term, ...]) -> Belief:
    """The belief that some energy terms add up to.

    Args:
        qpos: the expected pose; a root term's must have the same root.
        terms: of the prior alone, no trackers.

    Raises:
        SynthesisError: a term that is not quadratic in the deviation.
    """
    information = np.zeros((TANGENT_SIZE, TANGENT_SIZE))
    pull = np.zeros(TANGENT_SIZE)
    limits = NO_LIMITS
    for term in terms:
        match term:
            case PriorTerm(gaussian):
                W = np.asarray(gaussian.whitening)
                block = W.T @ W
                information[6:, 6:] += block
                pull[6:] += block @ (np.asarray(gaussian.mean) - qpos[7:])
            case RootTerm():
                weights = np.repeat(
                    [
                        1.0 / float(term.sigma_position) ** 2,
                        1.0 / float(term.sigma_orientation) ** 2,
                    ],
                    3,
                )
                information[np.arange(6), np.arange(6)] += weights
            case LimitTerm():
                limits = Limits(np.asarray(term.low), np.asarray(term.high), float(term.sigma))
            case _:
                raise SynthesisError(f"{type(term).__name__} is no part of a prior's belief")
    return Belief(qpos, _solve_symmetric(information, pull), information, limits)


def terms_of_belief(belief: Belief) -> tuple[Term, ...]:
    """The belief as energy terms, for the reference solver."""
    # A Cholesky factor of the inverse would lose what is not known at all.
    values, vectors = np.linalg.eigh(belief.information)
    whitening = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    step = StepTerm(
        jnp.asarray(belief.qpos), Gaussian(jnp.asarray(belief.mean), jnp.asarray(whitening))
    )
    low, high, sigma = belief.limits
    return step, LimitTerm(jnp.asarray(low), jnp.asarray(high), jnp.asarray(sigma))


def _solve_symmetric(
    information: Float[ndarray, "62 62"], pull: Float[ndarray, "62"]
) -> Float[ndarray, "62"]:
    """The mean that a pull of this size belongs to; none where nothing is known."""
    known = np.diagonal(information) > 0.0
    mean = np.zeros(TANGENT_SIZE)
    mean[known] = np.linalg.solve(information[np.ix_(known, known)], pull[known])
    return mean
