"""Quaternions over time."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def one_hemisphere(quaternions: Float[ndarray, "frames 4"]) -> Float[ndarray, "frames 4"]:
    """The same rotations without jumps of the sign between frames."""
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    odd = np.concatenate([[False], np.cumsum(flips) % 2 == 1])[: len(quaternions)]
    return np.where(odd[:, None], -1.0, 1.0) * quaternions
