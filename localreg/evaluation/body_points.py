"""Where bone ends and trackers are, for whole motions: MuJoCo's kinematics, not ours.

Estimators move the body by the kinematics in `localreg.body.kinematics`; what judges them
uses another implementation. It also needs no compilation, of which clips of many lengths
would need many.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.model import build_model, end_site, tracker_site
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject


class TrackerPoses(NamedTuple):
    """World poses of a subject's trackers.

    Attributes:
        positions: tracker origins [m].
        quaternions: turn tracker axes into world axes, w x y z.
    """

    positions: Float[ndarray, "frames trackers 3"]
    quaternions: Float[ndarray, "frames trackers 4"]


class Places(NamedTuple):
    """Where a motion puts a body and its trackers in the world.

    Attributes:
        bone_ends: the root and the far ends of the 30 bones [m].
        trackers: what they would report if they were perfect.
    """

    bone_ends: Float[ndarray, "frames 31 3"]
    trackers: TrackerPoses


class BodyPoints:
    """One subject's body, posed frame by frame.

    Args:
        subject: whose proportions and trackers.
    """

    def __init__(self, subject: Subject) -> None:
        self.subject = subject
        self._model = build_model(subject)
        self._data = mujoco.MjData(self._model)
        self._ends = [self._model.site(end_site(name)).id for name in BODY_NAMES]
        self._trackers = [self._model.site(tracker_site(name)).id for name in subject.trackers]

    def bone_ends(self, qpos: Float[ndarray, "frames 63"]) -> Float[ndarray, "frames 31 3"]:
        """World positions of the root and of the far ends of the 30 bones [m]."""
        return self.places(qpos).bone_ends

    def tracker_poses(self, qpos: Float[ndarray, "frames 63"]) -> TrackerPoses:
        """World poses that the trackers would report if they were perfect."""
        return self.places(qpos).trackers

    def places(self, qpos: Float[ndarray, "frames 63"]) -> Places:
        """Both at once."""
        data, sites = self._data, self._model.nsite
        positions, matrices = np.empty((len(qpos), sites, 3)), np.empty((len(qpos), sites, 9))
        for frame, pose in enumerate(qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(self._model, data)
            positions[frame], matrices[frame] = data.site_xpos, data.site_xmat
        flat = matrices[:, self._trackers].reshape(-1, 3, 3)
        quaternions = Rotation.from_matrix(flat).as_quat(canonical=True, scalar_first=True)
        trackers = TrackerPoses(
            positions[:, self._trackers], quaternions.reshape(len(qpos), len(self._trackers), 4)
        )
        return Places(positions[:, self._ends], trackers)
