"""OpenSim's tables: marker trajectories (TRC) and coordinates over time (MOT).

Both are in OpenSim's ground: x forward, y up, z right. TRC holds joint centres and markers
in millimetres (see `localreg.motion.markers`), MOT the coordinates of
`localreg.motion.anatomical` in degrees and metres, which are those of the model that a
`.osim` file of this program holds.
"""

from pathlib import Path

import numpy as np

from localreg.motion.anatomical import COORDINATES, FORWARD_UP_RIGHT
from localreg.motion.formats.angle_tables import angles_over_time
from localreg.motion.markers import POINTS, points
from localreg.motion.motion import Motion


def write(motion: Motion, path: Path) -> None:
    """Write a motion's markers (TRC) or coordinates (MOT), by the ending."""
    if path.suffix.lower() == ".trc":
        write_trc(motion, path)
    else:
        write_mot(motion, path)


def write_trc(motion: Motion, path: Path) -> None:
    """Write joint centres and markers."""
    world = points(motion)
    y_up = np.stack([world[..., 0], world[..., 2], -world[..., 1]], axis=-1)
    places = 1000.0 * y_up @ FORWARD_UP_RIGHT.T
    rate, frames = f"{motion.rate:.9g}", str(len(motion))
    fields = {
        "DataRate": rate, "CameraRate": rate, "NumFrames": frames,
        "NumMarkers": str(len(POINTS)), "Units": "mm", "OrigDataRate": rate,
        "OrigDataStartFrame": "1", "OrigNumFrames": frames,
    }  # fmt: skip
    axes = [f"{axis}{number}" for number in range(1, len(POINTS) + 1) for axis in "XYZ"]
    row = "%d\t%.9g" + "\t%.4f" * len(axes)
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "\t".join(fields),
        "\t".join(fields.values()),
        "Frame#\tTime\t" + "\t\t\t".join(POINTS) + "\t\t",
        "\t\t" + "\t".join(axes),
        "",
        *(
            row % (frame + 1, frame / motion.rate, *numbers)
            for frame, numbers in enumerate(places.reshape(len(motion), -1).tolist())
        ),
    ]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def write_mot(motion: Motion, path: Path) -> None:
    """Write the coordinates of all joints."""
    numbers = angles_over_time(motion)
    row = "\t".join(["%.9g"] * numbers.shape[1])
    lines = [
        path.stem,
        "version=1",
        f"nRows={len(numbers)}",
        f"nColumns={numbers.shape[1]}",
        "inDegrees=yes",
        "",
        "Units are S.I. units (second, meters, Newtons, ...)",
        "Angles are in degrees.",
        "",
        "endheader",
        "\t".join(("time", *COORDINATES)),
        *(row % tuple(frame) for frame in numbers.tolist()),
    ]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
