"""Motions of Xsens MVN in MVNX files: segments with a place and a turn in every frame.

MVNX is XML. A segment's place is where it begins; turns are quaternions w x y z; x is
forward, y left, z up in the pose in which no segment is turned. Metres.
"""

from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.errors import MotionError
from localreg.motion.formats.foreign import read_foreign
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.formats.text import LARGEST, read_bytes
from localreg.motion.joint_motion import JointMotion, SkeletonTree
from localreg.motion.motion import Motion

_PARENTS: Final = {
    "L5": "Pelvis", "L3": "L5", "T12": "L3", "T8": "T12", "Neck": "T8", "Head": "Neck",
    **{side + bone: parent if parent in ("T8", "Pelvis") else side + parent
       for side in ("Right", "Left") for bone, parent in (
        ("Shoulder", "T8"), ("UpperArm", "Shoulder"), ("ForeArm", "UpperArm"),
        ("Hand", "ForeArm"), ("UpperLeg", "Pelvis"), ("LowerLeg", "UpperLeg"),
        ("Foot", "LowerLeg"), ("Toe", "Foot"),
    )},
}  # fmt: skip
_MOST_SEGMENTS: Final = 200
_TOP_OF_HEAD: Final = 0.2  # above where the head begins, along its own z axis [m]


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read an MVNX file.

    Raises:
        MotionError: the file is no MVNX or lacks places or turns of segments.
    """
    labels, rate, places, quaternions = _parse(path)
    strange = [name for name in _PARENTS if name not in labels] + (
        [] if "Pelvis" in labels else ["Pelvis"]
    )
    if strange:
        raise MotionError(f"{path} has no segment {strange[0]}; export the whole body from MVN")
    norms = np.linalg.norm(quaternions, axis=2, keepdims=True)
    if np.any(norms < 1e-3):
        raise MotionError(f"{path} has a turn that is none; export it again from MVN")
    turns = Rotation.from_quat((quaternions / norms).reshape(-1, 4), scalar_first=True)
    matrices = turns.as_matrix().reshape(len(places), -1, 3, 3)
    names = ["Pelvis", *_PARENTS]
    order = [labels.index(name) for name in names]
    places, matrices = places[:, order], matrices[:, order]
    head = names.index("Head")
    tip = places[:, head] + _TOP_OF_HEAD * matrices[:, head, :, 2]
    places = np.concatenate([places, tip[:, None]], axis=1)
    matrices = np.concatenate([matrices, matrices[:, head : head + 1]], axis=1)
    parents = [-1, *(names.index(_PARENTS[name]) for name in names[1:]), head]
    tree = SkeletonTree((*names, "Head end"), tuple(parents), _rest(places, matrices, parents))
    rate = options.rate or rate or options.rate_without_file()

    def load(wanted: list[int]) -> JointMotion:
        return JointMotion(tree.part(wanted), places[:, wanted], matrices[:, wanted], rate)

    return [read_foreign(path, options, tree, load, metres_per_unit=1.0, up="z")]


def _rest(
    places: Float[ndarray, "frames joints 3"],
    turns: Float[ndarray, "frames joints 3 3"],
    parents: list[int],
) -> Float[ndarray, "joints 3"]:
    """Where joints are when no segment is turned, on average over the frames."""
    rest = np.zeros((len(parents), 3))
    for joint, parent in enumerate(parents):
        if parent >= 0:
            apart = places[:, joint] - places[:, parent]
            own = np.einsum("fij,fi->fj", turns[:, parent], apart)
            rest[joint] = rest[parent] + own.mean(axis=0)
    return rest


def _parse(
    path: Path,
) -> tuple[list[str], float | None, Float[ndarray, "frames n 3"], Float[ndarray, "frames n 4"]]:
    """Labels of the segments, the rate, their places and turns in all normal frames."""
    data = read_bytes(path)
    if b"<!ENTITY" in data or b"<!DOCTYPE" in data:
        raise MotionError(f"{path} declares XML entities, which no MVNX needs; export it again")
    labels: list[str] = []
    rate: float | None = None
    places: list[ndarray] = []
    turns: list[ndarray] = []
    parser = ET.XMLPullParser(("start", "end"))
    stack: list[ET.Element] = []
    try:
        for start in range(0, len(data), 1 << 20):
            parser.feed(data[start : start + (1 << 20)])
            events: Any = parser.read_events()  # pairs of a word and an element, as asked for
            for event, element in events:
                tag = element.tag.rpartition("}")[2]
                if event == "start":
                    stack.append(element)
                    if len(stack) > 100:
                        raise MotionError(f"{path} nests deeper than any MVNX; export it again")
                    if tag == "subject":
                        rate = _number(element.get("frameRate"))
                    elif tag == "segment" and len(labels) < _MOST_SEGMENTS:
                        labels.append(element.get("label") or "")
                    continue
                stack.pop()
                if tag == "frame":
                    if element.get("type", "normal") == "normal":
                        _take(path, element, len(labels), places, turns)
                    element.clear()
                    if stack:
                        stack[-1].clear()
        parser.close()
    except ET.ParseError as error:
        line = error.position[0]
        raise MotionError(f"{path}, line {line}: this is no sound XML; export it again") from error
    if not places:
        raise MotionError(f"{path} holds no frames with position and orientation; export both")
    return labels, rate, np.array(places), np.array(turns)


def _take(
    path: Path, frame: ET.Element, count: int, places: list[ndarray], turns: list[ndarray]
) -> None:
    found: dict[str, ndarray] = {}
    for child in frame:
        tag = child.tag.rpartition("}")[2]
        if tag in ("position", "orientation"):
            try:
                found[tag] = np.array((child.text or "").split(), dtype=float)
            except ValueError:
                found[tag] = np.zeros(0)
    place = found.get("position", np.zeros(0))
    turn = found.get("orientation", np.zeros(0))
    if place.size != 3 * count or turn.size != 4 * count or not count:
        raise MotionError(
            f"{path}: frame {len(places) + 1} lacks places or turns of its {count} segments; "
            "export position and orientation from MVN"
        )
    if not (np.all(np.abs(place) <= LARGEST) and np.all(np.abs(turn) <= LARGEST)):
        raise MotionError(f"{path}: frame {len(places) + 1} has a number that is not finite")
    places.append(place.reshape(count, 3))
    turns.append(turn.reshape(count, 4))


def _number(text: str | None) -> float | None:
    try:
        value = float(text or "")
    except ValueError:
        return None
    return value if 1e-3 < value < 1e6 else None
