"""Where the ground is under a motion, from the bone ends alone."""

from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.model import UPRIGHT, build_model, end_site
from localreg.body.skeleton import BODY_NAMES, QPOS_SIZE
from localreg.body.subject import Subject
from localreg.motion.motion import Motion

SOLE: Final = 0.035
"""Bone ends lie so far above the ground that a foot stands on [m]."""

_LOWEST_SHARE: Final = 5  # percentile of the frames whose feet are taken to be on the ground


def end_heights(motion: Motion, most: int | None = None) -> Float[ndarray, "frames 2"]:
    """Heights of the lowest and the highest bone end, frame by frame [m].

    Args:
        motion: whose.
        most: look at no more frames than about so many, evenly spread; by default all.
    """
    model = build_model(motion.subject)
    data = mujoco.MjData(model)
    sites = [model.site(end_site(body)).id for body in BODY_NAMES]
    every = 1 if most is None else max(1, len(motion) // most)
    heights = np.empty((len(range(0, len(motion), every)), 2))
    for row, qpos in enumerate(motion.qpos[::every]):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        ends = data.site_xpos[sites, 2]
        heights[row] = ends.min(), ends.max()
    return heights


def standing_height(subject: Subject) -> float:
    """From the soles to the top of the head of a body that stands upright [m]."""
    qpos = np.zeros((1, QPOS_SIZE))
    qpos[0, 3:7] = UPRIGHT
    low, high = end_heights(Motion(qpos, 1.0, subject))[0]
    return float(high - low) + 2 * SOLE


def floor_under(heights: Float[ndarray, "frames 2"]) -> float:
    """Height of the floor that the feet stand on when they are lowest [m].

    Args:
        heights: as `end_heights` gives them.
    """
    return float(np.percentile(heights[:, 0], _LOWEST_SHARE)) - SOLE
