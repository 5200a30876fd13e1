"""Feet that stand still while they stand: contacts locked, legs bent to suit.

Where `foot_contacts` sees the ball or the tip of a foot on the ground, that point is held
where it is in the middle of the contact; before and after, what it was moved by fades. The
legs follow by inverse kinematics: damped least squares over hip, knee and ankle of each frame
bring the point to its place, and as far as they can keep the foot's orientation and the
angles that were there. The root and the rest of the body stay as they are. Nothing lags,
for all frames are known.
"""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, BONE_NAMES, DOF_NAMES
from localreg.body.subject import Subject
from localreg.motion.body_poses import body_points, body_turns
from localreg.motion.contacts import FOOT_BODIES, runs, settled_contacts
from localreg.motion.joint_angles import axis_rotations, bone_rotations
from localreg.motion.motion import Motion

FADE: Final = 0.15
"""Time in which what a foot was moved by fades before and after a contact [s]."""

_SIGMA_POINT: Final = 0.0005  # how near the point is brought to its place [m]
_SIGMA_FOOT: Final = np.radians(3.0)  # what the foot may turn for it
_SIGMA_ANGLE: Final = np.radians(20.0)  # and each joint
_ITERATIONS: Final = 12
_SMALL: Final = 1e-6  # a foot that is to move by less stays [m]


class FootLock(NamedTuple):
    """A motion with locked feet, and what that took.

    Attributes:
        motion: the motion.
        contacts: which of `FOOT_BODIES` are held, frame by frame.
        shift: how far each foot's held point was moved, left and right [m].
        missed: how far it still is from its place, out of the leg's reach [m].
    """

    motion: Motion
    contacts: Bool[ndarray, "frames 4"]
    shift: Float[ndarray, "frames 2"]
    missed: Float[ndarray, "frames 2"]


def lock_feet(motion: Motion, contacts: Bool[ndarray, "frames 4"] | None = None) -> FootLock:
    """Hold the feet where they touch the ground.

    Args:
        motion: the motion.
        contacts: which of `FOOT_BODIES` stand, frame by frame; by default those
            that `settled_contacts` sees.
    """
    frames = len(motion)
    _, ends = body_points(motion.qpos, motion.subject)
    if contacts is None:
        contacts = settled_contacts(ends, motion.rate)
    qpos = motion.qpos.copy()
    shift, missed = np.zeros((2, frames, 2))
    for side in range(2):
        ball, tip = (ends[:, BODY_NAMES.index(FOOT_BODIES[2 * side + k])] for k in range(2))
        held = np.where(contacts[:, 2 * side], 0, np.where(contacts[:, 2 * side + 1], 1, -1))
        moves = _moves(np.stack([ball, tip], axis=1), held, FADE * motion.rate)
        shift[:, side] = np.linalg.norm(moves, axis=1)
        rows = np.flatnonzero(shift[:, side] > _SMALL)
        if rows.size:
            leg = _Leg("lr"[side], motion.subject, motion.qpos[rows])
            is_tip = held[rows] == 1
            target = np.where(is_tip[:, None], tip[rows], ball[rows]) + moves[rows]
            angles, missed[rows, side] = leg.reach(target, is_tip)
            qpos[rows[:, None], 7 + leg.columns] = angles
    return FootLock(replace(motion, qpos=qpos), contacts, shift, missed)


def _moves(
    points: Float[ndarray, "frames 2 3"], held: Int[ndarray, " frames"], fade: float
) -> Float[ndarray, "frames 3"]:
    """By how much to move a foot, frame by frame.

    Args:
        points: its ball and its tip [m].
        held: which of them is held; -1 for neither.
        fade: how many frames it takes to go over to not moved.
    """
    moves = np.zeros((len(held), 3))
    stances = runs(held >= 0)
    for first, last in stances:
        place = np.zeros(3)
        for part, end in _parts(held, first, last):
            path = points[part:end, held[part]]
            # A tip that takes over from the ball is held where it then is.
            place = np.median(path, axis=0) if part == first else path[0] + moves[part - 1]
            moves[part:end] = place - path
    ends = [0, *(edge for stance in stances for edge in stance), len(held)]
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        if stop == start:
            continue
        length = min(fade, stop - start)
        here = np.arange(start, stop)
        if start > 0:
            moves[start:stop] += _fading((here - start + 1) / length)[:, None] * moves[start - 1]
        if stop < len(held):
            moves[start:stop] += _fading((stop - here) / length)[:, None] * moves[stop]
    return moves


def _parts(held: Int[ndarray, " frames"], first: int, last: int) -> list[tuple[int, int]]:
    """The stretches of a stance in which one and the same point is held."""
    edges = first + 1 + np.flatnonzero(np.diff(held[first:last]))
    starts = [first, *edges.tolist()]
    return list(zip(starts, [*starts[1:], last], strict=True))


def _fading(time: Float[ndarray, " frames"]) -> Float[ndarray, " frames"]:
    """From one at nought to nothing at one and beyond, smoothly."""
    time = np.clip(time, 0.0, 1.0)
    return 1.0 - time**2 * (3.0 - 2.0 * time)


class _Leg:
    """The chain from the hip to a point of the foot, for many frames at once.

    Args:
        side: `"l"` or `"r"`.
        subject: whose leg.
        qpos: the poses.
    """

    def __init__(self, side: str, subject: Subject, qpos: Float[ndarray, "n 63"]) -> None:
        self.hinges = [
            (bone, axis)
            for bone, axes in (("femur", "zyx"), ("tibia", "x"), ("foot", "zx"))
            for axis in axes
        ]
        self.columns = np.array([DOF_NAMES.index(f"{side}{b}r{a}") for b, a in self.hinges])
        self._angles = qpos[:, 7 + self.columns]
        index = {bone: BONE_NAMES.index(side + bone) for bone in ("femur", "tibia", "foot", "toes")}
        self._frames = {bone: subject.axis_frames[i] for bone, i in index.items()}
        self._offsets = {bone: subject.offsets[i] for bone, i in index.items()}
        turns = body_turns(qpos, subject)
        starts, _ = body_points(qpos, subject, turns)
        self._pelvis, self._hip = turns[:, 0], starts[:, 1 + index["femur"]]
        self._foot = turns[:, 1 + index["foot"]]
        toes = bone_rotations(qpos[:, 7:], subject.axis_frames)[:, index["toes"]]
        self._tip = self._offsets["foot"] + toes @ self._offsets["toes"]

    def reach(
        self, target: Float[ndarray, "n 3"], is_tip: Bool[ndarray, " n"]
    ) -> tuple[Float[ndarray, "n 6"], Float[ndarray, " n"]]:
        """The angles that bring the ball, or the tip, of the foot to a place.

        Returns:
            The angles of `columns` [rad], and how far the point stays from its place [m].
        """
        point = np.where(is_tip[:, None], self._tip, self._offsets["foot"])
        angles = self._angles.copy()
        sigmas = [*[_SIGMA_POINT] * 3, *[_SIGMA_FOOT] * 3]
        for _ in range(_ITERATIONS):
            place, foot, jacobian = self._forward(angles, point)
            turned = foot @ np.swapaxes(self._foot, -1, -2)
            error = np.hstack([place - target, Rotation.from_matrix(turned).as_rotvec()]) / sigmas
            whitened = jacobian / np.array(sigmas)[:, None]
            back = np.swapaxes(whitened, -1, -2)
            hessian = back @ whitened + np.eye(6) / _SIGMA_ANGLE**2
            gradient = back @ error[..., None]
            gradient += (angles - self._angles)[..., None] / _SIGMA_ANGLE**2
            step = np.linalg.solve(hessian, gradient)[..., 0]
            # Near a straight leg the linear step overshoots.
            step *= np.minimum(1.0, 0.3 / np.maximum(np.abs(step).max(axis=1), 1e-12))[:, None]
            angles -= step
        place, _, _ = self._forward(angles, point)
        return angles, np.linalg.norm(place - target, axis=1)

    def _forward(
        self, angles: Float[ndarray, "n 6"], point: Float[ndarray, "n 3"]
    ) -> tuple[Float[ndarray, "n 3"], Float[ndarray, "n 3 3"], Float[ndarray, "n 6 6"]]:
        """The point's place, the foot's turn, and both derived by the angles."""
        turn, place = self._pelvis, self._hip
        axes, origins = [], []
        hinge = 0
        for bone in ("femur", "tibia", "foot"):
            frame = self._frames[bone]
            own = turn @ frame
            while hinge < 6 and self.hinges[hinge][0] == bone:
                axis = self.hinges[hinge][1]
                axes.append(own[:, :, "xyz".index(axis)])
                origins.append(place)
                own = own @ axis_rotations(axis, angles[:, hinge])
                hinge += 1
            turn = own @ frame.T
            offset = point if bone == "foot" else self._offsets[bone]
            place = place + np.einsum("nij,...j->ni" if offset.ndim == 1 else "nij,nj->ni",
                                      turn, offset)  # fmt: skip
        about, from_there = np.stack(axes, axis=2), place[:, :, None] - np.stack(origins, axis=2)
        linear = np.cross(about, from_there, axis=1)
        return place, turn, np.concatenate([linear, about], axis=1)
