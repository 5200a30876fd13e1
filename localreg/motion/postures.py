"""Postures to count rotations from: the T pose of animators, the standing one of anatomists.

At rest, with all joint angles zero, the canonical skeleton spreads its legs by 20 degrees and
its arms to the sides. A posture says how every bone is turned from there, in root axes
(x left, y up, z forward).
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import BODY_NAMES, BONE_NAMES
from localreg.body.subject import Subject
from localreg.motion.bone_frames import frame_along, shortest_turn

_DOWN: Final = np.array([0.0, -1.0, 0.0])
_LEFT: Final = np.array([1.0, 0.0, 0.0])

# The bones whose x hinge, once lateral, says how limbs stand about their own axis.
_STANDING: Final = {
    "femur": ("femur", "tibia", 1.0),
    "tibia": ("tibia", "tibia", 1.0),
    "foot": ("tibia", "tibia", 1.0),
    "toes": ("tibia", "tibia", 1.0),
    "humerus": ("humerus", "radius", -1.0),
    "radius": ("radius", "radius", -1.0),
    "wrist": ("wrist", "fingers", -1.0),
    "hand": ("hand", "fingers", -1.0),
    "fingers": ("fingers", "fingers", -1.0),
    "thumb": ("hand", "fingers", -1.0),
}


def t_pose(subject: Subject) -> Float[ndarray, "31 3 3"]:
    """Turns of the bodies of `BODY_NAMES` into the T pose.

    Legs straight down, arms straight to the sides, palms down, feet forward.
    """
    turns = np.tile(np.eye(3), (len(BODY_NAMES), 1, 1))
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for bone in ("femur", "tibia"):
            turns[_body(side + bone)] = shortest_turn(_direction(subject, side + bone), _DOWN)
        for bone in ("foot", "toes"):
            turns[_body(side + bone)] = turns[_body(side + "tibia")]
        for bone in ("humerus", "radius", "wrist", "hand", "fingers"):
            turns[_body(side + bone)] = shortest_turn(
                _direction(subject, side + bone), sign * _LEFT
            )
        turns[_body(side + "thumb")] = turns[_body(side + "hand")]
    return turns


def standing(subject: Subject) -> Float[ndarray, "31 3 3"]:
    """Turns of the bodies of `BODY_NAMES` into the anatomical position.

    Legs and arms straight down, knees' and elbows' hinges from side to side, palms forward,
    feet as straight legs leave them; the trunk as at rest.
    """
    turns = np.tile(np.eye(3), (len(BODY_NAMES), 1, 1))
    for side in "lr":
        for bone, (along, hinged, sign) in _STANDING.items():
            frame = subject.axis_frames[BONE_NAMES.index(side + hinged)]
            here = _frame(_direction(subject, side + along), frame[:, 0])
            turns[_body(side + bone)] = _frame(_DOWN, sign * _LEFT) @ here.T
    return turns


def _body(name: str) -> int:
    return BODY_NAMES.index(name)


def _direction(subject: Subject, bone: str) -> Float[ndarray, "3"]:
    return subject.directions[BONE_NAMES.index(bone)]


def _frame(along: Float[ndarray, "3"], beside: Float[ndarray, "3"]) -> Float[ndarray, "3 3"]:
    """Orthonormal columns: a direction, what is left of another beside it, and their normal."""
    if np.linalg.norm(np.cross(along, beside)) < 1e-6:
        # A hinge along its bone says nothing: take any side.
        beside = np.eye(3)[int(np.argmin(np.abs(along)))]
    return frame_along(along, beside)
