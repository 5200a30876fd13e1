"""Small files that say how far a calibration has come, so that a crash costs one pose.

Poses are JSON, motion is an archive of arrays beside it. Both are written to a temporary file
and moved into place, so that each is either the old one or the new one, whole.
"""

import json
import os
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, Final

import numpy as np

from calibration.holds import Hold
from calibration.motion_step import Stretches
from localreg.errors import LocalregError
from sensors.pose import TrackerFrame

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
    _replace(path, lambda file: file.write(json.dumps(document).encode()))


def _replace(path: Path, write: Callable[[IO[bytes]], object]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                write(file)
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


def motion_file(progress: Path) -> Path:
    """Where the motion is kept that belongs to a progress file."""
    return progress.with_suffix(".npz")


def write_motion(progress: Path, stretches: Stretches, trackers: tuple[str, ...]) -> None:
    """Replace the motion that belongs to a progress file.

    Raises:
        LocalregError: it cannot be written.
    """
    frames = [frame for stretch in stretches for frame in stretch]
    sizes = np.array([len(stretch) for stretch in stretches], dtype=int)
    arrays: dict[str, Any] = {
        name: np.array([getattr(frame, name) for frame in frames]) for name in TrackerFrame._fields
    }
    arrays |= {"sizes": sizes, "names": np.array(trackers, dtype=np.str_)}
    _replace(motion_file(progress), lambda file: np.savez(file, **arrays))


def read_motion(progress: Path, trackers: tuple[str, ...]) -> Stretches:
    """The motion of an earlier run; none if there is no file.

    Args:
        progress: the progress file that it belongs to.
        trackers: names that it must agree with.

    Raises:
        LocalregError: the file is damaged or of other trackers.
    """
    path = motion_file(progress)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = [archive[name] for name in TrackerFrame._fields]
            sizes, names = archive["sizes"], tuple(str(name) for name in archive["names"])
        N, J = len(arrays[0]), len(trackers)
        shapes = [(N,), (N, J, 3), (N, J, 4), (N, J), (N, J)]
        is_whole = [array.shape for array in arrays] == shapes and sizes.sum() == N
        if names != trackers or not is_whole or not all(np.isfinite(a).all() for a in arrays):
            raise ValueError(f"it is of {', '.join(names)}")
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise LocalregError(
            f"{path} is no motion of this calibration ({error}); delete it to begin anew"
        ) from error
    rows = zip(*arrays, strict=True)
    frames = [TrackerFrame(float(t), p, q, *masks) for t, p, q, *masks in rows]
    ends = np.cumsum(sizes).tolist()
    return tuple(tuple(frames[end - size : end]) for end, size in zip(ends, sizes, strict=True))


def forget(progress: Path) -> None:
    """Delete a progress file and its motion."""
    progress.unlink(missing_ok=True)
    motion_file(progress).unlink(missing_ok=True)
