"""What a foreign motion asks of our skeleton: a subject's bones, and where they should be.

Every bone of ours gets a target orientation in every frame. Those of the trunk turn as the
foreign joints do, from the foreign rest pose if a person stands upright in it. Those of the
limbs are laid along the foreign limb, for rest poses differ there (T, A, arms or legs all
along one axis); their twist is the one that makes knees and elbows hinges, on average over
the clip and fixed to the foreign joint, so that it is known while the limb is straight.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import BONE_NAMES, BONES, default_axis_frames, default_offsets
from localreg.body.subject import Subject
from localreg.motion.bone_frames import (
    frame_about,
    frame_along,
    mean_turn,
    turn_onto,
    turned_back,
    unit,
)
from localreg.motion.joint_motion import JointMotion
from localreg.motion.skeleton_maps import BoneMap

PARENTS: Final = tuple(
    -1 if bone.parent == "root" else BONE_NAMES.index(bone.parent) for bone in BONES
)
"""Index of every bone's parent; -1 for the root."""

_INDEX: Final = {name: index for index, name in enumerate(BONE_NAMES)}
_CHILD: Final = {
    "lowerback": "upperback", "upperback": "thorax", "thorax": "lowerneck",
    "lowerneck": "upperneck", "upperneck": "head",
    **{side + bone: side + child for side in "lr" for bone, child in (
        ("hipjoint", "femur"), ("femur", "tibia"), ("tibia", "foot"), ("foot", "toes"),
        ("clavicle", "humerus"), ("humerus", "radius"), ("radius", "wrist"), ("wrist", "hand"),
        ("hand", "fingers"),
    )},
}  # fmt: skip
"""The bone whose start is a bone's end."""

_TRUNK: Final = ("lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head")
_FROM_FILE: Final = (*_TRUNK, "lhipjoint", "rhipjoint", "lclavicle", "rclavicle")
_HINGE: Final = {"femur": "tibia", "humerus": "radius"}

# Two joints nearer than this share of the legs are one, and the bone between them is missing.
_NO_LENGTH: Final = 0.004
# Share of the axis that a straight limb is given in one that is bent at a right angle.
_PRIOR_AXIS: Final = 0.1
_UPRIGHT: Final = np.cos(np.radians(40.0))
_SAME_FOOT: Final = np.cos(np.radians(50.0))
_SNAP: Final = np.cos(np.radians(25.0))

# Trust in orientations [1/rad]: the joint's own, one that a bone only inherits, and a bone's
# whose start is not where the file's joint is.
_OWN: Final = 4.0
_INHERITED: Final = 0.7
_LOOSE: Final = 1.5
_FREE: Final = 0.25


@dataclass(frozen=True, eq=False)
class Targets:
    """What the poses of a clip are fitted to.

    Attributes:
        subject: whose bones they are.
        orientations: of the root and the 30 bones in the world.
        trust: in the orientations of the root and the bones [1/rad].
        points: where the ends of the bones should be [m], the root's origin first; NaN
            where the file has no such point.
        is_joint: which of the points are joints that both skeletons have.
        notes: what had to be assumed.
    """

    subject: Subject
    orientations: Float[ndarray, "frames 31 3 3"]
    trust: Float[ndarray, "31"]
    points: Float[ndarray, "frames 31 3"]
    is_joint: tuple[bool, ...]
    notes: tuple[str, ...]


def make_targets(motion: JointMotion, found: BoneMap, name: str) -> Targets:
    """The targets of a motion in our world.

    Args:
        motion: the foreign motion, in metres and z up.
        found: which of its joints are ours.
        name: of the subject.
    """
    work = _Work(motion, dict(found.starts), dict(found.ends))
    work.drop_bones_without_length()
    return work.make(name)


class _Work:
    """The clip and its map while targets are made of them."""

    def __init__(self, motion: JointMotion, starts: dict[str, int], ends: dict[str, int]) -> None:
        self.motion, self.starts, self.ends = motion, starts, ends
        self.frames = len(motion)
        self.turns: dict[str, ndarray] = {}
        self.notes: list[str] = []
        self.frames_of_rest: ndarray | None = None
        self.axes = default_axis_frames()
        canonical = default_offsets()
        self.directions = canonical / np.linalg.norm(canonical, axis=1, keepdims=True)

    def drop_bones_without_length(self) -> None:
        """Forget joints that lie at the next one: their bone is missing in the file."""
        least = _NO_LENGTH * sum(
            float(np.median(self._length(side + bone))) for side in "lr" for bone in _HINGE
        )
        for bone in [b for b in self.starts if b in _CHILD]:
            following = self._next(bone)
            if following is None:
                continue
            gap = self._point(following) - self._start(bone)
            # The thorax carries the arms, so its joint is needed even without a length.
            if bone != "thorax" and np.median(np.linalg.norm(gap, axis=1)) < least:
                del self.starts[bone]
        if "lwrist" not in self.starts or "rwrist" not in self.starts:
            self.starts.pop("lwrist", None)
            self.starts.pop("rwrist", None)

    def make(self, name: str) -> Targets:
        self.frames_of_rest = self._rest_frame()
        self._turn_root()
        for bone in _TRUNK:
            self._turn_trunk(bone)
        for side in "lr":
            self._turn_clavicle(side + "clavicle")
            self.turns[side + "hipjoint"] = self.turns["root"]
            for first, hinge, rest in (
                ("femur", "tibia", ("foot", "toes")),
                ("humerus", "radius", ("wrist", "hand", "fingers", "thumb")),
            ):
                self._turn_limb(side + first, side + hinge)
                for bone in rest:
                    self._turn_outer(side + bone)
        offsets = self._offsets()
        subject = Subject.from_offsets(name, offsets, self.axes)
        orientations = np.stack([self.turns[b] for b in ("root", *BONE_NAMES)], axis=1)
        points, is_joint = self._points()
        trust = np.array([self._trust(bone) for bone in ("root", *BONE_NAMES)])
        return Targets(subject, orientations, trust, points, is_joint, tuple(self.notes))

    # -- places

    def _start(self, bone: str) -> Float[ndarray, "frames 3"]:
        return self.motion.positions[:, self.starts[bone]]

    def _next(self, bone: str) -> str | None:
        """The next bone outwards that the file has; `end:` before a last bone's end."""
        following = _CHILD.get(bone)
        while following is not None:
            if following in self.starts:
                return following
            if following in self.ends and following not in _CHILD:
                return "end:" + following
            following = _CHILD.get(following)
        return "end:" + bone if bone in self.ends else None

    def _point(self, name: str) -> Float[ndarray, "frames 3"]:
        if name.startswith("end:"):
            return self.motion.positions[:, self.ends[name[4:]]]
        return self._start(name)

    def _length(self, bone: str) -> Float[ndarray, " frames"]:
        following = self._next(bone)
        if following is None:
            return np.zeros(self.frames)
        return np.linalg.norm(self._point(following) - self._start(bone), axis=1)

    def _vector(self, bone: str) -> Float[ndarray, "frames 3"] | None:
        """From where a bone begins to the next joint that the file has."""
        following = self._next(bone)
        if following is None:
            return None
        begin = bone
        while begin not in self.starts:  # an unturned bone lies along the one before it
            index = PARENTS[_INDEX[begin]]
            begin = "root" if index < 0 else BONE_NAMES[index]
        if begin == "root" and bone not in ("lowerback", "upperback", "thorax"):
            return None
        start = self._start("root") if bone == "lowerback" else self._start(begin)
        return self._point(following) - start

    # -- orientations

    def _rest_frame(self) -> Float[ndarray, "3 3"] | None:
        """Our root axes in the file's at rest, if a person stands upright in its rest pose."""
        rest = self.motion.tree.rest
        if rest is None or self.motion.rotations is None:
            return None
        hips = [rest[self.starts[side + "femur"]] for side in "lr"]
        feet = [rest[self.starts.get(side + "foot", self.starts[side + "tibia"])] for side in "lr"]
        top = next((b for b in ("head", "lowerneck", "thorax") if b in self.starts), "root")
        up = unit(rest[self.starts[top]] - rest[self.starts["root"]])
        legs = unit((hips[0] + hips[1] - feet[0] - feet[1]) / 2.0)
        across = unit(hips[0] - hips[1])
        if not (up @ legs > _UPRIGHT and abs(up @ across) < 0.3 and abs(legs @ across) < 0.3):
            return None
        axis = np.zeros(3)
        axis[np.argmax(np.abs(up))] = np.sign(up[np.argmax(np.abs(up))])
        up = axis if axis @ up > _SNAP else up
        frame = frame_along(unit(across - (across @ up) * up), up)
        self._note_exchanged_sides(frame, rest)
        return frame

    def _note_exchanged_sides(
        self, frame: Float[ndarray, "3 3"], rest: Float[ndarray, "joints 3"]
    ) -> None:
        """Note a body whose feet point backwards.

        Its left is called right, or its world is left-handed.
        """
        ways = 0.0
        for side in "lr":
            toes = self.starts.get(side + "toes", self.ends.get(side + "toes"))
            if toes is not None and side + "foot" in self.starts:
                ways += float(unit(rest[toes] - rest[self.starts[side + "foot"]]) @ frame[:, 2])
        if ways < -0.5:
            self.notes.append("its feet point backwards: left and right seem to be exchanged")

    def _turn_root(self) -> None:
        across = unit(self._start("lfemur") - self._start("rfemur"))
        spine = unit(self._trunk_top() - (self._start("lfemur") + self._start("rfemur")) / 2.0)
        turns = self.motion.rotations
        if "root" in self.motion.turns:
            self.turns["root"] = self.motion.turns["root"]
            return
        if turns is None:
            self.turns["root"] = frame_along(across, spine)
            return
        own = turns[:, self.starts["root"]]
        if self.frames_of_rest is not None:
            self.turns["root"] = own @ self.frames_of_rest
            return
        x = unit(np.mean(turned_back(own, across), axis=0))
        y = np.mean(own[:, 2, :], axis=0)  # the world's up in the root's axes
        along = unit(np.mean(turned_back(own, spine), axis=0))
        y = unit(y) if np.linalg.norm(y) > 0.7 and unit(y) @ along > 0.8 else along
        self.turns["root"] = own @ frame_along(x, unit(y - (y @ x) * x))
        self.notes.append("its rest pose is nobody's; how the pelvis is held is guessed")

    def _trunk_top(self) -> Float[ndarray, "frames 3"]:
        if "lowerneck" in self.starts:
            return self._start("lowerneck")
        return (self._start("lhumerus") + self._start("rhumerus")) / 2.0

    def _turn_trunk(self, bone: str) -> None:
        parent = self._parent_turn(bone)
        turns = self.motion.rotations
        if bone in self.motion.turns:
            self.turns[bone] = self.motion.turns[bone]
            return
        if turns is not None and bone in self.starts:
            own = turns[:, self.starts[bone]]
            if self.frames_of_rest is not None:
                self.turns[bone] = own @ self.frames_of_rest
            else:
                self.turns[bone] = own @ self._carry_over(bone, own)
            return
        if turns is None and bone == "thorax":
            across = unit(self._start("lhumerus") - self._start("rhumerus"))
            low = self._start("thorax") if "thorax" in self.starts else self._start("root")
            self.turns[bone] = frame_about(unit(self._trunk_top() - low), across)
            return
        vector = self._vector(bone)
        if turns is None and bone in self.starts and vector is not None:
            self.turns[bone] = turn_onto(parent, self.directions[_INDEX[bone]], unit(vector))
        else:
            self.turns[bone] = parent

    def _turn_clavicle(self, bone: str) -> None:
        turns = self.motion.rotations
        if turns is not None and bone in self.starts and self.frames_of_rest is not None:
            self.turns[bone] = turns[:, self.starts[bone]] @ self.frames_of_rest
        else:
            self.turns[bone] = self.turns["thorax"]

    def _turn_limb(self, bone: str, hinged: str) -> None:
        """The two long bones of a limb, turned so that the joint between them is a hinge."""
        rest, axis = self.directions[_INDEX[bone]], self.axes[_INDEX[hinged]][:, 0]
        upper, lower = self._vector(bone), self._vector(hinged)
        if upper is None or lower is None:
            raise AssertionError(f"{bone} and {hinged} are among the bones that a map must have")
        upper, lower = unit(upper), unit(lower)
        prior = turn_onto(self._parent_turn(bone), rest, upper) @ axis
        bent = np.cross(upper, lower)
        hinge = bent + _PRIOR_AXIS * prior
        weights = np.sum(bent * bent, axis=1) + 1e-3
        turns = self.motion.rotations
        for name, along in ((bone, upper), (hinged, lower)):
            direction = self.directions[_INDEX[name]]
            if turns is None:
                self.turns[name] = frame_about(along, hinge) @ frame_about(direction, axis).T
                continue
            own = turns[:, self.starts[name]]
            there = unit(np.mean(turned_back(own, along), axis=0))
            pin = np.sum(weights[:, None] * turned_back(own, unit(hinge)), axis=0)
            self.turns[name] = own @ (frame_about(there, pin) @ frame_about(direction, axis).T)

    def _turn_outer(self, bone: str) -> None:
        """Feet, hands and what is beyond them: laid along the file's bone, else carried along."""
        parent, turns = self._parent_turn(bone), self.motion.rotations
        if bone not in self.starts:
            self.turns[bone] = parent
            return
        vector, direction = self._vector(bone), self.directions[_INDEX[bone]]
        if turns is None:
            along = None if vector is None else unit(vector)
            self.turns[bone] = parent if along is None else turn_onto(parent, direction, along)
            return
        own = turns[:, self.starts[bone]]
        if bone[1:] in ("foot", "toes") and self.frames_of_rest is not None and vector is not None:
            self._keep_rest(bone, own, vector)
        turn = self._carry_over(bone, own)
        thumb = bone[0] + "thumb"
        if bone[1:] == "hand" and thumb in self.starts and vector is not None:
            there = unit(np.mean(turned_back(own, unit(vector)), axis=0))
            out = np.mean(turned_back(own, self._thumb_end(thumb) - self._start(bone)), axis=0)
            if np.linalg.norm(np.cross(there, unit(out))) > 0.2:
                ours = self.directions[_INDEX[thumb]]
                turn = frame_about(there, out) @ frame_about(direction, ours).T
        self.turns[bone] = own @ turn

    def _keep_rest(
        self, bone: str, own: Float[ndarray, "frames 3 3"], vector: Float[ndarray, "frames 3"]
    ) -> None:
        """Let a foot rest as in the file: people stand on theirs in all rest poses."""
        before = self._turned_parent(bone)
        turns = self.motion.rotations
        if turns is None or before not in self.starts:
            return
        parent = np.swapaxes(turns[:, self.starts[before]], 1, 2) @ self._parent_turn(bone)
        there = unit(np.mean(turned_back(own, unit(vector)), axis=0))
        rest = there @ mean_turn(parent)
        if rest @ self.directions[_INDEX[bone]] > _SAME_FOOT:
            self.directions[_INDEX[bone]] = rest

    def _thumb_end(self, thumb: str) -> Float[ndarray, "frames 3"]:
        return self._point("end:" + thumb) if thumb in self.ends else self._start(thumb)

    def _carry_over(self, bone: str, own: Float[ndarray, "frames 3 3"]) -> Float[ndarray, "3 3"]:
        """Turn of our bone against the file's joint: the parent's, plus what lays it along.

        The file's joints are unturned against each other in a straight body; so between
        the parent's offset and ours lies the smallest turn from one direction to another.
        """
        before = self.starts.get(self._turned_parent(bone))
        turns = self.motion.rotations
        if turns is None or before is None:
            return np.eye(3)
        parent_turn = mean_turn(np.swapaxes(turns[:, before], 1, 2) @ self._parent_turn(bone))
        vector = self._vector(bone)
        if vector is None:
            return parent_turn
        there = unit(np.mean(turned_back(own, unit(vector)), axis=0))
        return turn_onto(parent_turn[None], self.directions[_INDEX[bone]], there[None])[0]

    def _turned_parent(self, bone: str) -> str:
        index = PARENTS[_INDEX[bone]]
        while index >= 0 and BONE_NAMES[index] not in self.starts:
            index = PARENTS[index]
        return "root" if index < 0 else BONE_NAMES[index]

    def _parent_turn(self, bone: str) -> Float[ndarray, "frames 3 3"]:
        index = PARENTS[_INDEX[bone]]
        return self.turns["root" if index < 0 else BONE_NAMES[index]]

    def _trust(self, bone: str) -> float:
        if bone == "root" or bone in self.motion.turns:
            return _OWN
        if bone[1:] == "wrist":
            return _OWN if bone in self.starts else _FREE
        if bone not in self.starts or self.motion.rotations is None:
            return _INHERITED
        return _LOOSE if bone[1:] in ("clavicle", "thumb", "toes", "fingers") else _OWN

    # -- bones

    def _offsets(self) -> Float[ndarray, "30 3"]:
        """Start-to-end vectors of all bones in root axes at rest [m]."""
        canonical = default_offsets()
        usual = np.linalg.norm(canonical, axis=1)
        lengths = np.full(len(BONES), np.nan)
        vectors = self.directions.copy()
        for side in "lr":
            hip = _INDEX[side + "hipjoint"]
            vector = self._start(side + "femur") - self._start("root")
            vectors[hip] = np.mean(turned_back(self.turns["root"], vector), axis=0)
            lengths[hip] = np.linalg.norm(vectors[hip])
        self._measure_clavicles(vectors, lengths)
        for chain in self._chains():
            vector = self._vector(chain[0])
            if vector is None:
                continue
            total = float(np.median(np.linalg.norm(vector, axis=1)))
            share = usual[[_INDEX[bone] for bone in chain]]
            share = share / share.sum()
            for bone, part in zip(chain, share, strict=True):
                lengths[_INDEX[bone]] = part * total
                if bone in _FROM_FILE:
                    local = np.mean(turned_back(self.turns[bone], unit(vector)), axis=0)
                    vectors[_INDEX[bone]] = local
        for side in "lr":
            thumb = side + "thumb"
            if thumb in self.starts and thumb in self.ends and side + "hand" in self.starts:
                reach = self._thumb_end(thumb) - self._start(side + "hand")
                lengths[_INDEX[thumb]] = float(np.median(np.linalg.norm(reach, axis=1)))
        missing = np.isnan(lengths)
        scale = np.sum(lengths[~missing]) / np.sum(usual[~missing])
        lengths = np.where(missing, scale * usual, lengths)
        if np.any(missing):
            names = ", ".join(np.array(BONE_NAMES)[missing].tolist())
            self.notes.append(f"bones that the file leaves out take usual proportions: {names}")
        norms = np.linalg.norm(vectors, axis=1, keepdims=True)
        return lengths[:, None] * np.where(norms > 1e-9, vectors / norms, self.directions)

    def _measure_clavicles(self, vectors: ndarray, lengths: ndarray) -> None:
        for side in "lr":
            index = _INDEX[side + "clavicle"]
            vector = self._start(side + "humerus") - self._neck_base()
            vectors[index] = np.mean(turned_back(self.turns[side + "clavicle"], vector), axis=0)
            lengths[index] = float(np.median(np.linalg.norm(vector, axis=1)))

    def _neck_base(self) -> Float[ndarray, "frames 3"]:
        """Where the clavicles begin on our skeleton: at the end of the thorax."""
        if "lowerneck" in self.starts:
            return self._start("lowerneck")
        if "lclavicle" in self.starts and "rclavicle" in self.starts:
            return (self._start("lclavicle") + self._start("rclavicle")) / 2.0
        return (self._start("lhumerus") + self._start("rhumerus")) / 2.0

    def _chains(self) -> list[list[str]]:
        """Bones that lie in a line because the file has no joint between them."""
        chains: list[list[str]] = []
        for bone in BONE_NAMES:
            if bone[1:] in ("hipjoint", "clavicle", "thumb"):
                continue
            follows = bool(chains) and _CHILD.get(chains[-1][-1]) == bone
            if follows and bone not in self.starts:
                chains[-1].append(bone)
            else:
                chains.append([bone])
        return [chain for chain in chains if self._is_measured(chain)]

    def _is_measured(self, chain: list[str]) -> bool:
        """Whether the file has the point at which the line ends."""
        following = self._next(chain[-1])
        direct = _CHILD.get(chain[-1])
        return following is not None and following in ("end:" + chain[-1], direct)

    def _points(self) -> tuple[Float[ndarray, "frames 31 3"], tuple[bool, ...]]:
        """Where the ends of bones should be, and which of these are joints of both."""
        points = np.full((self.frames, 1 + len(BONES), 3), np.nan)
        points[:, 0] = self._start("root")
        is_joint = [True] + [False] * len(BONES)
        for index, bone in enumerate(BONE_NAMES, start=1):
            child = _CHILD.get(bone)
            if bone[1:] == "hipjoint":
                child = bone[0] + "femur"
            if child in self.starts:
                points[:, index] = self._start(child)
                is_joint[index] = True
            elif bone in self.ends and child is None:
                points[:, index] = self._point("end:" + bone)
        if "lowerneck" not in self.starts:
            points[:, 1 + _INDEX["thorax"]] = self._neck_base()
        return points, tuple(is_joint)
