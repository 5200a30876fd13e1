"""What a prior believes of the present pose: one Gaussian, and soft joint limits.

Every prior of this project, published ones included, comes down to this: a quadratic energy
over the 62 tangent coordinates of the deviation from an expected pose,

    E_prior(q) = (d - mean)^T information (d - mean) / 2 + limits,   d = difference(qpos, q).

Solvers see nothing else of a prior, so any solver works with any prior.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT


class Limits(NamedTuple):
    """Soft joint limits: nothing inside the range, a spring outside, a constant pull far outside.

    The energy of an excess is Huber's function (1964), so that people who do what nobody in the
    database did are slowed, not stopped.

    Attributes:
        low: lower ends of the ranges [rad]; minus infinity where there is none.
        high: upper ends [rad].
        sigma: how far outside counts as one standard deviation [rad]; the pull does not grow
            beyond.
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
