"""Motions in BVH files: CMU's skeleton to the letter, any other by retargeting.

Files named as in the BVH releases of CMU's set, with its rest pose, are read joint by joint.
There all bones' rest frames are the root's, so a joint's rotation is the bone's own turn
R = C Rz Ry Rx C^T; joint angles are recovered from it, exactly where the bone's hinges
can take it, and what they cannot is noted. Files that we write are y up, in centimetres,
which most programs assume, with the channels of CMU's. BVH has no place for the axis
frames C: reading back assumes the canonical skeleton's, which are those of CMU's files.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONE_NAMES, BONES, DOF_COUNT, default_offsets
from localreg.body.subject import Subject, canonical_subject
from localreg.motion.body_poses import body_points
from localreg.motion.formats.axes import (
    positions_from_y_up,
    positions_to_y_up,
    quaternions_from_y_up,
    rotations_to_y_up,
)
from localreg.motion.formats.bvh_file import BvhFile, Joint, read_bvh_file
from localreg.motion.formats.bvh_joints import joint_motion, skeleton_tree
from localreg.motion.formats.foreign import read_foreign
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.ids import normal_trial, subject_of_trial
from localreg.motion.joint_angles import bone_rotations, continuous_zyx, joint_angles
from localreg.motion.joint_motion import UNITS, nearest_unit
from localreg.motion.motion import Motion, Provenance
from localreg.motion.reference_pose import reference_frames

_LEFT: Final = {
    "lhipjoint": "LHipJoint", "lfemur": "LeftUpLeg", "ltibia": "LeftLeg", "lfoot": "LeftFoot",
    "ltoes": "LeftToeBase", "lclavicle": "LeftShoulder", "lhumerus": "LeftArm",
    "lradius": "LeftForeArm", "lwrist": "LeftHand", "lhand": "LeftFingerBase",
    "lfingers": "LeftHandIndex1", "lthumb": "LThumb",
}  # fmt: skip

JOINT_NAMES: Final = {
    "root": "Hips", "lowerback": "LowerBack", "upperback": "Spine", "thorax": "Spine1",
    "lowerneck": "Neck", "upperneck": "Neck1", "head": "Head",
    **_LEFT,
    **{
        "r" + bone[1:]: name.replace("Left", "Right", 1) if "Left" in name else "R" + name[1:]
        for bone, name in _LEFT.items()
    },
}  # fmt: skip
"""The joint that starts each bone."""

_WRITTEN_UNIT: Final = UNITS["centimetres"]

# CMU's BVH skeleton leaves these out: it gives them no length.
_LEFT_OUT: Final = ("thorax", "lwrist", "rwrist")

_LEG: Final = tuple(BONE_NAMES.index(name) for name in ("lfemur", "ltibia", "rfemur", "rtibia"))
# Where these point tells the rest pose; people's differ by less than this.
_LONG_BONES: Final = tuple(
    (side + bone, side + child)
    for side in "lr"
    for bone, child in (("femur", "tibia"), ("tibia", "foot"), ("humerus", "radius"))
)
_SAME_DIRECTION: Final = np.cos(np.radians(17.0))
_NOTED_RESIDUAL: Final = np.radians(0.05)
_NOTED_SHIFT: Final = 1e-3


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read a BVH file of any body.

    CMU's skeleton is read to the letter: the bones that it leaves out (thorax and wrists)
    take the canonical skeleton's proportions, joint angles stand for the joints' rotations,
    and what the bones' hinges cannot take is lost and noted. Other skeletons are
    retargeted. The unit is the one that makes the legs most like a person's, unless
    `options` says it.

    Raises:
        MotionError: the file is faulty, or its joints are no body's; names the line.
    """
    file = read_bvh_file(path, options.rate)
    joints = _recognise(file) if options.up in (None, "y") else None
    if joints is None:
        tree = skeleton_tree(file)
        return [read_foreign(path, options, tree, lambda wanted: joint_motion(file, tree, wanted))]
    notes = list(file.notes)
    offsets = _offsets(joints, notes)
    _note_moving_starts(file, notes)
    unit = options.metres_per_unit
    if unit is None:
        legs = np.sum(np.linalg.norm(offsets[list(_LEG)], axis=1))
        usual = np.sum(np.linalg.norm(default_offsets()[list(_LEG)], axis=1))
        name, unit = nearest_unit(float(legs), float(usual))
        notes.append(f"lengths taken as {name}")
    trial = normal_trial(path.stem)
    if options.subject is None:
        subject = _subject(subject_of_trial(path.stem) or path.stem, offsets * unit, notes)
    else:
        subject = options.subject
    root = joints["root"]
    turns = np.stack([file.rotations(joints[bone]) for bone in BONE_NAMES], axis=1)
    angles, residuals = joint_angles(turns, subject.axis_frames)
    for bone, residual in zip(BONE_NAMES, residuals.max(axis=0), strict=True):
        if residual > _NOTED_RESIDUAL:
            notes.append(
                f"{bone}: its hinges cannot take up to {np.degrees(residual):.1f} deg of rotation"
            )
    qpos = np.empty((len(file.values), 7 + DOF_COUNT))
    qpos[:, :3] = positions_from_y_up(file.positions(root) * unit)
    qpos[:, 3:7] = quaternions_from_y_up(Rotation.from_matrix(file.rotations(root)))
    qpos[:, 7:] = angles
    points, _ = body_points(qpos, subject)
    errors = _joint_errors(file, joints, subject, points, unit) if options.subject is None else ()
    turn = float(np.abs((angles[0] + np.pi) % (2.0 * np.pi) - np.pi).max())
    skipped = reference_frames(turn, points)
    if skipped:
        notes.append(f"dropped a reference pose at the head, {skipped} frames with its blend")
    provenance = Provenance(
        name=trial,
        subject=subject_of_trial(path.stem),
        trial=trial,
        source=str(path),
        notes=tuple(notes),
        skeleton="CMU",
        joint_errors=errors,
    )
    return [Motion(qpos[skipped:], file.rate, subject, provenance)]


def write(motion: Motion, path: Path) -> None:
    """Write a motion as a BVH file in centimetres, y up.

    Six decimals keep a millionth of a degree and of a centimetre. Axis frames and tracker
    mounts are lost.
    """
    turns = joint_turns(motion.qpos, motion.subject)
    angles = np.stack([continuous_zyx(turns[:, joint]) for joint in range(turns.shape[1])], axis=1)
    lines = [row(p, a) for p, a in zip(motion.qpos[:, :3], angles, strict=True)]
    head_text = head(motion.subject, motion.rate, str(len(motion)))
    path.write_text("\n".join([head_text, *lines, ""]), encoding="utf-8")


def head(subject: Subject, rate: float, frames: str) -> str:
    """All lines of a file before its first frame.

    Args:
        subject: whose bones.
        rate: frames a second [Hz].
        frames: how many frames follow, as it is to be written.
    """
    lines = ["HIERARCHY", *_hierarchy("root", subject, 0), "MOTION"]
    return "\n".join([*lines, f"Frames: {frames}", f"Frame Time: {1.0 / rate:.12f}"])


def joint_turns(
    qpos: Float[ndarray, "frames 63"], subject: Subject
) -> Float[ndarray, "frames 31 3 3"]:
    """Turn of every joint against its parent in the file's axes, in the order of a row."""
    turns = bone_rotations(qpos[:, 7:], subject.axis_frames)
    root = rotations_to_y_up(qpos[:, 3:7]).as_matrix()
    order = [BONE_NAMES.index(bone) for bone in _depth_first("root")[1:]]
    return np.concatenate([root[:, None], turns[:, order]], axis=1)


def row(root: Float[ndarray, "3"], angles: Float[ndarray, "31 3"]) -> str:
    """The line of one frame.

    Args:
        root: world position of the root [m].
        angles: about z, y, x of every joint, in the order of `joint_turns` [rad].
    """
    position = positions_to_y_up(root[None])[0] / _WRITTEN_UNIT
    values = [*position.tolist(), *np.degrees(angles).ravel().tolist()]
    return " ".join(["%.6f"] * len(values)) % tuple(values)


def _recognise(file: BvhFile) -> dict[str, Joint] | None:
    """The joint that starts each bone, and the root's; None for any other skeleton."""
    bones = {name: bone for bone, name in JOINT_NAMES.items()}
    joints = {bones[joint.name]: joint for joint in file.joints if joint.name in bones}
    if not len(joints) == len(bones) == len(file.joints):
        return None
    for bone in BONES:
        joint = joints[bone.name]
        if joint.parent < 0 or file.joints[joint.parent].name != JOINT_NAMES[bone.parent]:
            return None
    canonical = default_offsets()
    for bone, child in _LONG_BONES:
        ours, theirs = canonical[BONE_NAMES.index(bone)], joints[child].offset
        size = float(np.linalg.norm(ours) * np.linalg.norm(theirs))
        if ours @ theirs < _SAME_DIRECTION * size:
            return None  # the names are CMU's, the rest pose is not: joint angles differ
    return joints


def _offsets(joints: dict[str, Joint], notes: list[str]) -> Float[ndarray, "30 3"]:
    """Vectors from start to end of the bones [file units]; NaN where the file has none."""
    offsets = np.full((len(BONES), 3), np.nan)
    shifted = []
    for index, bone in enumerate(BONES):
        joint = joints[bone.name]
        ends = [joints[child.name].offset for child in BONES if child.parent == bone.name]
        if not ends and joint.end is not None:
            ends = [joint.end]
        if ends:
            offsets[index] = ends[0]
            scale = float(np.linalg.norm(joints["ltibia"].offset))
            if any(np.linalg.norm(end - ends[0]) > _NOTED_SHIFT * scale for end in ends):
                shifted.append(bone.name)
        if bone.parent == "root":
            if not bone.dofs:  # it never turns, so that a start off the root can go into it
                offsets[index] += joint.offset
            elif np.any(np.abs(joint.offset) > 0.0):
                notes.append(f"{joint.name} starts off the root; moved to it")
    for name in shifted:
        notes.append(f"the joints at the end of {name} start apart; moved to the first of them")
    return offsets


def _note_moving_starts(file: BvhFile, notes: list[str]) -> None:
    """Note the joints whose own position channels stretch the bones: ours keep their length."""
    moving = []
    for joint in file.joints[1:]:
        shift = np.abs(file.positions(joint) - joint.offset)
        if np.any(shift > _NOTED_SHIFT * max(float(np.linalg.norm(joint.offset)), 1e-9)):
            moving.append(joint.name)
    if moving:
        notes.append(f"position channels left out, bones keep their length: {', '.join(moving)}")


def _subject(name: str, offsets: Float[ndarray, "30 3"], notes: list[str]) -> Subject:
    """The subject of these bones [m], completed where the file has none."""
    canonical = default_offsets()
    lengths = np.linalg.norm(offsets, axis=1)
    missing = np.isnan(lengths)
    left_out = [BONE_NAMES.index(bone) for bone in _LEFT_OUT]
    if np.all(lengths[left_out] < 1e-9):
        missing[left_out] = True
    if np.any(missing):
        given = ~missing
        scale = np.sum(lengths[given]) / np.sum(np.linalg.norm(canonical[given], axis=1))
        offsets = np.where(missing[:, None], scale * canonical, offsets)
        names = ", ".join(np.array(BONE_NAMES)[missing].tolist())
        notes.append(f"bones that the file leaves out take usual proportions: {names}")
    return Subject.from_offsets(name, offsets, canonical_subject().axis_frames)


def _joint_errors(
    file: BvhFile,
    joints: dict[str, Joint],
    subject: Subject,
    points: Float[ndarray, "frames 31 3"],
    unit: float,
) -> tuple[tuple[str, float], ...]:
    """Mean distances between the file's joints and ours, by our bone that begins there [m].

    The bones that the file leaves out are put back into it first: what is measured is how
    the joints move, not how long a bone is that the file does not have.
    """
    mended = list(file.joints)
    joint_names = [joint.name for joint in mended]
    for bone in BONES:
        if bone.parent in _LEFT_OUT:
            joint, offset = joints[bone.name], subject.offsets[BONE_NAMES.index(bone.parent)]
            mended[joint_names.index(joint.name)] = replace(joint, offset=offset / unit)
    whole = replace(file, joints=tuple(mended))
    tree = skeleton_tree(whole)
    order = [tree.names.index(JOINT_NAMES[bone]) for bone in ("root", *BONE_NAMES)]
    theirs = positions_from_y_up(
        (joint_motion(whole, tree, order).positions * unit).reshape(-1, 3)
    ).reshape(points.shape)
    distances = np.mean(np.linalg.norm(points - theirs, axis=2), axis=0)
    return tuple(zip(("root", *BONE_NAMES), distances.tolist(), strict=True))


def _depth_first(bone: str) -> list[str]:
    children = [child.name for child in BONES if child.parent == bone]
    return [bone, *(name for child in children for name in _depth_first(child))]


def _hierarchy(bone: str, subject: Subject, depth: int) -> list[str]:
    """The lines of a joint and all below it."""
    index = BONE_NAMES.index(bone) if bone != "root" else -1
    parent = BONES[index].parent if index >= 0 else "root"
    start = subject.offsets[BONE_NAMES.index(parent)] if parent != "root" else np.zeros(3)
    turns = "Zrotation Yrotation Xrotation"
    kind, channels = ("JOINT", f"3 {turns}")
    if bone == "root":
        kind, channels = "ROOT", f"6 Xposition Yposition Zposition {turns}"
    inner = [f"OFFSET {_vector(start)}", f"CHANNELS {channels}"]
    children = [child.name for child in BONES if child.parent == bone]
    lines = [f"{kind} {JOINT_NAMES[bone]}", "{", *(f"\t{line}" for line in inner)]
    for child in children:
        lines += [f"\t{line}" for line in _hierarchy(child, subject, depth + 1)]
    if not children:
        lines += ["\tEnd Site", "\t{", f"\t\tOFFSET {_vector(subject.offsets[index])}", "\t}"]
    return [*lines, "}"]


def _vector(offset: Float[ndarray, "3"]) -> str:
    return " ".join(f"{value / _WRITTEN_UNIT:.6f}" for value in offset)
