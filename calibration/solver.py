"""Levenberg-Marquardt over a whole calibration, and the covariance at its end."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int
from numpy import ndarray

from calibration.model import Linearized, Problem, dense, linearize, residual, split
from localreg.numerics import scipy_linalg

_MAX_STEPS = 40


class Solution(eqx.Module):
    """What the solver found.

    Attributes:
        x: all unknowns.
        cost: half the sum of squares there.
        start_cost: the same at the start.
        steps: taken.
        is_converged: False if the cap was reached or a number was not finite.
    """

    x: Float[Array, " n"]
    cost: Float[Array, ""]
    start_cost: Float[Array, ""]
    steps: Int[Array, ""]
    is_converged: Bool[Array, ""]


@eqx.filter_jit
def solve(problem: Problem, x: Float[Array, " n"]) -> Solution:
    """Minimize half the sum of squares from a start."""
    method = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-5, linear_solver=lx.Normal(lx.Cholesky()))
    found = optx.least_squares(
        lambda y, args: _residual(args, y),
        method,
        x,
        args=problem,
        max_steps=_MAX_STEPS,
        throw=False,
    )
    start, end = residual(problem, x), residual(problem, found.value)
    before, after = 0.5 * start @ start, 0.5 * end @ end
    good = jnp.isfinite(after) & (after <= before)
    return Solution(
        jnp.where(good, found.value, x),
        jnp.where(good, after, before),
        before,
        jnp.asarray(found.stats["num_steps"]),
        good & (found.result == optx.RESULTS.successful),
    )


@jax.custom_jvp
def _residual(problem: Problem, x: Float[Array, " n"]) -> Float[Array, " m"]:
    return residual(problem, x)


@_residual.defjvp
def _residual_jvp(primals: Any, tangents: Any) -> Any:
    problem, x = primals
    shared, local = split(problem, tangents[1])
    linear = linearize(problem, x)
    value = jnp.concatenate([linear.shared_residual, linear.residuals.ravel()])
    # Block by block: a pose's unknowns touch its own rows alone.
    rows = linear.by_shared @ shared + jnp.einsum("nrl,nl->nr", linear.by_local, local)
    return value, jnp.concatenate([linear.shared_jacobian @ shared, rows.ravel()])


linearize_at = eqx.filter_jit(linearize)


class Posterior(NamedTuple):
    """The Gaussian approximation at the end of a fit.

    Attributes:
        shared: covariance of the shared unknowns.
        local: covariance of every pose's own unknowns.
        cross: covariance of every pose's own with the shared unknowns.
        costs: half the sum of squares of each pose's rows.
    """

    shared: Float[ndarray, "s s"]
    local: Float[ndarray, "N l l"]
    cross: Float[ndarray, "N l s"]
    costs: Float[ndarray, " N"]


def posterior(linear: Linearized) -> Posterior:
    """Inverse of J^T J by the Schur complement of the poses' blocks."""
    A, B = np.asarray(linear.by_shared), np.asarray(linear.by_local)
    rows = np.asarray(linear.residuals)
    Bt = np.swapaxes(B, 1, 2)
    inner = np.linalg.inv(Bt @ B)
    weighted = np.swapaxes(A, 1, 2) @ B @ inner
    information = information_of(linear)
    shared = scipy_linalg.inv(information)
    local = inner + np.einsum("nsl,st,ntk->nlk", weighted, shared, weighted, optimize=True)
    across = -np.einsum("nsl,st->nlt", weighted, shared)
    return Posterior(0.5 * (shared + shared.T), local, across, 0.5 * np.sum(rows**2, axis=1))


def information_of(linear: Linearized) -> Float[ndarray, "s s"]:
    """Information matrix of the shared unknowns, the poses' own eliminated."""
    A, B = np.asarray(linear.by_shared), np.asarray(linear.by_local)
    P = np.asarray(linear.shared_jacobian)
    return P.T @ P + pose_information(A, B).sum(axis=0)


def pose_information(
    by_shared: Float[ndarray, "N r s"], by_local: Float[ndarray, "N r l"]
) -> Float[ndarray, "N s s"]:
    """What each pose tells of the shared unknowns, whatever its own are."""
    At, Bt = np.swapaxes(by_shared, 1, 2), np.swapaxes(by_local, 1, 2)
    cross = At @ by_local
    return At @ by_shared - cross @ np.linalg.solve(Bt @ by_local, np.swapaxes(cross, 1, 2))


class ScoreTest:
    """How much further unknowns would lower the cost, to first order.

    Args:
        linear: at the end of a fit.
    """

    def __init__(self, linear: Linearized) -> None:
        self._J = np.asarray(dense(linear))
        self._shared = linear.shared_residual.shape[0]
        residuals = np.asarray(linear.residuals).ravel()
        self._r = np.concatenate([np.asarray(linear.shared_residual), residuals])
        self._H = scipy_linalg.cho_factor(self._J.T @ self._J)

    def gain(self, columns: Float[ndarray, "N r k"]) -> tuple[float, Float[ndarray, " k"]]:
        """The decrease of the cost, and the values of the unknowns.

        Args:
            columns: derivative of every pose's rows by the further unknowns.
        """
        k = columns.shape[2]
        C = np.concatenate([np.zeros((self._shared, k)), columns.reshape(-1, k)])
        projected = C - self._J @ scipy_linalg.cho_solve(self._H, self._J.T @ C)
        gradient = projected.T @ self._r
        left = C.T @ projected + 1e-9 * np.eye(k)
        step = -np.linalg.solve(left, gradient)
        return float(-0.5 * gradient @ step), step
