"""Joint angles as tables: CSV, Parquet and data frames.

One row a frame: `time` [s], the pelvis' turns [deg] and place [m], then three angles of
every joint [deg], under the names and signs of `localreg.motion.anatomical`, and 1 or 0 for
the ball and the toes of each foot, standing or not (`localreg.motion.contacts`). A CSV file says
so in its first lines, which begin with `#` (pandas reads it with `comment="#"`), a Parquet
file in its metadata and a data frame in its `attrs`. Bone lengths are not in these files:
reading angles back takes the subject they belong to.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.errors import MotionError
from localreg.motion.anatomical import COORDINATES, LENGTHS, coordinates
from localreg.motion.body_poses import body_points
from localreg.motion.contacts import FOOT_BODIES, foot_contacts
from localreg.motion.motion import Motion

if TYPE_CHECKING:
    import pandas as pd

CONTACTS: Final = tuple(f"contact_{bone[1:]}_{bone[0]}" for bone in FOOT_BODIES)
"""Names of the columns that say which parts of the feet stand: 1 or 0."""

COLUMNS: Final = ("time", *COORDINATES, *CONTACTS)
"""Names of the columns."""

DESCRIPTION: Final = (
    "Joint angles in degrees; time in seconds; pelvis_tx, pelvis_ty, pelvis_tz in metres.",
    "Axes: x forward, y up, z right; all angles are zero in the anatomical position.",
    "Every joint turns by Rz(first) Rx(second) Ry(third) of its three columns against its parent.",
    "Positive: flexion (ankle and toes: upwards), adduction, inward rotation; pronation; bending",
    "of the wrist to the little finger; raising and pulling forward of the collar bone; for the",
    "trunk, neck and head extension, bending to the right, turning to the left.",
    "contact_*: 1 where the ball (foot) or the tip (toes) of a foot stands on the ground.",
)
"""What the columns mean, line by line."""


def values(motion: Motion) -> Float[ndarray, "frames columns"]:
    """The numbers of all `COLUMNS`, frame by frame [s, deg, m]."""
    _, ends = body_points(motion.qpos, motion.subject)
    return np.hstack([angles_over_time(motion), foot_contacts(ends, motion.rate)])


def angles_over_time(motion: Motion) -> Float[ndarray, "frames columns"]:
    """Time and all `COORDINATES`, frame by frame [s, deg, m]."""
    angles = coordinates(motion.qpos, motion.subject)
    turning = [name not in LENGTHS for name in COORDINATES]
    angles[:, turning] = np.degrees(angles[:, turning])
    return np.column_stack([np.arange(len(motion)) / motion.rate, angles])


def data_frame(motion: Motion) -> "pd.DataFrame":
    """The motion's joint angles as a data frame; see `Motion.to_dataframe`."""
    try:
        import pandas as pd
    except ImportError as error:
        raise _missing("pandas") from error
    frame = pd.DataFrame(values(motion), columns=list(COLUMNS))
    frame = frame.astype(dict.fromkeys(CONTACTS, "int8"))
    frame.attrs = {**about(motion)}
    return frame


def about(motion: Motion) -> dict[str, str]:
    """What a table's columns mean and where its motion came from."""
    made = motion.provenance
    return {
        "columns": " ".join(DESCRIPTION),
        "name": made.name,
        "subject": made.subject or motion.subject.name,
        "activity": made.activity,
        "rate_hz": f"{motion.rate:.12g}",
    }


def write(motion: Motion, path: Path) -> None:
    """Write a motion's joint angles as CSV or Parquet, by the ending."""
    if path.suffix.lower() == ".parquet":
        _write_parquet(motion, path)
        return
    told = about(motion)
    head = [*DESCRIPTION, *(f"{key}: {told[key]}" for key in told if key != "columns")]
    row = ",".join(["%.9g"] * len(COLUMNS))
    lines = [
        *("# " + " ".join(line.split()) for line in head),
        ",".join(COLUMNS),
        *(row % tuple(frame) for frame in values(motion).tolist()),
    ]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _write_parquet(motion: Motion, path: Path) -> None:
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError as error:
        raise _missing("pyarrow") from error
    numbers = values(motion)
    columns = dict(zip(COLUMNS, numbers.T, strict=True))
    columns |= {name: columns[name].astype(np.int8) for name in CONTACTS}
    table = pa.table(columns)
    pq.write_table(table.replace_schema_metadata(about(motion)), path, compression="zstd")


def _missing(package: str) -> MotionError:
    return MotionError(
        f"tables need {package}, which is not installed; install localreg-mocap[tables]"
    )
