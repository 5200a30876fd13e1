"""Real motion made larger, for time and recall only: never a figure of accuracy comes from it.

Where there is too little motion for a large database, every clip is told again and again:
its time warped smoothly by up to a quarter, the upper body taken from another clip and
both sides scaled a little. Mirror images come with the database. Such clips fill the space
around real ones as denser archives would, but nobody has moved so.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from localreg.body.skeleton import DOF_BONES, DOF_COUNT
from localreg.errors import MotionError
from localreg.motion.motion import Motion

_WARP: Final = 0.25  # largest change of speed
_SCALE: Final = 0.1  # largest change of amplitude
_WAVES: Final = 0.4  # of speed, a second
_LEGS: Final = ("hipjoint", "femur", "tibia", "foot", "toes")
_UPPER: Final = np.array([not bone.endswith(_LEGS) for bone in DOF_BONES])


def made_larger(
    motions: Sequence[Motion], poses: int, rate: float, *, mirror: bool = True, seed: int = 0
) -> Iterator[Motion]:
    """The motions, then variants of them, until a database of them has so many poses.

    Args:
        motions: real ones; of a few too many, the last is cut.
        poses: of the database, mirror images counted.
        rate: of the database and of what is given [Hz].
        mirror: whether the database adds mirror images.
        seed: of the variants.

    Raises:
        MotionError: there is none.
    """
    real = [motion.resampled(rate).nearest_to_rest() for motion in motions]
    real = [motion for motion in real if len(motion) >= 4]
    if not real:
        raise MotionError("there is no motion of four frames or more to make larger")
    rng = np.random.default_rng(seed)
    left = -(-poses // 2) if mirror else poses
    told = 0
    while left > 0:
        for motion in real:
            donor = real[rng.integers(len(real))]
            made = motion if told == 0 else _variant(motion, donor, told, rng)
            made = made.first(left)
            yield made
            left -= len(made)
            if left <= 0:
                break
        told += 1


def _variant(motion: Motion, donor: Motion, number: int, rng: np.random.Generator) -> Motion:
    """The motion at another pace with another's upper body."""
    times = _warped(len(motion), motion.rate, rng)
    qpos = _at(motion.qpos, times)
    other = _at(donor.qpos, _warped(len(donor), donor.rate, rng))
    # Long enough by going to and fro, so that nothing jumps.
    there = np.arange(len(qpos)) + rng.integers(len(other))
    there = np.abs((there + len(other) - 1) % max(1, 2 * len(other) - 2) - (len(other) - 1))
    qpos[:, 7:][:, _UPPER] = other[there, 7:][:, _UPPER]
    qpos[:, 7:] *= 1.0 + _SCALE * rng.uniform(-1.0, 1.0, DOF_COUNT)
    made = motion.provenance
    provenance = replace(made, name=f"{made.name}~{number}", trial="", source="made larger")
    return replace(motion, qpos=qpos, provenance=provenance)


def _warped(frames: int, rate: float, rng: np.random.Generator) -> Float[ndarray, " times"]:
    """Instants, in frames of the motion, of a retelling whose speed changes smoothly."""
    seconds = np.arange(2 * frames) / rate
    wave = np.sin(2.0 * np.pi * (_WAVES * seconds + rng.random()))
    speed = 1.0 + _WARP * (rng.uniform(-0.7, 0.7) + 0.3 * wave)
    times = np.concatenate([[0.0], np.cumsum(speed)])
    return times[times <= frames - 1]


def _at(qpos: Float[ndarray, "frames 63"], times: Float[ndarray, " n"]) -> Float[ndarray, "n 63"]:
    """Poses between frames."""
    before = np.minimum(times.astype(int), len(qpos) - 2)
    share = (times - before)[:, None]
    # Angles near half a turn jump in the files.
    vectors = np.hstack([qpos[:, :3], np.unwrap(qpos[:, 7:], axis=0)])
    vectors = (1.0 - share) * vectors[before] + share * vectors[before + 1]
    roots = Slerp(np.arange(len(qpos)), Rotation.from_quat(qpos[:, 3:7], scalar_first=True))
    quaternions = roots(times).as_quat(scalar_first=True)
    return np.hstack([vectors[:, :3], quaternions, vectors[:, 3:]])
