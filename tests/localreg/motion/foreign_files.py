"""Files of other people's skeletons, made of our motions: names, rest poses, units, orders.

A foreign skeleton has joints of its own where a family has them (a spine that begins above
the hips, collars beside the neck), turned as our bones are; so its truth is what its own
joints say, which `world_points` gives.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES
from localreg.motion.body_poses import body_turns, rest_starts
from localreg.motion.postures import t_pose

UP = {"y": np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), "z": np.eye(3)}
LIMBS = ("femur", "tibia", "foot", "toes", "clavicle", "humerus", "radius", "hand", "fingers")


@dataclass(frozen=True)
class Layout:
    """How a family writes its files.

    `trunk` names joints upwards with the body each is turned as; `limbs` names those of a
    side; `shifts` moves joints from where our bone begins, in root axes [m].
    """

    trunk: tuple[tuple[str, str], ...]
    limbs: dict[str, str]
    sides: tuple[str, str] = ("Left", "Right")
    rest: str = "t"
    order: str = "ZXY"
    unit: float = 0.01
    up: str = "y"
    top: str = ""
    prefix: str = ""
    all_positions: bool = False
    shifts: dict[str, tuple[float, float, float]] = field(default_factory=dict)


def _limbs(*names):
    return dict(zip(LIMBS, names, strict=False))


_HUMAN_IK = _limbs("{}UpLeg", "{}Leg", "{}Foot", "{}ToeBase", "{}Shoulder", "{}Arm", "{}ForeArm",
                   "{}Hand", "{}HandMiddle1")  # fmt: skip
_ABOVE = {"lowerback": (0.0, 0.08, -0.01), "clavicle": (0.03, -0.04, 0.0)}

LAYOUTS = {
    "Mixamo": Layout(
        (("Spine", "lowerback"), ("Spine1", "upperback"), ("Spine2", "thorax"),
         ("Neck", "lowerneck"), ("Head", "head")),
        _HUMAN_IK, prefix="mixamorig:", shifts=_ABOVE,
    ),
    "LAFAN1": Layout(
        (("Spine", "lowerback"), ("Spine1", "upperback"), ("Spine2", "thorax"),
         ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("{}UpLeg", "{}Leg", "{}Foot", "{}Toe", "{}Shoulder", "{}Arm", "{}ForeArm", "{}Hand"),
        rest="line", order="ZYX", shifts=_ABOVE,
    ),
    "Bandai-Namco": Layout(
        (("Spine", "lowerback"), ("Chest", "thorax"), ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("UpperLeg_{}", "LowerLeg_{}", "Foot_{}", "Toes_{}", "Shoulder_{}", "UpperArm_{}",
               "LowerArm_{}", "Hand_{}"),
        sides=("L", "R"), order="YXZ", top="joint_Root", shifts=_ABOVE,
    ),
    "SMPL": Layout(
        (("Spine1", "lowerback"), ("Spine2", "upperback"), ("Spine3", "thorax"),
         ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("{}_Hip", "{}_Knee", "{}_Ankle", "{}_Foot", "{}_Collar", "{}_Shoulder", "{}_Elbow",
               "{}_Wrist", "{}_Hand"),
        sides=("L", "R"), order="ZYX", unit=1.0, up="z", shifts=_ABOVE,
    ),
    "Xsens BVH": Layout(
        (("Chest", "lowerback"), ("Chest2", "upperback"), ("Chest3", "upperback"),
         ("Chest4", "thorax"), ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("{}Hip", "{}Knee", "{}Ankle", "{}Toe", "{}Collar", "{}Shoulder", "{}Elbow",
               "{}Wrist"),
        order="YXZ", rest="n", shifts={**_ABOVE, "Chest3": (0.0, 0.05, 0.0)},
    ),
    "Xsens": Layout(
        (("L5", "lowerback"), ("L3", "lowerback"), ("T12", "upperback"), ("T8", "thorax"),
         ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("{}UpperLeg", "{}LowerLeg", "{}Foot", "{}Toe", "{}Shoulder", "{}UpperArm",
               "{}ForeArm", "{}Hand"),
        order="ZXY", unit=1.0, up="z", shifts={**_ABOVE, "L3": (0.0, 0.1, 0.0)},
    ),
    "Rokoko": Layout(
        (("Spine1", "lowerback"), ("Spine2", "upperback"), ("Spine3", "thorax"),
         ("Spine4", "thorax"), ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("{}Thigh", "{}Shin", "{}Foot", "{}Toe", "{}Shoulder", "{}Arm", "{}ForeArm",
               "{}Hand"),
        order="XYZ", shifts={**_ABOVE, "Spine4": (0.0, 0.05, 0.0)},
    ),
    "Perception Neuron": Layout(
        (("Spine", "lowerback"), ("Spine1", "upperback"), ("Spine2", "thorax"),
         ("Spine3", "thorax"), ("Neck", "lowerneck"), ("Head", "head")),
        {bone: name for bone, name in _HUMAN_IK.items() if bone not in ("toes", "fingers")}
        | {"fingers": "{}InHandMiddle"},
        order="YXZ", all_positions=True, shifts={**_ABOVE, "Spine3": (0.0, 0.05, 0.0)},
    ),
    "Poser": Layout(
        (("abdomen", "upperback"), ("chest", "thorax"), ("neck", "lowerneck"), ("head", "head")),
        _limbs("{}Thigh", "{}Shin", "{}Foot", "{}Toe", "{}Collar", "{}Shldr", "{}ForeArm",
               "{}Hand", "{}Mid1"),
        sides=("l", "r"), rest="a", order="XZY", unit=0.0254, shifts={"clavicle": (0.03, 0, 0)},
    ),
    "VRM": Layout(
        (("spine", "lowerback"), ("chest", "upperback"), ("upperChest", "thorax"),
         ("neck", "lowerneck"), ("head", "head")),
        _limbs("{}UpperLeg", "{}LowerLeg", "{}Foot", "{}Toes", "{}Shoulder", "{}UpperArm",
               "{}LowerArm", "{}Hand", "{}MiddleProximal"),
        sides=("left", "right"), order="YZX", unit=1.0, shifts=_ABOVE,
    ),
    "Biped": Layout(
        (("Spine", "lowerback"), ("Spine1", "thorax"), ("Neck", "lowerneck"), ("Head", "head")),
        _limbs("{} Thigh", "{} Calf", "{} Foot", "{} Toe0", "{} Clavicle", "{} UpperArm",
               "{} Forearm", "{} Hand", "{} Finger2"),
        sides=("L", "R"), order="XYZ", unit=0.0254, up="z", prefix="Bip01 ", shifts=_ABOVE,
    ),
    "CMU": Layout(
        (("LowerBack", "lowerback"), ("Spine", "upperback"), ("Spine1", "thorax"),
         ("Neck", "lowerneck"), ("Neck1", "upperneck"), ("Head", "head")),
        {**_HUMAN_IK, "fingers": "{}HandIndex1"}, order="ZYX", unit=0.0254 / 0.45,
    ),
    "Acclaim": Layout(
        tuple((b, b) for b in ("lowerback", "upperback", "thorax", "lowerneck", "upperneck",
                               "head")),
        {bone: "{}" + bone for bone in LIMBS},
        sides=("l", "r"), rest="canonical", order="ZYX", unit=0.0254 / 0.45,
    ),
}  # fmt: skip

_ROOTS = {"SMPL": "Pelvis", "Xsens": "Pelvis", "Poser": "hip", "VRM": "hips", "Biped": "Pelvis",
          "Acclaim": "root"}  # fmt: skip


@dataclass(frozen=True)
class Foreign:
    """A foreign skeleton in metres and our rest axes, and how a motion turns it."""

    names: list[str]
    parents: list[int]
    bodies: list[int]
    offsets: np.ndarray  # from the parent's joint, in the parent's axes at rest
    ends: dict[int, np.ndarray]
    rests: np.ndarray  # turn of every joint's body in the rest pose


def skeleton(subject, family, layout):
    """The foreign skeleton that fits a subject."""
    starts = rest_starts(subject)
    turns = _rest_turns(subject, layout.rest)
    root = layout.prefix + _ROOTS.get(family, "Hips")
    joints = [(root, None, "root", np.zeros(3))]
    if layout.top:
        joints = [(layout.top, None, "root", np.zeros(3)), (root, layout.top, "root", np.zeros(3))]
    above, chest = (root, "root"), (root, "root")
    for name, body in layout.trunk:
        joints.append((layout.prefix + name, above[0], body, _shift(layout, name, body)))
        above = (layout.prefix + name, body)
        chest = above if body == "thorax" else chest
    for side, word in zip("lr", layout.sides, strict=True):
        sign = np.array([1.0 if side == "l" else -1.0, 1.0, 1.0])
        for bones, start in ((LIMBS[:4], root), (LIMBS[4:], chest[0])):
            hangs_on = start
            for bone in bones:
                if bone in layout.limbs:
                    name = layout.prefix + layout.limbs[bone].format(word)
                    shift = sign * _shift(layout, name, bone)
                    joints.append((name, hangs_on, side + bone, shift))
                    hangs_on = name
    names = [joint[0] for joint in joints]
    parents = [-1 if joint[1] is None else names.index(joint[1]) for joint in joints]
    bodies = [BODY_NAMES.index(joint[2]) for joint in joints]
    places = np.array([starts[b] + j[3] for b, j in zip(bodies, joints, strict=True)])
    rests = turns[bodies]
    offsets = np.array([
        np.zeros(3) if p < 0 else rests[p] @ (places[i] - places[p]) for i, p in enumerate(parents)
    ])  # fmt: skip
    ends = {
        i: rests[i] @ subject.offsets[bodies[i] - 1]
        for i in range(len(names)) if i not in parents
    }  # fmt: skip
    return Foreign(names, parents, bodies, offsets, ends, rests)


def _shift(layout, name, body):
    return np.array(layout.shifts.get(name, layout.shifts.get(body, (0.0, 0.0, 0.0))))


def _rest_turns(subject, kind):
    """Turns of all bodies from our rest pose into the family's."""
    if kind == "canonical":
        return np.tile(np.eye(3), (len(BODY_NAMES), 1, 1))
    turns = t_pose(subject).copy()
    if kind in "an":
        for side, sign in (("l", -1.0), ("r", 1.0)):
            down = Rotation.from_euler("z", sign * (45.0 if kind == "a" else 85.0), degrees=True)
            for bone in ("humerus", "radius", "wrist", "hand", "fingers", "thumb"):
                body = BODY_NAMES.index(side + bone)
                turns[body] = down.as_matrix() @ turns[body]
    if kind == "line":  # every bone along x, as rigs have them whose axes follow the bones
        for body in range(1, len(BODY_NAMES)):
            along = turns[body] @ subject.directions[body - 1]
            axis = Rotation.align_vectors([[1.0, 0, 0]], [along])[0]
            turns[body] = axis.as_matrix() @ turns[body]
        upright = Rotation.align_vectors([[1.0, 0, 0]], [[0.0, 1.0, 0]])[0].as_matrix()
        turns[0] = upright @ turns[0]
    return turns


def world_turns(motion, foreign):
    """Turns of the foreign joints in our world."""
    turns = body_turns(motion.qpos, motion.subject)[:, foreign.bodies]
    return turns @ np.swapaxes(foreign.rests, 1, 2)


def world_points(motion, foreign):
    """Places of the foreign joints in our world [m]."""
    turns = world_turns(motion, foreign)
    points = np.empty((len(motion), len(foreign.names), 3))
    for joint, parent in enumerate(foreign.parents):
        if parent < 0:
            points[:, joint] = motion.qpos[:, :3]
        else:
            points[:, joint] = points[:, parent] + turns[:, parent] @ foreign.offsets[joint]
    return points


def write_bvh(path, motion, family, *, orders=None, decimals=6):
    """Write a motion as a file of the family; `orders` gives each joint an Euler order."""
    layout = LAYOUTS[family]
    foreign = skeleton(motion.subject, family, layout)
    turns = UP[layout.up].T @ world_turns(motion, foreign)
    columns, lines, positions = [], {}, [0] if not layout.all_positions else range(99)
    for joint, (name, parent) in enumerate(zip(foreign.names, foreign.parents, strict=True)):
        order = layout.order if orders is None else orders[joint % len(orders)]
        local = turns[:, joint]
        if parent >= 0:
            local = np.swapaxes(turns[:, parent], 1, 2) @ local
        offset = foreign.offsets[joint] / layout.unit
        channels = [f"{axis}rotation" for axis in order]
        if joint in positions:
            channels = ["Xposition", "Yposition", "Zposition", *channels]
            place = motion.qpos[:, :3] @ UP[layout.up] / layout.unit
            columns.append(place if parent < 0 else np.tile(offset, (len(motion), 1)))
        with np.errstate(all="ignore"):
            columns.append(euler(local, order))
        words = " ".join(f"{v:.{decimals}f}" for v in offset)
        lines[joint] = [f"{'ROOT' if parent < 0 else 'JOINT'} {name}", "{", f"OFFSET {words}",
                        f"CHANNELS {len(channels)} {' '.join(channels)}"]  # fmt: skip
    ordered = [joint for joint, _ in _walk(foreign, 0)]
    blocks = {}
    position = 0
    for joint in range(len(foreign.names)):
        count = 2 if joint in positions else 1
        blocks[joint] = np.hstack(columns[position : position + count])
        position += count
    values = np.hstack([blocks[joint] for joint in ordered])
    text = ["HIERARCHY", *_tree_lines(foreign, 0, lines, layout.unit, decimals), "MOTION",
            f"Frames: {len(motion)}", f"Frame Time: {1.0 / motion.rate:.8f}"]  # fmt: skip
    row = " ".join([f"%.{decimals}f"] * values.shape[1])
    text += [row % tuple(frame) for frame in values.tolist()]
    path.write_text("\n".join([*text, ""]))
    return foreign


def euler(turns, order):
    """Intrinsic Euler angles in any of the twelve orders [deg], by channel."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at gimbal lock one angle is free, and taken as nought
        return Rotation.from_matrix(turns).as_euler(order.upper(), degrees=True)


def _walk(foreign, joint):
    yield joint, foreign.names[joint]
    for child, parent in enumerate(foreign.parents):
        if parent == joint:
            yield from _walk(foreign, child)


def _tree_lines(foreign, joint, lines, unit, decimals):
    out = list(lines[joint])
    for child, parent in enumerate(foreign.parents):
        if parent == joint:
            out += _tree_lines(foreign, child, lines, unit, decimals)
    if joint in foreign.ends:
        words = " ".join(f"{v:.{decimals}f}" for v in foreign.ends[joint] / unit)
        out += ["End Site", "{", f"OFFSET {words}", "}"]
    return [*out, "}"]
