"""A body to look at: a capsule for each bone, as one mesh whose vertices follow joints."""

from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

_AROUND: Final = 12
_ALONG: Final = 4  # rings of each round end


class Mesh(NamedTuple):
    """Triangles whose corners each follow one joint.

    Attributes:
        positions: of the vertices [m].
        normals: unit vectors out of the surface.
        joints: the joint that each vertex follows.
        triangles: three vertices each, counterclockwise seen from outside.
    """

    positions: Float[ndarray, "vertices 3"]
    normals: Float[ndarray, "vertices 3"]
    joints: Int[ndarray, " vertices"]
    triangles: Int[ndarray, "triangles 3"]


def capsule(
    start: Float[ndarray, "3"], end: Float[ndarray, "3"], radius: float, joint: int
) -> Mesh:
    """A cylinder with round ends; a ball if start and end are the same.

    Args:
        start: centre of one round end [m].
        end: centre of the other [m].
        radius: of both and of the cylinder between [m].
        joint: what the vertices follow.
    """
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length if length > 1e-9 else np.array([0.0, 1.0, 0.0])
    beside = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    beside /= np.linalg.norm(beside)
    frame = np.stack([beside, np.cross(along, beside), along], axis=1)
    # Latitudes of one ball, its equator twice: once on each side of the cylinder.
    half = np.linspace(-0.5 * np.pi, 0.0, _ALONG + 1)
    latitudes = np.concatenate([half, -half[::-1]])
    around = 2.0 * np.pi * np.arange(_AROUND) / _AROUND
    normals = np.stack(
        [
            np.outer(np.cos(latitudes), np.cos(around)),
            np.outer(np.cos(latitudes), np.sin(around)),
            np.outer(np.sin(latitudes), np.ones(_AROUND)),
        ],
        axis=-1,
    )
    centres = np.where((np.arange(len(latitudes)) > _ALONG)[:, None], end, start)
    normals = normals @ frame.T
    positions = centres[:, None] + radius * normals
    rings = len(latitudes)
    joints = np.full(rings * _AROUND, joint)
    return Mesh(positions.reshape(-1, 3), normals.reshape(-1, 3), joints, _quads(rings))


def joined(meshes: list[Mesh]) -> Mesh:
    """Several meshes as one."""
    shifts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.joints for mesh in meshes]),
        np.concatenate([m.triangles + shift for m, shift in zip(meshes, shifts, strict=True)]),
    )


def _quads(rings: int) -> Int[ndarray, "triangles 3"]:
    """Two triangles between every two neighbouring vertices of neighbouring rings."""
    triangles = []
    for ring in range(rings - 1):
        for place in range(_AROUND):
            a, b = ring * _AROUND + place, ring * _AROUND + (place + 1) % _AROUND
            c, d = a + _AROUND, b + _AROUND
            if ring > 0:  # the first ring is a single point
                triangles.append((a, b, d))
            if ring < rings - 2:
                triangles.append((a, d, c))
    return np.array(triangles)
