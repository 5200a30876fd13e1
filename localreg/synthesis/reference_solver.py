"""The readable solver of a pose's energy, by optimistix.

The unknown is the 62-vector of tangent increments from the start, so that the root's
quaternion needs no constraint, and the derivative is the terms' own, injected by a custom
JVP, since differentiating through the kinematic chain costs twice as much.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int
from numpy import ndarray

from localreg import jax_numerics as jax_numerics
from localreg.body import rotations
from localreg.body.kinematics import Kinematics, integrate
from localreg.body.skeleton import TANGENT_SIZE
from localreg.synthesis.energy import Term, TrackerTerm, energy, linearize
from localreg.synthesis.solver import Problem, Solution, Solver
from localreg.synthesis.term_belief import terms_of_belief


@dataclass(frozen=True)
class ReferenceSolver(Solver):
    """The readable solver, on the energy terms that papers would write.

    Attributes:
        rtol: relative tolerance of the step and of the energy.
        atol: absolute tolerance.
    """

    rtol: float = 1e-4
    atol: float = 1e-5

    def solve(self, problem: Problem, start: Float[ndarray, "63"], max_steps: int) -> Solution:
        """The best pose found from a start."""
        trackers = TrackerTerm(
            Kinematics.from_chain(problem.chain),
            jax.tree.map(jnp.asarray, problem.observation),
            *map(jnp.asarray, problem.control),
        )
        method = LevenbergMarquardt(self.rtol, self.atol)
        found, hessian, errors, orientations = _solve_terms(
            method, max_steps, trackers, terms_of_belief(problem.belief), jnp.asarray(start)
        )
        position, orientation = map(np.array, errors)
        return Solution(
            np.array(found.qpos),
            float(found.energy),
            int(found.steps),
            np.array(hessian),
            position,
            orientation,
            np.array(orientations),
        )


@eqx.filter_jit
def _solve_terms(
    method: "LevenbergMarquardt",
    max_steps: int,
    trackers: TrackerTerm,
    prior: tuple[Term, ...],
    start: Float[Array, " 63"],
) -> tuple["Found", Array, tuple[Array, Array], Array]:
    terms = (trackers, *prior)
    found = method.solve(terms, start, max_steps)
    jacobian = linearize(terms, found.qpos).jacobian
    poses = trackers.kinematics.tracker_poses(found.qpos)
    return found, jacobian.T @ jacobian, trackers.errors(found.qpos), poses.quaternions


class Found(eqx.Module):
    """What optimistix found.

    Attributes:
        qpos: the pose.
        energy: at that pose.
        steps: Levenberg-Marquardt steps taken; reaching the cap is normal.
        ok: False if the energy is not finite or above the start's; then the pose
            is the start.
    """

    qpos: Float[Array, " 63"]
    energy: Float[Array, ""]
    steps: Int[Array, ""]
    ok: Bool[Array, ""]


class LevenbergMarquardt(eqx.Module):
    """The readable reference solver.

    Attributes:
        rtol: relative tolerance of the step and of the energy.
        atol: absolute tolerance.
    """

    rtol: float = eqx.field(static=True, default=1e-4)
    atol: float = eqx.field(static=True, default=1e-5)

    def solve(self, terms: tuple[Term, ...], start: Float[Array, " 63"], max_steps: int) -> Found:
        """Minimize the energy from a start, in at most `max_steps` steps."""
        method = optx.LevenbergMarquardt(
            rtol=self.rtol, atol=self.atol, linear_solver=lx.Normal(lx.Cholesky())
        )
        found = optx.least_squares(
            lambda step, args: _residual(*args, step),
            method,
            jnp.zeros(TANGENT_SIZE, dtype=start.dtype),
            args=(terms, start),
            max_steps=max_steps,
            throw=False,
        )
        qpos = normalize_root(integrate(start, found.value))
        before, after = energy(terms, start), energy(terms, qpos)
        ok = jnp.isfinite(after) & (after <= before)
        return Found(
            jnp.where(ok, qpos, start),
            jnp.where(ok, after, before),
            jnp.asarray(found.stats["num_steps"]),
            ok,
        )


def normalize_root(qpos: Float[Array, " 63"]) -> Float[Array, " 63"]:
    """The pose with its root quaternion brought back to unit length."""
    quaternion = qpos[3:7]
    return qpos.at[3:7].set(quaternion / jnp.linalg.norm(quaternion))


@jax.custom_jvp
def _residual(
    terms: tuple[Term, ...], start: Float[Array, " 63"], step: Float[Array, " 62"]
) -> Float[Array, " r"]:
    return linearize(terms, integrate(start, step)).residual


@_residual.defjvp
def _residual_jvp(primals: Any, tangents: Any) -> Any:
    terms, start, step = primals
    direction = tangents[2]
    residual, jacobian = linearize(terms, integrate(start, step))
    # The terms move the root by exp on the right of where the step has brought it.
    turn = rotations.right_jacobian(step[3:6]) @ direction[3:6]
    return residual, jacobian @ jnp.concatenate([direction[:3], turn, direction[6:]])
