"""Parts of a take."""

from dataclasses import replace

import numpy as np

from localreg.errors import MotionError
from localreg.motion.motion import Motion


def trimmed(motion: Motion, start: float | None = None, end: float | None = None) -> Motion:
    """The frames of a motion between two times, both included.

    Args:
        motion: the motion.
        start: from when [s]; its beginning by default.
        end: until when [s]; its end by default.

    Raises:
        MotionError: no frame is left.
    """
    times = np.arange(len(motion)) / motion.rate
    spare = 1e-6 / motion.rate  # a time written in decimals may be a hair off a frame's
    kept = np.ones(len(motion), dtype=bool)
    if start is not None:
        kept &= times >= start - spare
    if end is not None:
        kept &= times <= end + spare
    if not kept.any():
        first, last = start or 0.0, motion.seconds if end is None else end
        raise MotionError(
            f"motion {motion.provenance.name} has no frame from {first:g} to {last:g} s; "
            f"it lasts {motion.seconds:.3g} s"
        )
    return replace(motion, qpos=motion.qpos[kept])
