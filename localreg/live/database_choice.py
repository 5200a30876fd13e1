"""Which poses a run learns from, and a name for exactly these poses."""

import hashlib
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from localreg.body.subject import Subject, canonical_subject
from localreg.database.files import MANIFEST
from localreg.database.store import PoseDatabase
from localreg.errors import DatabaseError
from localreg.motion.motion import Motion

_SAMPLE: Final = "sample"
_ARRAYS: Final = ("angles", "roots", "clip_index", "offsets", "axis_frames")


@dataclass(frozen=True, eq=False)
class ChosenDatabase:
    """A database, and what a recording says of it.

    Attributes:
        poses: the database.
        identity: checksum of all its poses; equal wherever they are stored.
        source: the folder, or `"sample"`.
        subject: whose proportions to assume where nobody says.
    """

    poses: PoseDatabase
    identity: str
    source: str
    subject: Subject


def choose_database(
    folder: Path | None, tell: Callable[[str], None] = lambda _: None
) -> ChosenDatabase:
    """The database of a folder, or that of the sample set.

    Args:
        folder: a database; None for the sample set, which is built anew in a second.
        tell: is told what takes long.

    Raises:
        DatabaseError: the folder is no database.
        MotionError: the sample set is not installed.
    """
    if folder is not None:
        poses = PoseDatabase.load(folder)
        return ChosenDatabase(poses, _of_folder(folder), str(folder), canonical_subject())
    tell("building the database of the sample set")
    motions = _sample()
    poses = PoseDatabase.build(motions)
    return ChosenDatabase(poses, identity(poses), _SAMPLE, motions[0].subject)


def sample_clips(names: tuple[str, ...]) -> list[Motion]:
    """Clips of the sample set by name; all of them if none is named.

    Raises:
        DatabaseError: there is no clip of a name.
    """
    motions = _sample()
    by_name = {motion.provenance.name: motion for motion in motions}
    unknown = [name for name in names if name not in by_name]
    if unknown:
        raise DatabaseError(
            f"the sample set has no clip {', '.join(unknown)}; there are {', '.join(by_name)}"
        )
    return [by_name[name] for name in names] if names else motions


def _sample() -> list[Motion]:
    # A run on a database of one's own reads no motion files.
    from localreg.motion.sources import read_sources

    return read_sources([_SAMPLE])[0]


def identity(poses: PoseDatabase) -> str:
    """The checksum of a database in memory; that of its folder is the same."""
    checksums = {}
    for name in _ARRAYS:
        file = io.BytesIO()
        np.save(file, getattr(poses, name), allow_pickle=False)
        checksums[name] = hashlib.blake2b(file.getbuffer(), digest_size=32).hexdigest()
    return _combined(checksums)


def _of_folder(folder: Path) -> str:
    """The same from the checksums of a manifest, which loading has verified."""
    arrays = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["arrays"]
    try:
        return _combined({name: arrays[name]["blake2b"] for name in _ARRAYS})
    except KeyError as error:
        raise DatabaseError(f"the manifest of {folder} lacks {error}; build it again") from None


def _combined(checksums: dict[str, str]) -> str:
    text = json.dumps(checksums, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
