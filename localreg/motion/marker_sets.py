"""A body's joints from the points that laboratories record: joint centres, or skin markers.

Joint centres are those of `localreg.motion.markers` and alike. From markers of the Plug-in
Gait set, hips follow Harrington et al. (2007) from the width and depth of the pelvis; knees,
ankles and elbows lie at half their width from the marker on their side, at a right angle
to the bone above, in the plane of the marker on that bone (the chord function of Plug-in
Gait); wrists lie between their two markers. Widths are not in the file: they are those of a
person whose legs are as long.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.errors import MotionError
from localreg.motion.bone_frames import frame_about, unit
from localreg.motion.joint_motion import JointMotion, SkeletonTree
from localreg.motion.skeleton_maps import BoneMap

_CENTRES: Final = {
    "root": ("PELVIS", "PELVIS_ORIGIN", "PELO", "MIDHIP"),
    "upperback": ("LUMBAR",), "thorax": ("THORAX",), "lowerneck": ("NECK",),
    "upperneck": ("NECK_MID",), "head": ("HEAD",),
}  # fmt: skip
_PAIRED_CENTRES: Final = {
    "femur": ("HJC", "HIP"), "tibia": ("KJC", "KNEE"), "foot": ("AJC", "ANKLE"),
    "toes": ("MTP", "TOE_BASE"), "humerus": ("SJC", "SHOULDER"), "radius": ("EJC", "ELBOW"),
    "hand": ("WJC", "WRIST"),
}  # fmt: skip
_CENTRE_ENDS: Final = {"toes": ("TOE_END",), "hand": ("HAND_END",), "fingers": ("FINGER_END",)}

_NEEDED_MARKERS: Final = ("C7", "CLAV", *(side + name for side in "LR" for name in (
    "ASI", "PSI", "THI", "KNE", "TIB", "ANK", "TOE", "SHO", "ELB",
)))  # fmt: skip

# Of a person whose legs are a metre long, from skin to joint centre with half a marker [m].
_KNEE: Final = 0.058
_ANKLE: Final = 0.047
_ELBOW: Final = 0.047
_SHOULDER: Final = 0.053
_MOST_MISSING: Final = 0.5


@dataclass(frozen=True, eq=False)
class PointTable:
    """Named points over time, as a file of markers holds them.

    Attributes:
        names: of the points.
        places: in the file's axes [m]; NaN where a point was not seen.
        rate: frames a second [Hz].
    """

    names: tuple[str, ...]
    places: Float[ndarray, "frames points 3"]
    rate: float


def joints_of(table: PointTable) -> tuple[JointMotion, BoneMap]:
    """How a body's joints move, from points.

    Args:
        table: the points [m].

    Raises:
        MotionError: the points are neither joint centres nor markers of a known set.
    """
    names = [name.rpartition(":")[2].strip().upper() for name in table.names]
    seen = np.mean(np.isfinite(table.places).all(axis=2), axis=0) > 1.0 - _MOST_MISSING
    index = {name: i for i, name in reversed(list(enumerate(names))) if seen[i]}
    found = _centres(index)
    if found is not None:
        starts, ends = found
        used = sorted({*starts.values(), *ends.values()})
        places, notes = _filled(table.places[:, used])
        order = {i: k for k, i in enumerate(used)}
        made = BoneMap(
            "joint centers",
            {bone: order[i] for bone, i in starts.items()},
            {bone: order[i] for bone, i in ends.items()},
        )
        tree = SkeletonTree(tuple(table.names[i] for i in used), (-1,) * len(used))
        return JointMotion(tree, places, None, table.rate, notes), made
    missing = [name for name in _NEEDED_MARKERS if name not in index]
    if missing:
        shown = ", ".join(missing[:4]) + (", ..." if len(missing) > 4 else "")
        raise MotionError(
            "its points are neither joint centers (LHJC, LKJC, LAJC, LSJC, LEJC, LWJC, ...) nor a "
            f"whole Plug-in Gait marker set (lacking {shown}); rename or fill them"
        )
    order = sorted(index)
    places, notes = _filled(table.places[:, [index[name] for name in order]])
    by_name = {name: places[:, k] for k, name in enumerate(order)}
    return _plug_in_gait(by_name, table.rate, notes)


def _centres(index: dict[str, int]) -> tuple[dict[str, int], dict[str, int]] | None:
    def first(names: tuple[str, ...], side: str = "") -> int | None:
        for name in names:
            for full in (side + name, f"{name}_{side}", f"{side}_{name}") if side else (name,):
                if full in index:
                    return index[full]
        return None

    starts, ends = {}, {}
    for bone, names in _CENTRES.items():
        if (joint := first(names)) is not None:
            starts[bone] = joint
    for side in "lr":
        for bone, names in _PAIRED_CENTRES.items():
            if (joint := first(names, side.upper())) is not None:
                starts[side + bone] = joint
        for bone, names in _CENTRE_ENDS.items():
            if (joint := first(names, side.upper())) is not None:
                ends[side + bone] = joint
    if (joint := first(("HEAD_END", "HEAD_TOP"))) is not None:
        ends["head"] = joint
    needed = ["root", *(s + b for s in "lr" for b in ("femur", "tibia", "foot", "humerus",
                                                      "radius", "hand"))]  # fmt: skip
    return (starts, ends) if all(bone in starts for bone in needed) else None


def _filled(
    places: Float[ndarray, "frames points 3"],
) -> tuple[Float[ndarray, "frames points 3"], tuple[str, ...]]:
    """Places with gaps bridged in a straight line, and a note of how many there were."""
    places = places.copy()
    missing = np.asarray(np.isnan(places).any(axis=2))
    frames = np.arange(len(places))
    for point in np.flatnonzero(missing.any(axis=0)):
        good = ~missing[:, point]
        for axis in range(3):
            places[~good, point, axis] = np.interp(
                frames[~good], frames[good], places[good, point, axis]
            )
    if not missing.any():
        return places, ()
    share = 100.0 * float(missing.mean())
    return places, (f"{share:.1f} % of the points' places were missing and were bridged",)


def _plug_in_gait(
    at: dict[str, ndarray], rate: float, notes: tuple[str, ...]
) -> tuple[JointMotion, BoneMap]:
    """Joints from a whole set of markers, in whatever axes they are."""
    points: dict[str, ndarray] = {}
    turns: dict[str, ndarray] = {}
    fore = (at["LASI"] + at["RASI"]) / 2.0
    back = (at["LPSI"] + at["RPSI"]) / 2.0
    pelvis = _axes(at["LASI"] - at["RASI"], fore - back)
    width = float(np.median(np.linalg.norm(at["LASI"] - at["RASI"], axis=1)))
    depth = float(np.median(np.linalg.norm(fore - back, axis=1)))
    points["root"], turns["root"] = (fore + back) / 2.0, pelvis
    for side, sign in (("l", 1.0), ("r", -1.0)):
        # Harrington's regression, from millimetres to metres, in x left, y up, z forward.
        local = np.array([sign * (0.33 * width + 0.0073), -0.30 * width - 0.0109,
                          -0.24 * depth - 0.0099])  # fmt: skip
        points[side + "femur"] = fore + pelvis @ local
    size = 0.5 * float(sum(
        np.median(np.linalg.norm(points[side + "femur"] - at[side.upper() + "KNE"], axis=1))
        + np.median(np.linalg.norm(at[side.upper() + "KNE"] - at[side.upper() + "ANK"], axis=1))
        for side in "lr"
    )) / 0.9  # fmt: skip
    neck = (at["C7"] + at["CLAV"]) / 2.0
    chest = (at["T10"] + at["STRN"]) / 2.0 if {"T10", "STRN"} <= set(at) else None
    points["lowerneck"] = neck
    low = points["root"] if chest is None else chest
    across = at["LSHO"] - at["RSHO"]
    thorax = frame_about(unit(neck - low), across)
    turns["thorax"] = thorax
    if chest is not None:
        points["thorax"] = chest
    ends: dict[str, ndarray] = {}
    _head(at, size, points, ends, turns)
    for side in "lr":
        s = side.upper()
        points[side + "tibia"] = _chord(at[s + "KNE"], points[side + "femur"], at[s + "THI"],
                                        size * _KNEE)  # fmt: skip
        points[side + "foot"] = _chord(at[s + "ANK"], points[side + "tibia"], at[s + "TIB"],
                                       size * _ANKLE)  # fmt: skip
        points[side + "toes"] = _toe_base(at, s, points[side + "foot"], size)
        shoulder = at[s + "SHO"] - size * _SHOULDER * thorax[:, :, 1]
        points[side + "humerus"] = shoulder
        plane = at.get(s + "UPA", at[s + "SHO"])
        points[side + "radius"] = _chord(at[s + "ELB"], shoulder, plane, size * _ELBOW)
        wrist = [at[s + name] for name in ("WRA", "WRB") if s + name in at]
        if wrist:
            points[side + "hand"] = np.mean(wrist, axis=0)
            if s + "FIN" in at:
                points[side + "fingers"] = at[s + "FIN"]
    names = [*points, *(f"{bone} end" for bone in ends)]
    places = np.stack([*points.values(), *ends.values()], axis=1)
    made = BoneMap(
        "Plug-in Gait markers",
        {bone: k for k, bone in enumerate(points)},
        {bone: len(points) + k for k, bone in enumerate(ends)},
    )
    tree = SkeletonTree(tuple(names), (-1,) * len(names))
    return JointMotion(tree, places, None, rate, notes, turns), made


def _head(
    at: dict[str, ndarray],
    size: float,
    points: dict[str, ndarray],
    ends: dict[str, ndarray],
    turns: dict[str, ndarray],
) -> None:
    """The head's turn, and where it begins and ends, from four markers around it."""
    names = ("LFHD", "RFHD", "LBHD", "RBHD")
    if not set(names) <= set(at):
        return
    left_front, right_front, left_back, right_back = (at[name] for name in names)
    axes = _axes(left_front + left_back - right_front - right_back,
                 left_front + right_front - left_back - right_back)  # fmt: skip
    middle = (left_front + right_front + left_back + right_back) / 4.0
    turns["head"] = axes
    points["head"] = middle - 0.065 * size * axes[:, :, 1]
    ends["head"] = middle + 0.045 * size * axes[:, :, 1]


def _toe_base(
    at: dict[str, ndarray], side: str, ankle: ndarray, size: float
) -> Float[ndarray, "frames 3"]:
    """Below the marker on the toes, at a right angle to the foot."""
    toe = at[side + "TOE"]
    heel = at.get(side + "HEE")
    if heel is None:
        return toe
    along = unit(toe - heel)
    upward = ankle - heel
    upward = upward - np.sum(upward * along, axis=1, keepdims=True) * along
    return toe - 0.03 * size * unit(upward)


def _chord(
    marker: Float[ndarray, "frames 3"],
    above: Float[ndarray, "frames 3"],
    beside: Float[ndarray, "frames 3"],
    half: float,
) -> Float[ndarray, "frames 3"]:
    """The joint at `half` from its marker, seen from both under a right angle [m].

    Args:
        marker: on the side of the joint.
        above: the joint above it.
        beside: the marker on the bone between; the joint lies away from it.
        half: from marker to joint [m].
    """
    along = above - marker
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / np.maximum(length, 1e-9)
    out = beside - marker
    out = unit(out - np.sum(out * along, axis=1, keepdims=True) * along)
    half = np.minimum(half, 0.9 * length)
    forth = half * half / np.maximum(length, 1e-9)
    return marker + forth * along - np.sqrt(np.maximum(half * half - forth * forth, 0.0)) * out


def _axes(left: ndarray, near_forward: ndarray) -> Float[ndarray, "frames 3 3"]:
    """Root axes whose x points left and whose z lies as near as it can to forward."""
    x = unit(left)
    y = unit(np.cross(near_forward, x))
    return np.stack([x, y, np.cross(x, y)], axis=-1)
