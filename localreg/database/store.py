"""The pose database: joint angles and roots of many clips, on disk and mapped into memory.

Every pose is stored once. Segments (a pose with its predecessors) are formed when they
are asked for and never cross a clip's ends. Leaving a clip out leaves out its mirror
image and every copy of the same recording.
"""

import difflib
import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT, DOF_NAMES
from localreg.body.subject import Subject
from localreg.database.clips import Clip, merged_groups
from localreg.database.duplicates import DuplicateFinder, common_clips, fingerprints
from localreg.database.files import identity_of, read_folder, write_folder
from localreg.errors import DatabaseError
from localreg.motion.motion import Motion

DEFAULT_RATE: Final = 40.0
"""Rate of the poses unless told otherwise [Hz]."""


def prepare(motion: Motion, rate: float) -> Motion:
    """A motion as a database of that rate stores it."""
    return motion.resampled(rate).nearest_to_rest() if len(motion) else motion


@dataclass(frozen=True, eq=False)
class PoseDatabase:
    """Poses of many clips at one rate.

    Attributes:
        angles: joint angles in the order of `DOF_NAMES` [rad].
        roots: root position [m] and quaternion w x y z.
        clip_index: for every pose the index of its clip in `clips`.
        clips: the clip table, in the order of the poses.
        offsets: the skeletons of the clips: vectors from start to end of the bones [m].
        axis_frames: the skeletons of the clips: axis frames of the bones.
        rate: poses a second [Hz].
        settings: how it was made.
        skipped: names of motions without a frame, which were left out.
        identity: what tells a loaded database from any other; empty if it was not loaded.
    """

    angles: Float32[ndarray, "poses 56"]
    roots: Float32[ndarray, "poses 7"]
    clip_index: Int32[ndarray, " poses"]
    clips: tuple[Clip, ...]
    offsets: Float[ndarray, "skeletons 30 3"]
    axis_frames: Float[ndarray, "skeletons 30 3 3"]
    rate: float
    settings: dict[str, Any]
    skipped: tuple[str, ...] = ()
    identity: str = ""

    @classmethod
    def build(
        cls,
        motions: Iterable[Motion],
        *,
        rate: float = DEFAULT_RATE,
        mirror: bool = True,
        prepared: bool = False,
    ) -> Self:
        """A database in memory; motions are read one at a time.

        Args:
            motions: the clips; each is resampled to `rate`.
            rate: poses a second [Hz].
            mirror: whether to add the mirror image of every clip that is not one itself.
            prepared: whether motions have been through `prepare` with this rate.

        Raises:
            DatabaseError: there is not one pose, or the rate is none.
        """
        if not (np.isfinite(rate) and rate > 0):
            raise DatabaseError(f"a database at {rate} Hz cannot be; give a positive rate")
        builder = _Builder(rate)
        for motion in motions:
            builder.add(motion if prepared else prepare(motion, rate), mirror=mirror)
        if not builder.clips:
            raise DatabaseError("no motion to build a database from; give files or folders of them")
        settings = {"rate": rate, "mirror": mirror, "program": _program_version()}
        return cls(
            angles=builder.angles.array,
            roots=builder.roots.array,
            clip_index=np.repeat(
                np.arange(len(builder.clips), dtype=np.int32), [c.length for c in builder.clips]
            ),
            clips=builder.grouped_clips(),
            offsets=np.stack([s.offsets for s in builder.skeletons]),
            axis_frames=np.stack([s.axis_frames for s in builder.skeletons]),
            rate=rate,
            settings=settings,
            skipped=tuple(builder.skipped),
        )

    def save(self, folder: Path) -> None:
        """Write the database; an older one there is replaced only when this is complete.

        Raises:
            DatabaseError: the folder holds something else, or the disk refuses.
        """
        document = {
            "rate": self.rate,
            "settings": self.settings,
            "dofs": list(DOF_NAMES),
            "clips": [clip.to_json() for clip in self.clips],
            "skipped": list(self.skipped),
        }
        arrays = {
            "angles": self.angles,
            "roots": self.roots,
            "clip_index": self.clip_index,
            "offsets": self.offsets,
            "axis_frames": self.axis_frames,
        }
        write_folder(Path(folder), document, arrays)

    @classmethod
    def load(cls, folder: Path, *, verify: bool | None = None) -> Self:
        """Open a saved database; its arrays are mapped into memory, not read.

        Args:
            folder: where it was saved.
            verify: whether to verify checksums; by default only when that takes no time.

        Raises:
            DatabaseError: the folder is missing, foreign, damaged or of another version.
        """
        folder = Path(folder)
        document, arrays = read_folder(folder, verify=verify)
        try:
            if document["dofs"] != list(DOF_NAMES):
                raise DatabaseError(f"the database {folder} is of another skeleton; build it again")
            clips = tuple(Clip.from_json(entry) for entry in document["clips"])
            database = cls(
                clips=clips,
                rate=float(document["rate"]),
                settings=dict(document["settings"]),
                skipped=tuple(document["skipped"]),
                identity=identity_of(folder),
                **arrays,
            )
        except (KeyError, TypeError, ValueError) as error:
            raise DatabaseError(
                f"the database {folder} is damaged: its manifest lacks or garbles {error}; "
                "build it again"
            ) from error
        database._check(folder)
        return database

    def __len__(self) -> int:
        return len(self.angles)

    @property
    def seconds(self) -> float:
        """Duration of all clips together [s]."""
        return len(self) / self.rate

    def window_targets(self, predecessors: int) -> Int[ndarray, " targets"]:
        """Indices of the poses with so many predecessors in the same clip, ascending."""
        position = np.arange(len(self)) - self._starts[self.clip_index]
        return np.flatnonzero(position >= predecessors)

    def histories(
        self, targets: Int[ndarray, " targets"], predecessors: int
    ) -> Float32[ndarray, "targets predecessors 56"]:
        """The joint angles before each target, newest first [rad].

        Args:
            targets: indices from `window_targets`.
            predecessors: how many poses of history.
        """
        return self.angles[targets[:, None] - np.arange(1, predecessors + 1)]

    def exclude(
        self, *, clip: str | None = None, subject: str | None = None, activity: str | None = None
    ) -> Bool[ndarray, " poses"]:
        """The poses that remain when a clip, a person or an activity is left out.

        What matches any of the arguments goes, and with it every clip of its group: mirror
        images, the same trial in other files, copies found by content.

        Returns:
            A mask, true for poses that may be used.

        Raises:
            DatabaseError: nothing in the database matches an argument.
        """
        gone: set[int] = set()
        for field, value in (("name", clip), ("subject", subject), ("activity", activity)):
            if value is None:
                continue
            groups = {c.group for c in self.clips if getattr(c, field) == value}
            if not groups:
                raise DatabaseError(self._no_such(field, value))
            gone |= groups
        return self._without(gone)

    def exclude_motion(self, motion: Motion) -> Bool[ndarray, " poses"]:
        """The poses that remain when every copy of a motion is left out.

        Copies are clips of the same trial, of the same name and file, or with a run of
        half a second or more in common, mirrored or not. The motion itself need not be in
        the database.

        Returns:
            A mask, true for poses that may be used.
        """
        made = motion.provenance
        groups = {
            clip.group
            for clip in self.clips
            if (made.trial and clip.trial == made.trial)
            or (made.name == clip.name and made.source == clip.source)
        }
        finder, clips = self._finder
        resampled = motion.resampled(self.rate)
        prints = fingerprints(resampled.angles, motion.subject.axis_frames)
        groups |= {clips[number].group for number in finder.clips_like(prints)}
        return self._without(groups)

    @cached_property
    def _starts(self) -> Int[ndarray, " clips"]:
        return np.array([clip.start for clip in self.clips])

    @cached_property
    def _finder(self) -> tuple[DuplicateFinder, list[Clip]]:
        """Finds copies among the clips that were read; mirror images need no second look."""
        clips = [clip for clip in self.clips if clip.image_of < 0]
        prints = [
            fingerprints(
                np.asarray(self.angles[c.start : c.stop], dtype=float), self.axis_frames[c.skeleton]
            )
            for c in clips
        ]
        numbers = np.repeat(np.arange(len(clips)), [c.length for c in clips])
        return DuplicateFinder(np.concatenate(prints), numbers, self.rate), clips

    def _without(self, groups: set[int]) -> Bool[ndarray, " poses"]:
        remains = np.array([clip.group not in groups for clip in self.clips])
        return remains[self.clip_index]

    def _no_such(self, field: str, value: str) -> str:
        known = sorted({getattr(clip, field) for clip in self.clips} - {""})
        near = difflib.get_close_matches(value, known, n=5) or known[:10]
        what = "clip" if field == "name" else field
        hint = f"such as {', '.join(near)}" if near else "none of its clips names one"
        return f"the database has no {what} {value!r}; it has {len(known)}: {hint}"

    def _check(self, folder: Path) -> None:
        """Refuse a clip table that does not fit the arrays."""
        lengths = np.array([clip.length for clip in self.clips], dtype=int)
        starts = np.concatenate([[0], np.cumsum(lengths)])
        expected = np.repeat(np.arange(len(lengths)), lengths)
        n = len(expected)
        shapes = {
            "angles": (self.angles, (n, DOF_COUNT), np.float32),
            "roots": (self.roots, (n, 7), np.float32),
            "clip_index": (self.clip_index, (n,), np.int32),
        }
        wrong = [
            name
            for name, (array, shape, kind) in shapes.items()
            if array.shape != shape or array.dtype != kind
        ]
        if not wrong and not np.array_equal(self.clip_index, expected):
            wrong = ["clip_index"]
        if not np.array_equal(starts[:-1], [clip.start for clip in self.clips]):
            wrong.append("the starts of the clips")
        if any(not 0 <= clip.skeleton < len(self.offsets) for clip in self.clips):
            wrong.append("the skeletons of the clips")
        if wrong or not n:
            raise DatabaseError(
                f"the database {folder} is damaged: its clip table does not fit "
                f"{', '.join(wrong) or 'an empty database'}; build it again"
            )


class _Growing:
    """Rows that are appended a clip at a time; grows by a quarter, in place if it can be."""

    def __init__(self, width: int) -> None:
        self._rows = np.empty((4096, width), dtype=np.float32)
        self._count = 0

    def extend(self, rows: Float[ndarray, "rows width"]) -> int:
        """Append rows; returns the index of the first."""
        start, stop = self._count, self._count + len(rows)
        if stop > len(self._rows):
            # Nobody holds a view before `array` is asked for, so moving it is safe.
            self._rows.resize((max(stop, len(self._rows) * 5 // 4), rows.shape[1]), refcheck=False)
        self._rows[start:stop] = rows
        self._count = stop
        return start

    @property
    def array(self) -> Float32[ndarray, "rows width"]:
        return self._rows[: self._count]


class _Builder:
    """Gathers clips, and what tells which of them belong together."""

    def __init__(self, rate: float) -> None:
        self.rate = rate
        self.angles, self.roots = _Growing(DOF_COUNT), _Growing(7)
        self.clips: list[Clip] = []
        self.skeletons: list[Subject] = []
        self.skipped: list[str] = []
        self._read: list[int] = []
        self._prints: list[Float32[ndarray, "_ 36"]] = []
        self._digests: list[bytes] = []

    def add(self, motion: Motion, *, mirror: bool) -> None:
        """Add a motion and, if wanted, its mirror image."""
        if not len(motion):
            self.skipped.append(motion.provenance.name)
            return
        group = self.clips[-1].group + 1 if self.clips else 0
        index = len(self.clips)
        self._read.append(index)
        self._prints.append(fingerprints(motion.angles, motion.subject.axis_frames))
        self._digests.append(hashlib.blake2b(np.float32(motion.angles).tobytes()).digest())
        self._append(motion, group, -1)
        if mirror and not motion.provenance.mirrored:
            self._append(motion.mirrored(), group, index)

    def grouped_clips(self) -> tuple[Clip, ...]:
        """The clip table with copies of the same recording in one group."""
        pairs = {(self._read[a], self._read[b]) for a, b in common_clips(self._prints, self.rate)}
        first_of: dict[object, int] = {}
        for index, clip in enumerate(self.clips):
            if clip.trial:
                pairs.add((first_of.setdefault(clip.trial, index), index))
        for index, digest in zip(self._read, self._digests, strict=True):
            pairs.add((first_of.setdefault(digest, index), index))
        groups = merged_groups([clip.group for clip in self.clips], sorted(pairs))
        return tuple(
            replace(clip, group=group) for clip, group in zip(self.clips, groups, strict=True)
        )

    def _append(self, motion: Motion, group: int, image_of: int) -> None:
        start = self.angles.extend(motion.angles)
        self.roots.extend(motion.qpos[:, :7])
        skeleton = self._skeleton(motion.subject)
        self.clips.append(
            Clip.of(motion, start=start, skeleton=skeleton, group=group, image_of=image_of)
        )

    def _skeleton(self, subject: Subject) -> int:
        for index, known in enumerate(self.skeletons):
            if known is subject or known.same_proportions(subject):
                return index
        self.skeletons.append(subject)
        return len(self.skeletons) - 1


def _program_version() -> str:
    try:
        return version("localreg-mocap")
    except PackageNotFoundError:  # run from a source folder
        return "unknown"
