"""Minimizing the energy of a pose: one interface, two solvers of the same problem.

`CompiledSolver` is the default, live and offline (`localreg.synthesis.compiled`). The readable
one, by optimistix, is `localreg.synthesis.reference_solver`, loaded when it is asked for.
Tests hold both to the same energies.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.chain import Chain
from localreg.synthesis.belief import Belief
from localreg.synthesis.compiled import Control, minimize
from localreg.synthesis.observation import Observation


class Problem(NamedTuple):
    """An energy to minimize.

    Attributes:
        chain: the body.
        observation: what the trackers say.
        control: how they count.
        belief: the prior.
    """

    chain: Chain
    observation: Observation
    control: Control
    belief: Belief


class Solution(NamedTuple):
    """What a solver found.

    Attributes:
        qpos: the pose.
        energy: at that pose.
        steps: steps taken; reaching the cap is normal.
        hessian: of the energy by the 62 tangent coordinates (Gauss-Newton).
        position_errors: synthesized minus measured tracker positions [m].
        orientation_errors: the same as world rotation vectors [rad].
        orientations: world quaternions of the synthesized trackers.
    """

    qpos: Float[ndarray, "63"]
    energy: float
    steps: int
    hessian: Float[ndarray, "62 62"]
    position_errors: Float[ndarray, "J 3"]
    orientation_errors: Float[ndarray, "J 3"]
    orientations: Float[ndarray, "J 4"]

    @property
    def ok(self) -> bool:
        """Whether the answer is a number; the energy is one only where the pose is."""
        return isfinite(self.energy)


class Solver(ABC):
    """Minimizes the energy of a pose."""

    @abstractmethod
    def solve(self, problem: Problem, start: Float[ndarray, "63"], max_steps: int) -> Solution:
        """The best pose found from a start; never of higher energy than the start."""


@dataclass(frozen=True)
class CompiledSolver(Solver):
    """The fast solver.

    Attributes:
        tolerance: decrease of the energy that is not worth another step.
    """

    tolerance: float = 1e-2

    def solve(self, problem: Problem, start: Float[ndarray, "63"], max_steps: int) -> Solution:
        """The best pose found from a start."""
        trackers, size = len(problem.chain.site_body), len(problem.belief.mean)
        qpos, hessian, orientations = start.copy(), np.empty((size, size)), np.empty((trackers, 4))
        errors = np.empty((trackers, 3)), np.empty((trackers, 3))
        least, steps = minimize(
            problem.chain, problem.observation, problem.control, problem.belief,
            max_steps, self.tolerance, qpos, hessian, errors, orientations,
        )  # fmt: skip
        return Solution(qpos, least, steps, hessian, *errors, orientations)


def _reference() -> Solver:
    from localreg.synthesis.reference_solver import ReferenceSolver

    return ReferenceSolver()


SOLVERS: Final[dict[str, Callable[[], Solver]]] = {
    "compiled": CompiledSolver,
    "optimistix": _reference,
}
"""What makes each solver, by name."""
