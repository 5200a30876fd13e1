"""What is done in a recording: from an index of CMU's trials, or from the folder's name."""

import csv
from functools import lru_cache
from pathlib import Path
from typing import Final

from localreg.errors import MotionError
from localreg.motion.ids import normal_trial

INDEX_NAME: Final = "cmu-index.tsv"
"""File name of an index: tab separated, with columns subject, trial, description."""

_COLUMNS: Final = ("subject", "trial", "description")
_MAX_CLIMB: Final = 6

# Folders that sort files by kind or person, not by what is done in them.
_NOT_ACTIVITIES: Final = frozenset({
    "all", "amc", "asf", "bvh", "clips", "cmu", "cmu-bvh", "data", "inferred", "mocap", "motion",
    "motions", "subjects",
})  # fmt: skip


def activity_of(path: Path, trial: str, root: Path, skeleton: str = "") -> str:
    """What is done in a recording; empty if nothing tells.

    An index in the file's folder or above it tells it for CMU's trials. Otherwise it is
    the name of the folder, if that lies below the source's folder or the file is named
    after it, and sorts files by what is done in them.

    Args:
        path: the motion file.
        trial: normal form of the recording's id.
        root: the source's folder, in which `path` lies.
        skeleton: name of the skeleton; a folder named after it is a person's.
    """
    index = _find_index(path.parent.resolve())
    if index is not None and (activity := read_index(index).get(trial)):
        return activity
    folder = path.resolve().parent.name
    named = path.stem.lower().startswith(folder.lower() + "_")
    below = path.parent.resolve() != root.resolve()
    sorts = folder[:1].isalpha() and folder.lower() not in _NOT_ACTIVITIES and folder != skeleton
    return folder if sorts and (named or below) else ""


@lru_cache(maxsize=16)
def read_index(path: Path) -> dict[str, str]:
    """Descriptions of trials by their normal form.

    Raises:
        MotionError: the file is not such an index; names the line.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file, delimiter="\t", quoting=csv.QUOTE_NONE))
    except (OSError, UnicodeDecodeError) as error:
        raise MotionError(f"cannot read the index {path}: {error}; mend or remove it") from error
    if not rows or tuple(rows[0][:3]) != _COLUMNS:
        raise MotionError(f"{path}, line 1: the columns must be {', '.join(_COLUMNS)}")
    descriptions = {}
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) < 2:
            raise MotionError(f"{path}, line {line}: expected {len(_COLUMNS)} columns; mend it")
        descriptions[normal_trial(f"{row[0]}_{row[1]}")] = row[2].strip() if len(row) > 2 else ""
    return descriptions


def _find_index(folder: Path) -> Path | None:
    for place in (folder, *folder.parents[:_MAX_CLIMB]):
        if (place / INDEX_NAME).is_file():
            return place / INDEX_NAME
    return None
