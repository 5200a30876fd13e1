"""Motions of any skeleton: where its joints are in every frame, and how they are turned.

What readers of foreign files make and what `localreg.motion.retarget` takes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Self

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.motion.formats.axes import CMU_UNIT, INCH

UNITS: Final = {"metres": 1.0, "CMU units": CMU_UNIT, "inches": INCH, "centimetres": 0.01,
                "millimetres": 0.001}  # fmt: skip
"""Metres in the length units that files are guessed to have."""

UP_AXES: Final = {
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""For the axis that points up in a file, the rotation into our world, where z does."""


@dataclass(frozen=True, eq=False)
class SkeletonTree:
    """Named joints and how they hang together.

    Attributes:
        names: as in the file; the point at the end of a joint without children is called
            as the joint with ` end` behind it.
        parents: index of every joint's parent, before it in the list; -1 for a root.
        rest: place of every joint in the pose in which no joint is turned, in the axes that
            all of them have there; None where the file has no such pose.
    """

    names: tuple[str, ...]
    parents: tuple[int, ...]
    rest: Float[ndarray, "joints 3"] | None = None

    def children(self, joint: int) -> list[int]:
        """Indices of the joints that hang on one."""
        return [i for i, parent in enumerate(self.parents) if parent == joint]

    def part(self, joints: list[int]) -> Self:
        """Only these joints, each on its nearest ancestor among them."""
        place = {joint: index for index, joint in enumerate(joints)}
        parents = []
        for joint in joints:
            parent = self.parents[joint]
            while parent >= 0 and parent not in place:
                parent = self.parents[parent]
            parents.append(place.get(parent, -1))
        return replace(
            self,
            names=tuple(self.names[joint] for joint in joints),
            parents=tuple(parents),
            rest=None if self.rest is None else self.rest[joints],
        )


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joints over time, in a file's or in our world.

    Attributes:
        tree: which joints.
        positions: world places of the joints [m, or file units until `in_world`].
        rotations: how the joints' axes are turned in the world, against the rest pose; None
            where only places are known.
        rate: frames a second [Hz].
        notes: what had to be assumed or mended.
        turns: how bones of ours (or `"root"`) are turned in the world, where the file tells
            it otherwise than by its joints.
    """

    tree: SkeletonTree
    positions: Float[ndarray, "frames joints 3"]
    rotations: Float[ndarray, "frames joints 3 3"] | None
    rate: float
    notes: tuple[str, ...] = ()
    turns: Mapping[str, Float[ndarray, "frames 3 3"]] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.positions)

    def in_world(self, metres_per_unit: float, up: str) -> Self:
        """The same motion in metres in a world whose z points up.

        Args:
            metres_per_unit: length of the file's unit [m].
            up: the axis that points up in the file, `"y"` or `"z"`.
        """
        rest = self.tree.rest
        scaled = replace(
            self,
            tree=replace(self.tree, rest=None if rest is None else rest * metres_per_unit),
            positions=metres_per_unit * self.positions,
        )
        return scaled.turned(UP_AXES[up])

    def turned(self, turn: Float[ndarray, "3 3"]) -> Self:
        """The same motion in a turned world; the rest pose stays as it is."""
        return replace(
            self,
            positions=self.positions @ turn.T,
            rotations=None if self.rotations is None else turn @ self.rotations,
            turns={bone: turn @ own for bone, own in self.turns.items()},
        )

    def from_frame(self, first: int) -> Self:
        """The same motion without the frames before one."""
        rotations = None if self.rotations is None else self.rotations[first:]
        turns = {bone: own[first:] for bone, own in self.turns.items()}
        return replace(self, positions=self.positions[first:], rotations=rotations, turns=turns)


def nearest_unit(length: float, usual: float) -> tuple[str, float]:
    """The unit that brings a length nearest to its usual value, and metres in it [m].

    Args:
        length: in file units.
        usual: of a person [m].
    """
    ratio = max(length / usual, 1e-12)
    return min(UNITS.items(), key=lambda item: abs(np.log(ratio * item[1])))
