"""The clip table of a pose database: what each run of poses is and what it belongs with."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

from localreg.motion.motion import Motion


@dataclass(frozen=True, slots=True)
class Clip:
    """One run of consecutive poses.

    Attributes:
        name: short name of the motion; the mirror image of `"02_01"` is `"02_01-mirrored"`.
        subject: id of the person; empty if unknown.
        trial: id of the recording; empty if unknown.
        activity: what is done; empty if unknown.
        source: the file it came from.
        mirrored: whether left and right are exchanged.
        start: index of its first pose in the database.
        length: number of its poses.
        skeleton: index into the database's skeletons.
        group: clips of one group hold the same recording or parts of it: a clip, its
            mirror image, others of the same trial, others found equal by content.
        image_of: index of the clip whose mirror image this is, made by the database; -1
            for a clip that was read.
    """

    name: str
    subject: str
    trial: str
    activity: str
    source: str
    mirrored: bool
    start: int
    length: int
    skeleton: int
    group: int
    image_of: int = -1

    @property
    def stop(self) -> int:
        """Index after its last pose."""
        return self.start + self.length

    @classmethod
    def of(
        cls, motion: Motion, *, start: int, skeleton: int, group: int, image_of: int = -1
    ) -> Self:
        """The entry for a motion whose first pose goes to index `start`."""
        made = motion.provenance
        return cls(
            made.name, made.subject, made.trial, made.activity, made.source, made.mirrored,
            start, len(motion), skeleton, group, image_of,
        )  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """A dictionary of plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, entry: dict[str, Any]) -> Self:
        """The clip of a dictionary made by `to_json`.

        Raises:
            TypeError: a field is missing, unknown or of another type.
        """
        for field, kind in cls.__annotations__.items():
            if type(entry.get(field)) is not kind:
                raise TypeError(f"clip field {field!r}, which is no {kind.__name__}")
        return cls(**entry)


def merged_groups(groups: Sequence[int], pairs: Iterable[tuple[int, int]]) -> list[int]:
    """Group numbers, from 0 in order of appearance, after joining pairs of entries.

    Args:
        groups: a group number for each entry; equal numbers are already together.
        pairs: indices of entries that belong together.
    """
    leader = {group: group for group in groups}

    def find(group: int) -> int:
        while leader[group] != group:
            leader[group] = leader[leader[group]]
            group = leader[group]
        return group

    for a, b in pairs:
        leader[find(groups[a])] = find(groups[b])
    numbers: dict[int, int] = {}
    return [numbers.setdefault(find(group), len(numbers)) for group in groups]
