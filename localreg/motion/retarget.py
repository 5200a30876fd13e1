"""Foreign motions on the canonical skeleton: bones of the file, poses that agree with it.

Joints are told by their names (`skeleton_maps`) or by the shape of the tree
(`skeleton_shapes`). The file's bone lengths become the subject; poses are fitted so that
joints come to lie where the file has them and bones point as the file's do
(`retarget_targets`, `retarget_solver`). The unit and the axis that points up are guessed
from the body and said.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, BONE_NAMES, default_offsets
from localreg.body.subject import Subject
from localreg.errors import MotionError
from localreg.motion.joint_angles import bone_angles, bone_rotation, nearest_to_rest
from localreg.motion.joint_motion import JointMotion, SkeletonTree, nearest_unit
from localreg.motion.reference_pose import reference_frames
from localreg.motion.retarget_solver import joint_points, solve_poses
from localreg.motion.retarget_targets import PARENTS, Targets, make_targets
from localreg.motion.skeleton_maps import BoneMap, SkeletonMap, find_map
from localreg.motion.skeleton_shapes import find_shape

_POINT: Final = 200.0  # trust in a joint [1/m]: 5 mm count as much as 15 deg of a joint's own turn
_END: Final = 50.0  # and in an end, which other skeletons put elsewhere
_UP_SHARE: Final = 0.7


@dataclass(frozen=True, eq=False)
class Retargeted:
    """A foreign motion on our skeleton.

    Attributes:
        qpos: one pose a frame.
        rate: frames a second [Hz].
        subject: the file's person.
        family: which names or what else told the joints.
        joint_errors: for every joint that both skeletons have, by our bone that begins
            there, the mean distance between the file's and ours [m].
        direction_error: mean angle between the file's bones and ours, for bones between
            such joints [rad].
        notes: what had to be assumed.
    """

    qpos: Float[ndarray, "frames 63"]
    rate: float
    subject: Subject
    family: str
    joint_errors: dict[str, float]
    direction_error: float
    notes: tuple[str, ...]


def map_joints(tree: SkeletonTree, own: SkeletonMap | None = None) -> BoneMap:
    """Which joints of a tree are ours: by names, else by the shape of the tree.

    Raises:
        MotionError: neither tells; says what to do.
    """
    found = find_map(tree, own) or find_shape(tree)
    if found is not None:
        return found
    names = [name for name in tree.names if not name.endswith(" end")]
    shown = ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
    if own is not None:
        raise MotionError(
            f"neither the skeleton map {own.name} nor any other fits the joints {shown}; a map "
            "must name the root, both thighs, shanks, upper arms and forearms"
        )
    raise MotionError(
        f"the joints {shown} are no body that is known by name or shape; "
        "write a skeleton map for them (--skeleton-map)"
    )


def retarget(
    motion: JointMotion,
    found: BoneMap,
    name: str,
    *,
    metres_per_unit: float | None = None,
    up: str | None = None,
    subject: Subject | None = None,
) -> Retargeted:
    """A foreign motion on the canonical skeleton.

    Args:
        motion: the file's joints, in its units and axes.
        found: which of them are ours.
        name: of the subject.
        metres_per_unit: length of the file's unit [m]; guessed from the legs by default.
        up: the axis that points up, `"y"` or `"z"`; guessed by default.
        subject: whose bones move instead of the file's person's: turned as the file's are.

    Raises:
        MotionError: the joints have no size, or are not where a body's could be.
    """
    notes = list(motion.notes)
    legs = _legs(motion, found)
    if metres_per_unit is None:
        unit, metres_per_unit = nearest_unit(legs, _USUAL_LEGS)
        notes.append(f"lengths taken as {unit}")
    if up is None:
        up = guess_up(motion, found)
        notes.append(f"{up} taken as up")
    if not 0.15 < legs * metres_per_unit / _USUAL_LEGS < 6.0:
        raise MotionError(
            f"its legs are {legs / 2 * metres_per_unit:.3g} m long, so this is no person in any "
            "usual unit; say the unit in an overrides file"
        )
    placed = motion.in_world(metres_per_unit, up)
    skipped = 0
    if placed.rotations is not None:
        first = placed.rotations[0]
        turns = Rotation.from_matrix(np.swapaxes(first[found.starts["root"]], 0, 1) @ first)
        skipped = reference_frames(float(turns.magnitude().max()), placed.positions)
    if skipped:
        placed = placed.from_frame(skipped)
        notes.append(f"dropped a reference pose at the head, {skipped} frames with its blend")
    targets = make_targets(placed, found, name)
    if subject is not None:
        points = np.full_like(targets.points, np.nan)
        points[:, 0] = targets.points[:, 0]
        targets = replace(targets, subject=subject, points=points)
    turns = Rotation.from_matrix(targets.orientations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    qpos = solve_poses(
        targets.subject,
        _guess(targets),
        targets.points,
        turns.reshape(-1, 31, 4),
        np.where(targets.is_joint, _POINT, _END),
        targets.trust,
    )
    qpos[:, 7:] = nearest_to_rest(np.unwrap(qpos[:, 7:], axis=0))
    is_joint = targets.is_joint if subject is None else (True, *[False] * len(BONE_NAMES))
    errors, direction = measure(targets.subject, qpos, targets.points, is_joint)
    notes += targets.notes
    return Retargeted(
        qpos, motion.rate, targets.subject, found.family, errors, direction, tuple(notes)
    )


def measure(
    subject: Subject,
    qpos: Float[ndarray, "frames 63"],
    points: Float[ndarray, "frames 31 3"],
    is_joint: tuple[bool, ...],
) -> tuple[dict[str, float], float]:
    """How far poses are from the file: joints [m] by name, and directions of bones [rad].

    Args:
        subject: whose bones.
        qpos: the poses.
        points: where the file has the root's origin and the ends of the bones [m].
        is_joint: which of them are joints of both skeletons.
    """
    ours, _ = joint_points(subject, qpos)
    distance = np.linalg.norm(ours - points, axis=2)
    errors = {
        _JOINT_AT_END.get(body, body): float(np.mean(distance[:, index]))
        for index, body in enumerate(BODY_NAMES)
        if is_joint[index]
    }
    angles = []
    for index, parent in enumerate(PARENTS, start=1):
        if is_joint[index] and is_joint[parent + 1]:
            a = ours[:, index] - ours[:, parent + 1]
            b = points[:, index] - points[:, parent + 1]
            size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
            if np.all(size > 1e-9):
                cross = np.linalg.norm(np.cross(a, b), axis=1)
                angles.append(float(np.mean(np.arctan2(cross, np.sum(a * b, axis=1)))))
    return errors, float(np.mean(angles)) if angles else 0.0


def guess_up(motion: JointMotion, found: BoneMap) -> str:
    """The axis of a file that points up: the one along which the head is above the feet.

    Where people lie or tumble, the rest pose decides, and in the end y, which most files
    have.
    """
    feet = [found.starts.get(side + "foot", found.starts[side + "tibia"]) for side in "lr"]
    top = next(b for b in ("head", "lowerneck", "lhumerus") if b in found.starts)
    upward = motion.positions[:, found.starts[top]] - motion.positions[:, feet].mean(axis=1)
    size = np.linalg.norm(upward, axis=1)
    share = {axis: float(np.mean(upward[:, k] > 0.7 * size)) for axis, k in (("y", 1), ("z", 2))}
    best = max(share, key=lambda axis: share[axis])
    if share[best] >= _UP_SHARE:
        return best
    rest = motion.tree.rest
    if rest is not None:
        standing = rest[found.starts[top]] - rest[feet].mean(axis=0)
        if standing[2] > 0.7 * np.linalg.norm(standing):
            return "z"
    return "y"


_USUAL_LEGS: Final = float(
    sum(
        np.linalg.norm(default_offsets()[BONE_NAMES.index(side + bone)])
        for side in "lr"
        for bone in ("femur", "tibia")
    )
)

_JOINT_AT_END: Final = {
    "lowerback": "upperback", "upperback": "thorax", "thorax": "lowerneck",
    "lowerneck": "upperneck", "upperneck": "head",
    **{side + bone: side + child for side in "lr" for bone, child in (
        ("hipjoint", "femur"), ("femur", "tibia"), ("tibia", "foot"), ("foot", "toes"),
        ("clavicle", "humerus"), ("humerus", "radius"), ("radius", "wrist"), ("wrist", "hand"),
        ("hand", "fingers"),
    )},
}  # fmt: skip


def _legs(motion: JointMotion, found: BoneMap) -> float:
    """Length of both legs, thighs and shanks [file units]."""
    total = 0.0
    for side in "lr":
        line = [side + "femur", side + "tibia"]
        line += [side + "foot"] if side + "foot" in found.starts else []
        places = [motion.positions[:, found.starts[bone]] for bone in line]
        for upper, lower in pairwise(places):
            total += float(np.median(np.linalg.norm(lower - upper, axis=1)))
    return total


def _guess(targets: Targets) -> Float[ndarray, "frames 63"]:
    """Poses whose bones turn as the targets say, as far as their hinges can."""
    frames = len(targets.points)
    qpos = np.zeros((frames, 63))
    qpos[:, :3] = targets.points[:, 0]
    root = targets.orientations[:, 0]
    quaternions = Rotation.from_matrix(root).as_quat(scalar_first=True)
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    quaternions[1:] *= np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)[:, None]
    qpos[:, 3:7] = quaternions * (1.0 if quaternions[0, 0] >= 0.0 else -1.0)
    turned = [root]
    for index, parent in enumerate(PARENTS):
        above = turned[parent + 1]
        frame = targets.subject.axis_frames[index]
        turn = np.swapaxes(above, 1, 2) @ targets.orientations[:, index + 1]
        columns, angles = bone_angles(index, turn, frame)
        qpos[:, [7 + column for column in columns]] = angles
        turned.append(above @ bone_rotation(index, angles, frame))
    return qpos
