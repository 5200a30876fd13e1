"""Between the two forms of a prior: energy terms, and the one Gaussian that solvers see."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg import jax_numerics as jax_numerics
from localreg.body.skeleton import TANGENT_SIZE
from localreg.errors import SynthesisError
from localreg.synthesis.belief import NO_LIMITS, Belief, Limits
from localreg.synthesis.energy import (
    Gaussian,
    LimitTerm,
    PriorTerm,
    RootTerm,
    StepTerm,
    Term,
)


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
