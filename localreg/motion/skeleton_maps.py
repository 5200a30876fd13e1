"""Which joint of a foreign skeleton starts which of our bones, told by its names.

A skeleton map is a TOML file, one for every family of names, in the folder `skeletons`
beside this module; people can write their own:

    name = "Mixamo"
    sides = ["Left", "Right"]       # what {side} stands for; {initial} is its first letter
    root = "Hips"
    spine = ["Spine", "Spine1"]     # from the root upwards, as many as there are
    neck = ["Neck"]
    head = "Head"
    [limbs]                         # the joint at which each bone begins
    femur = "{side}UpLeg"
    hand = ["{side}Hand", "{side}Wrist"]    # the first of these that the file has
    [ends]                          # the point at which a last bone ends
    toes = "{side}ToeBase end"      # of a joint without children: its end site

Case, spaces, dots, dashes and underscores do not count, nor does a namespace or a prefix
that the root's name has (`mixamorig:Hips`, `Bip01 Pelvis`).
"""

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Final, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from localreg.errors import MotionError
from localreg.motion.joint_motion import SkeletonTree

FOLDER: Final = Path(__file__).parent / "skeletons"
"""Where the maps that come with the program lie."""

LIMB_BONES: Final = (
    "femur", "tibia", "foot", "toes",
    "clavicle", "humerus", "radius", "wrist", "hand", "fingers", "thumb",
)  # fmt: skip
"""The paired bones that a map may name, without `l` or `r`."""

_NEEDED: Final = ("femur", "tibia", "humerus", "radius")
_END_BONES: Final = ("head", "toes", "fingers", "thumb")
_SPINE: Final = ("lowerback", "upperback", "thorax")
_NOT_IN_NAMES: Final = re.compile(r"[\s_.\-]+")
# A first spine joint nearer to the root than this share of the trunk is taken to be there.
_AT_ROOT: Final = 0.25

Names = str | tuple[str, ...]


@dataclass(frozen=True)
class BoneMap:
    """Which joints of a tree are ours.

    Attributes:
        family: name of the map that said so.
        starts: for `"root"` and the bones that the file has, the joint they begin at.
        ends: for last bones, the joint that they end at.
    """

    family: str
    starts: dict[str, int]
    ends: dict[str, int]

    @property
    def joints(self) -> list[int]:
        """All joints that are used, in the order of the tree."""
        return sorted({*self.starts.values(), *self.ends.values()})

    def renumbered(self) -> Self:
        """The same map for the part of the tree that holds only `joints`."""
        place = {joint: index for index, joint in enumerate(self.joints)}
        return type(self)(
            self.family,
            {bone: place[joint] for bone, joint in self.starts.items()},
            {bone: place[joint] for bone, joint in self.ends.items()},
        )


class SkeletonMap(BaseModel):
    """The names of one family; see the head of this module.

    Attributes:
        name: what people call the family.
        about: who uses these names.
        sides: what stands for left and right in names.
        hints: names that only this family has.
        root: the root joint.
        spine: joints of the spine, from the root upwards.
        neck: joints of the neck, upwards.
        head: the joint at which the head begins.
        limbs: joints at which paired bones begin, by bone.
        ends: joints at which last bones end, by bone.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    about: str = ""
    sides: tuple[str, str] = ("Left", "Right")
    hints: tuple[str, ...] = ()
    root: Names
    spine: tuple[str, ...] = ()
    neck: tuple[str, ...] = ()
    head: Names = ()
    limbs: dict[str, Names]
    ends: dict[str, Names] = {}

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a map.

        Raises:
            MotionError: the file cannot be read or has an entry that is not understood.
        """
        try:
            made = cls.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise MotionError(f"cannot read skeleton map {path}: {reason}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise MotionError(f"{path} is not a TOML file: {error}; correct it") from error
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"])
            raise MotionError(f"{path}: {place}: {first['msg']}; correct this entry") from error
        for entry, bones, known in (
            ("limbs", made.limbs, LIMB_BONES),
            ("ends", made.ends, _END_BONES),
        ):
            strange = [bone for bone in bones if bone not in known]
            if strange:
                raise MotionError(
                    f"{path}: {entry}.{strange[0]} is no bone; there are {', '.join(known)}"
                )
        missing = [bone for bone in _NEEDED if bone not in made.limbs]
        if missing:
            raise MotionError(f"{path}: limbs lacks {missing[0]}; name the joint it begins at")
        return made

    def find(self, tree: SkeletonTree) -> tuple[BoneMap | None, int]:
        """The joints of a tree that this map names, and how many there are.

        None stands for a tree that lacks a joint that every body must have, or in which
        the joints hang together in another way than in a body.
        """
        best: tuple[BoneMap | None, int] = (None, 0)
        for places in _named(tree, _each(self.root)):
            found, score = self._find(tree, places)
            if found is not None and score > best[1]:
                best = (found, score)
        return best

    def _find(self, tree: SkeletonTree, places: dict[str, int]) -> tuple[BoneMap | None, int]:
        def first(names: Names, side: str = "") -> int | None:
            for name in _each(names):
                full = name.format(side=side, initial=side[:1])
                if (joint := places.get(_plain(full))) is not None:
                    return joint
            return None

        root = first(self.root)
        if root is None:
            return None, 0
        starts, ends = {"root": root}, {}
        for side, word in zip("lr", self.sides, strict=True):
            for bone, names in self.limbs.items():
                if (joint := first(names, word)) is not None:
                    starts[side + bone] = joint
            if starts.get(side + "wrist") == starts.get(side + "hand"):
                starts.pop(side + "wrist", None)  # one joint for both is where the hand begins
            for bone, names in self.ends.items():
                if bone != "head" and (joint := first(names, word)) is not None:
                    ends[side + bone] = joint
        spine = [joint for name in self.spine if (joint := first(name)) is not None]
        neck = [joint for name in self.neck if (joint := first(name)) is not None]
        head = first(self.head)
        if (end := first(self.ends.get("head", ()))) is not None:
            ends["head"] = end
        starts |= trunk_starts(tree, root, spine, neck, head)
        score = len(starts) + len(ends) + len(spine) + len(neck)
        score += sum(first(hint) is not None for hint in self.hints)
        made = BoneMap(self.name, starts, ends)
        return (made, score) if is_body(tree, made) else (None, 0)


def trunk_starts(
    tree: SkeletonTree, root: int, spine: list[int], neck: list[int], head: int | None
) -> dict[str, int]:
    """Which joints of a trunk our bones of spine, neck and head begin at.

    Our spine has three bones from the root to the neck. Of more joints than that the last
    carries the thorax, because the arms hang on it; of two or one that begin away from the
    root, the bones below go unturned up to the first of them.
    """
    starts: dict[str, int] = {}
    if len(spine) >= 3:
        middle = spine[len(spine) // 2]
        starts |= dict(zip(_SPINE, (spine[0], middle, spine[-1]), strict=True))
    elif spine:
        at_root = False
        top = neck[0] if neck else head
        if tree.rest is not None and top is not None:
            low = float(np.linalg.norm(tree.rest[spine[0]] - tree.rest[root]))
            at_root = low < _AT_ROOT * float(np.linalg.norm(tree.rest[top] - tree.rest[root]))
        bones = ("lowerback", "thorax") if at_root else ("upperback", "thorax")
        starts |= dict(zip(bones if len(spine) == 2 else bones[-1:], spine, strict=True))
    if neck:
        starts["lowerneck"] = neck[0]
    if len(neck) > 1:
        starts["upperneck"] = neck[-1]
    if head is not None:
        starts["head"] = head
    return starts


def is_body(tree: SkeletonTree, found: BoneMap) -> bool:
    """Whether a map has what every body must have, and joints hang as in a body."""
    starts = found.starts
    if any(side + bone not in starts for side in "lr" for bone in _NEEDED):
        return False
    if len(set(starts.values())) < len(starts):
        return False
    for side in "lr":
        for chain in (
            ("root", "femur", "tibia", "foot", "toes"),
            ("root", "clavicle", "humerus", "radius", "wrist", "hand", "fingers"),
        ):
            names = [bone if bone == "root" else side + bone for bone in chain]
            joints = [starts[name] for name in names if name in starts]
            if not all(_hangs_on(tree, low, high) for high, low in pairwise(joints)):
                return False
    return True


def find_map(tree: SkeletonTree, own: SkeletonMap | None = None) -> BoneMap | None:
    """The map that names most joints of a tree; None if no family's does.

    Args:
        tree: the foreign skeleton.
        own: a map that comes before those that come with the program, if it fits.
    """
    if own is not None and (found := own.find(tree)[0]) is not None:
        return found
    best, most = None, 0
    for candidate in known_maps():
        found, score = candidate.find(tree)
        if found is not None and score > most:
            best, most = found, score
    return best


@lru_cache(maxsize=1)
def known_maps() -> tuple[SkeletonMap, ...]:
    """The maps that come with the program, in the order of their file names."""
    return tuple(SkeletonMap.load(path) for path in sorted(FOLDER.glob("*.toml")))


def _each(names: Names) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else names


def _plain(name: str) -> str:
    return _NOT_IN_NAMES.sub("", re.split(r"[:|]", name)[-1]).casefold()


def _named(tree: SkeletonTree, roots: tuple[str, ...]) -> Iterator[dict[str, int]]:
    """The joints by plain name: as they are, then without a prefix that the root's has."""
    plain = [_plain(name) for name in tree.names]
    yield _by_name(plain)
    prefixes = {
        name.removesuffix(_plain(root)) for name in plain for root in roots
        if name.endswith(_plain(root))
    } - {""}  # fmt: skip
    for prefix in sorted(prefixes):
        yield _by_name([name.removeprefix(prefix) for name in plain])


def _by_name(names: list[str]) -> dict[str, int]:
    places: dict[str, int] = {}
    for index, name in enumerate(names):
        places.setdefault(name, index)
    return places


def _hangs_on(tree: SkeletonTree, low: int, high: int) -> bool:
    joint = tree.parents[low]
    while joint >= 0 and joint != high:
        joint = tree.parents[joint]
    return joint == high
