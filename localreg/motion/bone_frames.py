"""Axes of bones from directions: along one and near another, or turned onto one."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray


def unit(vectors: Float[ndarray, "*b 3"]) -> Float[ndarray, "*b 3"]:
    """Vectors at length one."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def turned_back(
    turns: Float[ndarray, "frames 3 3"], vectors: Float[ndarray, "frames 3"]
) -> ndarray:
    """Vectors of the world in turned axes."""
    return np.einsum("fij,fi->fj", turns, vectors)


def frame_along(
    x: Float[ndarray, "*b 3"], near_y: Float[ndarray, "*b 3"]
) -> Float[ndarray, "*b 3 3"]:
    """Rotations whose first axis is x and whose second lies as near as it can to another."""
    z = unit(np.cross(x, near_y))
    return np.stack([x, np.cross(z, x), z], axis=-1)


def frame_about(
    y: Float[ndarray, "*b 3"], near_x: Float[ndarray, "*b 3"]
) -> Float[ndarray, "*b 3 3"]:
    """Rotations whose second axis is y and whose first lies as near as it can to another."""
    x = unit(near_x - np.sum(near_x * y, axis=-1, keepdims=True) * y)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


def turn_onto(
    turns: Float[ndarray, "frames 3 3"],
    direction: Float[ndarray, "3"],
    wanted: Float[ndarray, "frames 3"],
) -> Float[ndarray, "frames 3 3"]:
    """Turns followed by the smallest ones that bring a direction of theirs to a wanted one."""
    now = turns @ direction
    axis = np.cross(now, wanted)
    cosine = np.sum(now * wanted, axis=-1)
    near_half = cosine < -1.0 + 1e-9
    # Half a turn has no smallest one; about any axis across is as good.
    axis = np.where(near_half[:, None], 0.0, axis)
    x, y, z = axis.T
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)
    turn = np.eye(3) + skew + skew @ skew / np.maximum(1.0 + cosine, 1e-9)[:, None, None]
    across = unit(np.cross(now, np.eye(3)[np.argmin(np.abs(now), axis=-1)]))
    half = 2.0 * across[:, :, None] * across[:, None, :] - np.eye(3)
    return np.where(near_half[:, None, None], half, turn) @ turns


def shortest_turn(start: Float[ndarray, "3"], end: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """The smallest turn that brings one direction to another."""
    return turn_onto(np.eye(3)[None], start, end[None])[0]


def mean_turn(turns: Float[ndarray, "frames 3 3"]) -> Float[ndarray, "3 3"]:
    """The rotation nearest to all of these."""
    u, _, vh = np.linalg.svd(np.mean(turns, axis=0))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vh))])
    return (u * sign) @ vh
