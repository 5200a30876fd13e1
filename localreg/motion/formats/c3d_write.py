"""C3D files of joint centres and markers, as optical systems record them (extra `c3d`).

When feet come down and leave the ground is said by events, `Foot Strike` and `Foot Off`.

Points are those of `localreg.motion.markers`, in millimetres, in our world: z up, the
laboratory's usual way, which the file says (`POINT:X_SCREEN`, `POINT:Y_SCREEN`).
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from localreg.errors import MotionError
from localreg.motion.body_poses import body_points
from localreg.motion.contacts import runs, settled_contacts
from localreg.motion.markers import JOINT_CENTRES, PLUG_IN_GAIT, POINTS, points
from localreg.motion.motion import Motion

if TYPE_CHECKING:
    import ezc3d

_BYTES: Final = 16  # of one point in one frame: x, y, z and the residual
_MOST_FRAMES: Final = 65_535  # readers take the count from 16 bits
_MOST_EVENTS: Final = 255  # in one parameter, whose dimensions are bytes
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
    _add_events(file, motion)
    file["data"]["points"] = np.concatenate(
        [places.transpose(2, 1, 0), np.ones((1, len(POINTS), len(motion)))]
    )
    file.write(str(path))
    # The library does not say when the disk is full.
    if path.stat().st_size < _BYTES * len(POINTS) * len(motion):
        raise OSError("the disk did not take the whole file")


def _add_events(file: "ezc3d.c3d", motion: Motion) -> None:
    """Add an event for every time that a foot comes down or leaves the ground."""
    _, ends = body_points(motion.qpos, motion.subject)
    contacts = settled_contacts(ends, motion.rate)
    events = []
    for context, columns in (("Left", contacts[:, :2]), ("Right", contacts[:, 2:])):
        for first, last in runs(columns[:, 0] | columns[:, 1]):
            if first > 0:
                events.append((first / motion.rate, context, "Foot Strike"))
            if last < len(motion):
                events.append((last / motion.rate, context, "Foot Off"))
    events.sort()
    file.add_parameter("EVENT", "USED", [len(events)])
    for start in range(0, len(events), _MOST_EVENTS):
        # Longer lists go on in parameters with a number behind their names.
        number = "" if start == 0 else str(start // _MOST_EVENTS + 1)
        times, contexts, labels = zip(*events[start : start + _MOST_EVENTS], strict=True)
        file.add_parameter("EVENT", f"CONTEXTS{number}", list(contexts))
        file.add_parameter("EVENT", f"LABELS{number}", list(labels))
        minutes = np.floor_divide(times, 60.0)
        seconds = np.array(times) - 60.0 * minutes
        file.add_parameter("EVENT", f"TIMES{number}", np.stack([minutes, seconds]))
