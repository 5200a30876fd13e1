"""Frames that are missing or wrong for a moment, filled in from both sides.

A gap is bridged by cubic splines through the good frames around it: of the root's position
and the unwrapped joint angles, and on SO(3) for the root's orientation. What is wrong are
jumps: moments at which the body goes somewhere and back, faster than bodies can.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from localreg.errors import MotionError
from localreg.motion.body_poses import body_points
from localreg.motion.motion import Motion

LONGEST: Final = 0.25
"""Gaps longer than this are not guessed [s]."""

SPEED: Final = 15.0
"""No bone end moves faster against the root, nor the root itself [m/s].

Hands of fast punches and golf swings reach 10 to 12.
"""

_AROUND: Final = 8  # good frames on each side that a spline goes through
_OPPOSITE: Final = -0.5  # the cosine between a jump and the jump back is below
_CONTEXT: Final = 0.35  # a jump is also this many times faster than the moments around it


def find_jumps(motion: Motion, longest: float = LONGEST) -> Bool[ndarray, " frames"]:
    """The frames between a jump and the jump back.

    A jump is a step that is far faster than those around it and than bodies are. Frames
    between two jumps not farther apart than `longest` are wrong if the second goes back
    against the first. A single jump, as where two takes were joined, is none that could be
    mended.

    Args:
        motion: the motion.
        longest: the longest stretch that may be wrong [s].
    """
    wrong = np.zeros(len(motion), dtype=bool)
    if len(motion) < 4:
        return wrong
    _, ends = body_points(motion.qpos, motion.subject)
    ends = np.concatenate([ends[:, :1], ends[:, 1:] - ends[:, :1]], axis=1)

    moves = np.diff(ends, axis=0)
    steps = np.linalg.norm(moves, axis=2).max(axis=1) * motion.rate
    usual = _median_around(steps, 5)
    jumps = np.flatnonzero((steps > SPEED) & (usual < _CONTEXT * steps))
    done = 0
    for there in jumps:
        for back in jumps[jumps > there][::-1]:
            is_short = back - there <= longest * motion.rate
            if there >= done and is_short and _are_opposite(moves[there], moves[back]):
                wrong[there + 1 : back + 1] = True
                done = back + 1
    return wrong


def _are_opposite(a: Float[ndarray, "ends 3"], b: Float[ndarray, "ends 3"]) -> bool:
    """Whether two steps of the body lead in opposite directions."""
    return float(np.sum(a * b)) < _OPPOSITE * float(np.linalg.norm(a) * np.linalg.norm(b))


def fill_gaps(
    motion: Motion, missing: Bool[ndarray, " frames"], longest: float = LONGEST
) -> Motion:
    """The motion with some frames made up from those around them.

    Args:
        motion: the motion; what its missing frames hold is not looked at.
        missing: which frames are missing.
        longest: the longest gap to fill [s].

    Raises:
        MotionError: a gap is too long or at an end of the motion; says where.
    """
    qpos = motion.qpos.copy()
    good = np.flatnonzero(~missing)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], missing, [False]])))
    name = motion.provenance.name
    for first, last in edges.reshape(-1, 2):
        where = f"motion {name}: frames {first} to {last - 1} are missing"
        if first == 0 or last == len(motion):
            raise MotionError(f"{where}, at an end, where nothing tells of them; trim them")
        if last - first > longest * motion.rate:
            raise MotionError(f"{where}, longer than {longest:g} s; trim there or allow more")
        before = good[good < first][-_AROUND:]
        after = good[good >= last][:_AROUND]
        qpos[first:last] = _bridge(qpos, np.concatenate([before, after]), np.arange(first, last))
    return replace(motion, qpos=qpos)


def _bridge(
    qpos: Float[ndarray, "frames 63"], known: ndarray, wanted: ndarray
) -> Float[ndarray, "n 63"]:
    """Poses of some frames by splines through others."""
    vectors = np.hstack([qpos[known, :3], np.unwrap(qpos[known, 7:], axis=0)])
    vectors = make_interp_spline(known, vectors, k=min(3, len(known) - 1))(wanted)
    root = Rotation.from_quat(qpos[known, 3:7], scalar_first=True)
    turn = RotationSpline(known, root) if len(known) > 2 else Slerp(known, root)
    quaternions = turn(wanted).as_quat(scalar_first=True)
    nearest = qpos[known[known < wanted[0]][-1], 3:7]
    quaternions *= np.where(quaternions @ nearest < 0.0, -1.0, 1.0)[:, None]
    return np.hstack([vectors[:, :3], quaternions, vectors[:, 3:]])


def _median_around(values: Float[ndarray, " n"], reach: int) -> Float[ndarray, " n"]:
    """The median of the values around each, without itself."""
    padded = np.pad(values, reach, mode="reflect" if len(values) > reach else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    return np.median(np.delete(windows, reach, axis=1), axis=1)
