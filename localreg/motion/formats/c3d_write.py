"""C3D files of joint centres and markers, as optical systems record them (extra `c3d`).

Points are those of `localreg.motion.markers`, in millimetres, in our world: z up, the
laboratory's usual way, which the file says (`POINT:X_SCREEN`, `POINT:Y_SCREEN`).
"""

from pathlib import Path
from typing import Final

import numpy as np

from localreg.errors import MotionError
from localreg.motion.markers import JOINT_CENTRES, PLUG_IN_GAIT, POINTS, points
from localreg.motion.motion import Motion

_BYTES: Final = 16  # of one point in one frame: x, y, z and the residual
_MOST_FRAMES: Final = 65_535  # readers take the count from 16 bits
_DESCRIBED: Final = ("joint centre",) * len(JOINT_CENTRES) + ("marker on the body model",) * len(
    PLUG_IN_GAIT
)


def write(motion: Motion, path: Path) -> None:
    """Write a motion's joint centres and markers as a C3D file.

    Raises:
        MotionError: ezc3d is not installed, or C3D cannot count the frames.
        OSError: the disk did not take the file.
    """
    try:
        import ezc3d
    except ImportError as error:
        raise MotionError(
            "C3D files need ezc3d, which is not installed; install localreg-mocap[c3d]"
        ) from error
    if len(motion) > _MOST_FRAMES:
        raise MotionError(
            f"motion {motion.provenance.name} has {len(motion)} frames, of which C3D can hold "
            f"{_MOST_FRAMES}; cut it or lower its rate"
        )
    places = 1000.0 * points(motion)
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    point["RATE"]["value"] = [motion.rate]
    point["LABELS"]["value"] = list(POINTS)
    point["DESCRIPTIONS"]["value"] = list(_DESCRIBED)
    point["UNITS"]["value"] = ["mm"]
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", ["+Z"])
    file.add_parameter("SUBJECTS", "NAMES", [motion.subject.name])
    file.add_parameter("MANUFACTURER", "SOFTWARE", ["localreg"])
    file["data"]["points"] = np.concatenate(
        [places.transpose(2, 1, 0), np.ones((1, len(POINTS), len(motion)))]
    )
    file.write(str(path))
    # The library does not say when the disk is full.
    if path.stat().st_size < _BYTES * len(POINTS) * len(motion):
        raise OSError("the disk did not take the whole file")
