"""From the joints of a foreign file to a `Motion`: what all readers of such files share."""

from collections.abc import Callable
from pathlib import Path

from localreg.errors import MotionError
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.ids import normal_trial, subject_of_trial
from localreg.motion.joint_motion import JointMotion, SkeletonTree
from localreg.motion.motion import Motion, Provenance
from localreg.motion.retarget import map_joints, retarget
from localreg.motion.skeleton_maps import BoneMap, SkeletonMap


def read_foreign(
    path: Path,
    options: ReadOptions,
    tree: SkeletonTree,
    load: Callable[[list[int]], JointMotion],
    *,
    metres_per_unit: float | None = None,
    up: str | None = None,
) -> Motion:
    """The motion of a file with a foreign skeleton.

    Args:
        path: the file.
        options: what the reader was told.
        tree: the file's joints.
        load: how some of them move, in the file's units and axes.
        metres_per_unit: the unit that the format says, if it does [m].
        up: the axis that points up by the format, if it says so.

    Raises:
        MotionError: the joints are no body's.
    """
    try:
        own = None if options.skeleton_map is None else SkeletonMap.load(options.skeleton_map)
        found = map_joints(tree, own)
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error
    motion = load(found.joints)
    return settle(path, options, motion, found.renumbered(), metres_per_unit=metres_per_unit, up=up)


def settle(
    path: Path,
    options: ReadOptions,
    motion: JointMotion,
    found: BoneMap,
    *,
    metres_per_unit: float | None = None,
    up: str | None = None,
) -> Motion:
    """The motion of joints whose bones are known, as `read_foreign` makes it.

    Raises:
        MotionError: the joints are not where a body's could be.
    """
    person, trial = subject_of_trial(path.stem), normal_trial(path.stem)
    try:
        made = retarget(
            motion,
            found,
            person or path.stem,
            metres_per_unit=options.metres_per_unit or metres_per_unit,
            up=options.up or up,
            subject=options.subject,
        )
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error
    provenance = Provenance(
        name=trial,
        subject=person,
        trial=trial,
        source=str(path),
        notes=made.notes,
        skeleton=made.family,
        joint_errors=tuple(made.joint_errors.items()),
    )
    return Motion(made.qpos, made.rate, made.subject, provenance)
