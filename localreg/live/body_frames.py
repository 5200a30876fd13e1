"""World poses of all bones of a published pose, quickly: what most sinks translate."""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.model import build_model
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject


class BodyFrames(NamedTuple):
    """World pose of the root and the 30 bones, in the order of `BODY_NAMES`.

    Attributes:
        positions: where each bone starts [m].
        quaternions: turn bone axes into world axes, w x y z.
    """

    positions: Float[ndarray, "31 3"]
    quaternions: Float[ndarray, "31 4"]


class ForwardKinematics:
    """One subject's body, posed by MuJoCo in 5 microseconds.

    Not shared between threads: every sink has its own.

    Args:
        subject: whose proportions.
    """

    def __init__(self, subject: Subject) -> None:
        self._model = build_model(subject)
        self._data = mujoco.MjData(self._model)
        self._bodies = [self._model.body(name).id for name in BODY_NAMES]

    def __call__(self, qpos: Float[ndarray, "63"]) -> BodyFrames:
        """Where the bones are in a pose; the arrays are the caller's."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        return BodyFrames(
            np.array(self._data.xpos[self._bodies]), np.array(self._data.xquat[self._bodies])
        )
