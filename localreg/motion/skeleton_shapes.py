"""Which joints of a skeleton are ours when its names say nothing: told by the tree's shape.

A body is a joint with two equal limbs, the legs, from which a spine leads to another joint
with two equal limbs, the arms, and a neck. The longest segment of a limb and its
neighbor are the long bones. Which side is left follows from where the feet point in the rest pose.
"""

from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.motion.joint_motion import SkeletonTree
from localreg.motion.skeleton_maps import BoneMap, is_body, trunk_starts

FAMILY: Final = "told by shape"
"""What maps are called that were made here."""

_ALIKE: Final = 0.25  # twins differ in length by less than this share
_LOWER: Final = 0.45  # a forearm or shank is at least this share of the bone above it
_LARGEST: Final = 500


def find_shape(tree: SkeletonTree) -> BoneMap | None:
    """The map of a tree that has a body's shape; None if it has not, or no rest pose."""
    if tree.rest is None or not 12 <= len(tree.names) <= _LARGEST:
        return None
    shape = _Shape(tree, tree.rest)
    for root in range(len(tree.names)):
        legs = shape.twins(root)
        if legs is None:
            continue
        for junction in shape.below(root, legs):
            arms = shape.twins(junction)
            if arms is not None:
                return shape.body(root, legs, junction, arms)
    return None


class _Shape:
    """A tree with what is asked of it again and again."""

    def __init__(self, tree: SkeletonTree, rest: Float[ndarray, "joints 3"]) -> None:
        self.tree, self.rest = tree, rest
        self.children: list[list[int]] = [[] for _ in tree.names]
        for joint, parent in enumerate(tree.parents):
            if parent >= 0:
                self.children[parent].append(joint)
        self.reach = np.zeros(len(tree.names))  # from a joint to the farthest leaf below it
        for joint in range(len(tree.names) - 1, 0, -1):
            parent = tree.parents[joint]
            if parent >= 0:
                self.reach[parent] = max(
                    self.reach[parent], self.reach[joint] + self.segment(parent, joint)
                )

    def segment(self, a: int, b: int) -> float:
        return float(np.linalg.norm(self.rest[b] - self.rest[a]))

    def limb(self, joint: int) -> list[int]:
        """A joint and those below it on the way to the farthest leaf, none twice in a place."""
        line = [joint]
        while self.children[line[-1]]:
            last = line[-1]
            line.append(
                max(self.children[last], key=lambda c: self.segment(last, c) + self.reach[c])
            )
        whole = max(self.reach[joint], 1e-12)
        return [j for j, after in pairwise(line) if self.segment(j, after) > 1e-3 * whole] + line[
            -1:
        ]

    def twins(self, joint: int) -> tuple[list[int], list[int]] | None:
        """The two longest equal limbs of three segments or more that hang on a joint."""
        limbs = [self.limb(child) for child in self.children[joint]]
        limbs = [limb for limb in limbs if len(limb) >= 3]
        best, longest = None, 0.0
        for i, a in enumerate(limbs):
            for b in limbs[i + 1 :]:
                lengths = [self.reach[limb[0]] for limb in (a, b)]
                alike = abs(lengths[0] - lengths[1]) < _ALIKE * max(lengths)
                if len(a) == len(b) and alike and sum(lengths) > longest:
                    best, longest = (a, b), sum(lengths)
        return best

    def below(self, root: int, legs: tuple[list[int], list[int]]) -> list[int]:
        """The joints below the root that are not of its legs, the nearest first."""
        own = {self.ancestor_below(root, leg[0]) for leg in legs}
        queue = [child for child in self.children[root] if child not in own]
        for joint in queue:
            queue.extend(self.children[joint])
        return queue

    def ancestor_below(self, root: int, joint: int) -> int:
        while self.tree.parents[joint] != root:
            joint = self.tree.parents[joint]
        return joint

    def body(
        self,
        root: int,
        legs: tuple[list[int], list[int]],
        junction: int,
        arms: tuple[list[int], list[int]],
    ) -> BoneMap | None:
        sided = self.sided(root, legs, junction, arms)
        if sided is None:
            return None
        starts: dict[str, int] = {"root": root}
        ends: dict[str, int] = {}
        for side, leg, arm in zip("lr", *sided, strict=True):
            self.name(side, leg, self.long_bones(leg), ("femur", "tibia", "foot", "toes"), starts)
            long = self.long_bones(arm)
            self.name(side, arm, long, ("humerus", "radius", "hand", "fingers"), starts)
            if long > 0:
                starts[side + "clavicle"] = arm[long - 1]
            ends |= {side + "toes": leg[-1], side + "fingers": arm[-1]}
        spine = [junction]
        while self.tree.parents[spine[0]] != root:
            spine.insert(0, self.tree.parents[spine[0]])
        used = {self.ancestor_below(junction, arm[0]) for arm in arms}
        rest = [child for child in self.children[junction] if child not in used]
        neck: list[int] = []
        if rest:
            line = self.limb(max(rest, key=lambda c: self.segment(junction, c) + self.reach[c]))
            fork = next((i for i, j in enumerate(line) if len(self.children[j]) > 1), len(line))
            line = line[: fork + 1]  # eyes, hair and jaws begin there
            neck = [j for j in line if self.children[j]] or line
            if line[-1] not in neck:
                ends["head"] = line[-1]
        head = neck.pop() if len(neck) > 1 else None
        starts |= trunk_starts(self.tree, root, spine, neck, head)
        if "head" in ends and "head" not in starts:
            del ends["head"]
        ends = {bone: joint for bone, joint in ends.items() if joint not in starts.values()}
        made = BoneMap(FAMILY, starts, ends)
        return made if is_body(self.tree, made) else None

    def long_bones(self, limb: list[int]) -> int:
        """Where in a limb its two long bones begin: with the longest, or the one before it."""
        lengths = [self.segment(a, b) for a, b in pairwise(limb)]
        first = int(np.argmax(lengths))
        ends_there = first + 1 >= len(lengths) or lengths[first + 1] < _LOWER * lengths[first]
        return max(first - 1, 0) if ends_there else first

    def name(
        self, side: str, limb: list[int], first: int, bones: tuple[str, ...], into: dict[str, int]
    ) -> None:
        """Give joints of a limb to bones, the long ones first; the last point is an end."""
        for bone, joint in zip(bones, limb[first:], strict=False):
            if joint != limb[-1] or self.children[joint] or bone in ("foot", "hand"):
                into[side + bone] = joint

    def sided(
        self,
        root: int,
        legs: tuple[list[int], list[int]],
        junction: int,
        arms: tuple[list[int], list[int]],
    ) -> tuple[tuple[list[int], list[int]], tuple[list[int], list[int]]] | None:
        """The limbs with the left ones first; None where no feet tell which they are."""
        up = self.rest[junction] - self.rest[root]
        toes = np.zeros(3)
        for leg in legs:
            foot = self.long_bones(leg) + 2
            toes += self.rest[leg[-1]] - self.rest[leg[min(foot, len(leg) - 1)]]
        left = np.cross(up, toes)
        size = float(np.linalg.norm(up) * np.linalg.norm(toes))
        if size < 1e-12 or np.linalg.norm(left) < 0.3 * size:
            return None
        ordered = []
        for pair in (legs, arms):
            far = [self.rest[limb[min(2, len(limb) - 1)]] @ left for limb in pair]
            if abs(far[0] - far[1]) < 1e-9:
                return None
            ordered.append(pair if far[0] > far[1] else (pair[1], pair[0]))
        return ordered[0], ordered[1]
