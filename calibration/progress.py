"""A small file that says how far a calibration has come, so that a crash costs one pose.

JSON, written to a temporary file beside it and moved into place, so that it is either the
old one or the new one, whole.
"""

import json
import os
import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from calibration.holds import Hold
from localreg.errors import LocalregError

_VERSION: Final = 1
_ARRAYS: Final = {
    "positions": (3,), "quaternions": (4,), "position_covariances": (3, 3),
    "orientation_covariances": (3, 3), "position_mask": (), "orientation_mask": (),
}  # fmt: skip


def write_progress(path: Path, holds: tuple[Hold, ...], trackers: tuple[str, ...]) -> None:
    """Replace the progress file.

    Raises:
        LocalregError: it cannot be written.
    """
    document = {
        "version": _VERSION,
        "trackers": list(trackers),
        "holds": [
            {
                "pose": hold.pose,
                "frames": hold.frames,
                "sway": hold.sway,
                **{name: getattr(hold, name).tolist() for name in _ARRAYS},
            }
            for hold in holds
        ],
    }
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                json.dump(document, file)
                file.flush()
                os.fsync(file.fileno())
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write the progress file {path}: {reason}") from error


def read_progress(path: Path, trackers: tuple[str, ...]) -> dict[str, Hold]:
    """The holds of an earlier run by pose; none if there is no file.

    Args:
        path: the progress file.
        trackers: names that the file must agree with.

    Raises:
        LocalregError: the file is damaged or of other trackers.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise LocalregError(f"cannot read {path}: {error}; delete it to begin anew") from error
    try:
        document = json.loads(text)
        if document["version"] != _VERSION:
            raise ValueError(f"version {document['version']}")
        if tuple(document["trackers"]) != trackers:
            raise LocalregError(
                f"{path} is of trackers {', '.join(document['trackers'])}, not of "
                f"{', '.join(trackers)}; delete it to begin anew"
            )
        holds = [_hold(entry, len(trackers)) for entry in document["holds"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise LocalregError(
            f"{path} is no progress file of a calibration ({error}); delete it to begin anew"
        ) from error
    return {hold.pose: hold for hold in holds}


def _hold(entry: dict[str, Any], count: int) -> Hold:
    arrays = {}
    for name, shape in _ARRAYS.items():
        kind = bool if name.endswith("mask") else float
        array = np.array(entry[name], dtype=kind)
        if array.shape != (count, *shape) or not np.isfinite(array).all():
            raise ValueError(f"{name} of pose {entry['pose']}")
        arrays[name] = array
    return Hold(
        pose=str(entry["pose"]), frames=int(entry["frames"]), sway=float(entry["sway"]), **arrays
    )
