"""From the joints of a foreign file to a `Motion`: what all readers of such files share."""

from collections.abc import Callable
from pathlib import Path

from localreg.errors import MotionError
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.ids import normal_trial, subject_of_trial
from localreg.motion.joint_motion import JointMotion, SkeletonTree
from localreg.motion.motion import Motion, Provenance
from localreg.motion.retarget import map_joints, retarget
from localreg.motion.skeleton_maps import SkeletonMap


def read_foreign(
    path: Path,
    options: ReadOptions,
    tree: SkeletonTree,
    load: Callable[[list[int]], JointMotion],
    *,
    metres_per_unit: float | None = None,
    up: str | None = None,
    name: str = "",
) -> Motion:
    """The motion of a file with a foreign skeleton.

    Args:
        path: the file.
        options: what the reader was told.
        tree: the file's joints.
        load: how some of them move, in the file's units and axes.
        metres_per_unit: the unit that the format says, if it does [m].
        up: the axis that points up by the format, if it says so.
        name: of the clip, where a file holds several.

    Raises:
        MotionError: the joints are no body's.
    """
    try:
        own = None if options.skeleton_map is None else SkeletonMap.load(options.skeleton_map)
        found = map_joints(tree, own)
        person = subject_of_trial(path.stem)
        made = retarget(
            load(found.joints),
            found.renumbered(),
            person or path.stem,
            metres_per_unit=options.metres_per_unit or metres_per_unit,
            up=options.up or up,
            subject=options.subject,
        )
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error
    trial = normal_trial(name or path.stem)
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
