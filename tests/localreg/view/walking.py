"""A body that walks, after a fashion: enough motion to look at, made of nothing."""

import numpy as np

from localreg.body.model import UPRIGHT
from localreg.body.skeleton import DOF_NAMES, QPOS_SIZE
from localreg.body.subject import canonical_subject
from localreg.motion.motion import Motion, Provenance


def walking(seconds: float = 1.0, rate: float = 40.0, name: str = "stroll") -> Motion:
    """Forwards, world -y, at 1 m/s, swinging legs and arms twice a second."""
    frames = round(seconds * rate)
    time = np.arange(frames) / rate
    qpos = np.zeros((frames, QPOS_SIZE))
    qpos[:, 1], qpos[:, 2] = -time, 1.12
    qpos[:, 3:7] = UPRIGHT
    swing = 0.5 * np.sin(2 * np.pi * time)
    for dof, sign in (("lfemurrx", 1), ("rfemurrx", -1), ("lhumerusrx", -1), ("rhumerusrx", 1)):
        qpos[:, 7 + DOF_NAMES.index(dof)] = sign * swing
    for dof, side in (("lhumerusrz", 1), ("rhumerusrz", -1)):
        qpos[:, 7 + DOF_NAMES.index(dof)] = side * 1.1
    return Motion(qpos, rate, canonical_subject(), Provenance(name, activity="walk"))
