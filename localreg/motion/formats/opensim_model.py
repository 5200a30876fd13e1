"""An OpenSim model of a subject, with the motion and its markers beside it.

`walk.osim` is the canonical skeleton with the subject's bones: one body a bone, joints of
three turns with the coordinates of `localreg.motion.anatomical`, and the markers of
`localreg.motion.markers`. `walk.mot` holds its coordinates over time, which move the model
exactly as the motion does, and `walk.trc` its markers. It has no muscles, and its masses are
those of uniform density, good for kinematics alone.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.model import build_model
from localreg.body.skeleton import BODY_NAMES, BONES
from localreg.body.subject import Subject
from localreg.motion.anatomical import FORWARD_UP_RIGHT, JOINTS, PELVIS, PELVIS_PLACE
from localreg.motion.body_poses import PARENTS
from localreg.motion.formats.opensim_tables import write_mot, write_trc
from localreg.motion.markers import JOINT_CENTRES, PLUG_IN_GAIT, local_places
from localreg.motion.motion import Motion
from localreg.motion.postures import standing

_VERSION: Final = "40000"
_AXES: Final = ((0, 0, 1), (1, 0, 0), (0, 1, 0))
_STANDARD: Final = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
_DENSITY: Final = 1000.0  # of the capsules that stand for bones and what is around them [kg/m3]


def write(motion: Motion, path: Path) -> None:
    """Write a subject's model, and the motion and its markers beside it."""
    tree = ET.ElementTree(model(motion.subject))
    ET.indent(tree)
    tree.write(path, encoding="UTF-8", xml_declaration=True)
    write_mot(motion, path.with_suffix(".mot"))
    write_trc(motion, path.with_suffix(".trc"))


def body_name(body: str) -> str:
    """What OpenSim's models would call a body: `pelvis`, `femur_r`, `thorax`."""
    if body == "root":
        return "pelvis"
    paired = body[0] in "lr" and ("r" if body[0] == "l" else "l") + body[1:] in BODY_NAMES
    return f"{body[1:]}_{body[0]}" if paired else body


def model(subject: Subject) -> ET.Element:
    """The model as an XML document."""
    document = ET.Element("OpenSimDocument", Version=_VERSION)
    root = ET.SubElement(document, "Model", name=_identifier(subject.name))
    _text(root, "gravity", "0 -9.80665 0")
    _text(root, "length_units", "meters")
    _text(root, "force_units", "N")
    postures = FORWARD_UP_RIGHT @ standing(subject)
    ends = [np.zeros(3)] + [postures[i + 1] @ subject.offsets[i] for i in range(len(BONES))]
    bodies = ET.SubElement(ET.SubElement(root, "BodySet", name="bodyset"), "objects")
    radii, masses = _capsules(subject)
    moving = ["root", *(joint.bone for joint in JOINTS)]
    for name in moving:
        body = BODY_NAMES.index(name)
        _add_body(bodies, name, ends[body], radii[body], masses[body])
    joints = ET.SubElement(ET.SubElement(root, "JointSet", name="jointset"), "objects")
    turns = list(zip(PELVIS, _AXES, strict=True))
    _add_joint(joints, "root", "/ground", np.zeros(3), turns, PELVIS_PLACE)
    for joint in JOINTS:
        parent, place = PARENTS[BODY_NAMES.index(joint.bone) - 1], np.zeros(3)
        while BODY_NAMES[parent] not in moving:  # a bone that never turns: part of its parent
            place = place + postures[0] @ subject.offsets[parent - 1]
            parent = PARENTS[parent - 1]
        signed = [
            (name, tuple(sign * value for value in axis))
            for name, axis, sign in zip(joint.names, _AXES, joint.signs, strict=True)
        ]
        above = f"/bodyset/{body_name(BODY_NAMES[parent])}"
        _add_joint(joints, joint.bone, above, place + ends[parent], signed)
    markers = ET.SubElement(ET.SubElement(root, "MarkerSet", name="markerset"), "objects")
    places = local_places(subject)
    for point, place in zip((*JOINT_CENTRES, *PLUG_IN_GAIT), places, strict=True):
        marker = ET.SubElement(markers, "Marker", name=point.name)
        _text(marker, "socket_parent_frame", f"/bodyset/{body_name(point.body)}")
        _text(marker, "location", _vector(postures[BODY_NAMES.index(point.body)] @ place))
    return document


def _add_body(
    bodies: ET.Element, name: str, end: Float[ndarray, "3"], radius: float, mass: float
) -> None:
    body = ET.SubElement(bodies, "Body", name=body_name(name))
    length = float(np.linalg.norm(end))
    middle = ET.SubElement(ET.SubElement(body, "components"), "PhysicalOffsetFrame", name="middle")
    shapes = ET.SubElement(middle, "attached_geometry")
    ellipsoid = ET.SubElement(shapes, "Ellipsoid", name="shape")
    _text(ellipsoid, "socket_frame", "..")
    _text(ellipsoid, "radii", _vector(np.array([radius, max(0.55 * length, radius), radius])))
    _text(middle, "socket_parent", "..")
    _text(middle, "translation", _vector(0.5 * end))
    up = np.array([0.0, 1.0, 0.0])
    if length > 0.0:
        turn = Rotation.align_vectors(end[None] / length, up[None])[0]
        _text(middle, "orientation", _vector(turn.as_euler("XYZ")))
    _text(body, "mass", f"{mass:.6g}")
    _text(body, "mass_center", _vector(0.5 * end))
    # Of a solid cylinder, along and across; a shape this coarse needs no finer one.
    along = 0.5 * mass * radius**2
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    _text(body, "inertia", f"{across:.6g} {along:.6g} {across:.6g} 0 0 0")


def _add_joint(
    joints: ET.Element,
    name: str,
    parent: str,
    place: Float[ndarray, "3"],
    turns: Sequence[tuple[str, tuple[int, ...]]],
    moves: tuple[str, ...] = (),
) -> None:
    child = body_name(name)
    joint = ET.SubElement(joints, "CustomJoint", name=f"{child}_joint")
    _text(joint, "socket_parent_frame", "parent_offset")
    _text(joint, "socket_child_frame", "child_offset")
    coordinates = ET.SubElement(joint, "coordinates")
    for coordinate in (*(name for name, _ in turns), *moves):
        element = ET.SubElement(coordinates, "Coordinate", name=coordinate)
        _text(element, "default_value", "0")
        _text(element, "range", "-10 10")
        _text(element, "clamped", "false")
    frames = ET.SubElement(joint, "frames")
    for frame, socket, shift in (
        ("parent_offset", parent, place),
        ("child_offset", f"/bodyset/{child}", np.zeros(3)),
    ):
        element = ET.SubElement(frames, "PhysicalOffsetFrame", name=frame)
        _text(element, "socket_parent", socket)
        _text(element, "translation", _vector(shift))
        _text(element, "orientation", "0 0 0")
    transform = ET.SubElement(joint, "SpatialTransform")
    for number, (coordinate, axis) in enumerate(turns, start=1):
        _add_axis(transform, f"rotation{number}", coordinate, axis)
    for number, axis in enumerate(_STANDARD, start=1):
        _add_axis(transform, f"translation{number}", moves[number - 1] if moves else "", axis)


def _add_axis(transform: ET.Element, name: str, coordinate: str, axis: tuple[int, ...]) -> None:
    element = ET.SubElement(transform, "TransformAxis", name=name)
    _text(element, "coordinates", coordinate)
    _text(element, "axis", " ".join(map(str, axis)))
    if coordinate:
        function = ET.SubElement(element, "LinearFunction", name="function")
        _text(function, "coefficients", "1 0")
    else:
        function = ET.SubElement(element, "Constant", name="function")
        _text(function, "value", "0")


def _capsules(subject: Subject) -> tuple[list[float], list[float]]:
    """Radii [m] and masses [kg] of the bodies' capsules."""
    drawn = build_model(subject)
    radii = [
        float(drawn.geom_size[drawn.body_geomadr[drawn.body(name).id], 0]) for name in BODY_NAMES
    ]
    lengths = [0.1, *subject.lengths.tolist()]
    masses = [
        _DENSITY * np.pi * radius**2 * (length + 4.0 / 3.0 * radius)
        for radius, length in zip(radii, lengths, strict=True)
    ]
    return radii, masses


def _identifier(name: str) -> str:
    """A name that OpenSim takes: letters, digits and underscores."""
    kept = "".join(c if c.isascii() and c.isalnum() else "_" for c in name)
    return f"subject_{kept}" if not kept or kept[0].isdigit() else kept


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _vector(values: Float[ndarray, "3"]) -> str:
    return " ".join(f"{value:.9g}" for value in values.tolist())
