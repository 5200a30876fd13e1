"""Points of a body that laboratories work with: joint centres and skin markers.

Markers are those of the Plug-in Gait set, where they would be on a body of the subject's
size: each sits on one bone, so they show no soft tissue. They stand in for recorded ones
where a program wants markers; they are not measurements.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import BODY_NAMES, default_offsets
from localreg.body.subject import Subject
from localreg.motion.body_poses import body_points, body_turns
from localreg.motion.motion import Motion
from localreg.motion.postures import standing


@dataclass(frozen=True, slots=True)
class Point:
    """A point of the body.

    Attributes:
        name: as laboratories call it.
        body: the bone it moves with, of `BODY_NAMES`.
        along: where along the bone, 0 at its start and 1 at its end.
        offset: from there in the anatomical position, x left, y up, z forward, on a body of
            the canonical skeleton's size [m].
    """

    name: str
    body: str
    along: float
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)


_CENTRES: Final = (
    ("HJC", "femur", 0.0), ("KJC", "tibia", 0.0), ("AJC", "foot", 0.0), ("MTP", "toes", 0.0),
    ("TOE_END", "toes", 1.0), ("SCJ", "clavicle", 0.0), ("SJC", "humerus", 0.0),
    ("EJC", "radius", 0.0), ("WJC", "hand", 0.0), ("HAND_END", "hand", 1.0),
    ("FINGER_END", "fingers", 1.0), ("THUMB_END", "thumb", 1.0),
)  # fmt: skip

JOINT_CENTRES: Final = (
    Point("PELVIS", "root", 0.0),
    Point("LUMBAR", "upperback", 0.0),
    Point("THORAX", "thorax", 0.0),
    Point("NECK", "lowerneck", 0.0),
    Point("NECK_MID", "upperneck", 0.0),
    Point("HEAD", "head", 0.0),
    Point("HEAD_END", "head", 1.0),
    *(Point(s.upper() + name, s + bone, along) for s in "lr" for name, bone, along in _CENTRES),
)
"""Where bones meet and end."""

_MIDDLE: Final = (
    Point("C7", "lowerneck", 0.0, (0.0, 0.02, -0.08)),
    Point("T10", "thorax", 0.0, (0.0, 0.0, -0.12)),
    Point("CLAV", "thorax", 1.0, (0.0, -0.03, 0.08)),
    Point("STRN", "thorax", 0.1, (0.0, 0.0, 0.13)),
    Point("RBAK", "thorax", 0.5, (-0.08, 0.0, -0.12)),
)

# Of the left side; the right mirrors them.
_PAIRED: Final = (
    Point("FHD", "head", 0.6, (0.07, 0.0, 0.09)),
    Point("BHD", "head", 0.6, (0.07, 0.0, -0.09)),
    Point("SHO", "clavicle", 1.0, (0.0, 0.05, 0.0)),
    Point("UPA", "humerus", 0.5, (0.055, 0.0, 0.0)),
    Point("ELB", "humerus", 1.0, (0.045, 0.0, 0.0)),
    Point("FRM", "radius", 0.6, (0.045, 0.0, 0.0)),
    Point("WRA", "wrist", 1.0, (0.035, 0.0, 0.0)),
    Point("WRB", "wrist", 1.0, (-0.035, 0.0, 0.0)),
    Point("FIN", "hand", 1.0, (0.0, 0.0, -0.02)),
    Point("ASI", "root", 0.0, (0.13, -0.01, 0.12)),
    Point("PSI", "root", 0.0, (0.05, 0.03, -0.11)),
    Point("THI", "femur", 0.5, (0.09, 0.0, 0.0)),
    Point("KNE", "femur", 1.0, (0.055, 0.0, 0.0)),
    Point("TIB", "tibia", 0.5, (0.06, 0.0, 0.0)),
    Point("ANK", "tibia", 1.0, (0.045, 0.0, 0.0)),
    Point("HEE", "foot", 0.0, (0.0, -0.04, -0.07)),
    Point("TOE", "foot", 1.0, (0.0, 0.03, 0.0)),
)


def _beside(side: str, point: Point) -> Point:
    """The point of one side that a point of both stands for."""
    body = point.body if point.body in BODY_NAMES else side + point.body
    x, y, z = point.offset
    return Point(side.upper() + point.name, body, point.along, (x if side == "l" else -x, y, z))


PLUG_IN_GAIT: Final = (*_MIDDLE, *(_beside(side, point) for side in "lr" for point in _PAIRED))
"""The markers of the Plug-in Gait set."""

_ALL: Final = (*JOINT_CENTRES, *PLUG_IN_GAIT)

POINTS: Final = tuple(point.name for point in _ALL)
"""Names of all points that `points` gives: joint centres, then markers."""


def points(motion: Motion) -> Float[ndarray, "frames points 3"]:
    """Where all `POINTS` are in the world, frame by frame [m]."""
    turns = body_turns(motion.qpos, motion.subject)
    starts, _ = body_points(motion.qpos, motion.subject, turns)
    bodies = [BODY_NAMES.index(point.body) for point in _ALL]
    there = local_places(motion.subject)
    return starts[:, bodies] + np.einsum("fpij,pj->fpi", turns[:, bodies], there)


def local_places(subject: Subject) -> Float[ndarray, "points 3"]:
    """Where all `POINTS` are in their bones' frames, from the bones' starts [m]."""
    postures, scale = standing(subject), size(subject)
    places = []
    for point in _ALL:
        body = BODY_NAMES.index(point.body)
        along = point.along * subject.offsets[body - 1] if body else np.zeros(3)
        places.append(along + scale * postures[body].T @ np.array(point.offset))
    return np.array(places)


def size(subject: Subject) -> float:
    """How large a person is: all bone lengths together against the canonical skeleton's."""
    usual = np.linalg.norm(default_offsets(), axis=1)
    return float(np.sum(subject.lengths) / np.sum(usual))
