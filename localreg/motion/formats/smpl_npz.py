"""Motions of SMPL body models in NumPy archives (.npz), as AMASS publishes them.

An archive holds `poses`, one row a frame with the rotation vectors of the joints [rad], or
`root_orient` and `pose_body`; `trans`, the place of the model [m]; and `mocap_framerate`.
The first 22 joints are those of the body in all models of the family. Joint places at rest
belong to the body model, which the archive does not hold: unless it has them (`joints_rest`
or `J`), they are those of our own usual proportions, whatever the shape parameters say.
z is up. Loosely packed objects are not read, for they could run code.
"""

import zipfile
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import canonical_subject
from localreg.errors import MotionError
from localreg.motion.body_poses import rest_starts
from localreg.motion.formats.foreign import read_foreign
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.formats.text import LARGEST, LARGEST_FILE, read_bytes
from localreg.motion.joint_motion import JointMotion, SkeletonTree
from localreg.motion.motion import Motion
from localreg.motion.postures import t_pose

JOINTS: Final = (
    ("Pelvis", -1, "root"),
    ("L_Hip", 0, "lfemur"), ("R_Hip", 0, "rfemur"), ("Spine1", 0, "upperback"),
    ("L_Knee", 1, "ltibia"), ("R_Knee", 2, "rtibia"), ("Spine2", 3, "thorax"),
    ("L_Ankle", 4, "lfoot"), ("R_Ankle", 5, "rfoot"), ("Spine3", 6, "thorax"),
    ("L_Foot", 7, "ltoes"), ("R_Foot", 8, "rtoes"), ("Neck", 9, "lowerneck"),
    ("L_Collar", 9, "lclavicle"), ("R_Collar", 9, "rclavicle"), ("Head", 12, "upperneck"),
    ("L_Shoulder", 13, "lhumerus"), ("R_Shoulder", 14, "rhumerus"),
    ("L_Elbow", 16, "lradius"), ("R_Elbow", 17, "rradius"),
    ("L_Wrist", 18, "lhand"), ("R_Wrist", 19, "rhand"),
)  # fmt: skip
"""The body's joints in their order: name, parent, and our bone that begins nearby."""

_RATES: Final = ("mocap_framerate", "mocap_frame_rate", "fps", "framerate")
_PELVIS: Final = np.array([0.0, -0.23, 0.03])  # of the model's origin, in all its shapes [m]


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read an archive of an SMPL model's motion.

    Raises:
        MotionError: the file is no such archive; says what it lacks.
    """
    arrays = _arrays(path)
    vectors, trans = _vectors(path, arrays), arrays.get("trans")
    frames, count = len(vectors), len(JOINTS)
    if trans is None or trans.shape != (frames, 3):
        raise MotionError(f"{path} has no places `trans` for its {frames} poses; add them")
    if not (np.all(np.abs(vectors) <= LARGEST) and np.all(np.abs(trans) <= LARGEST)):
        raise MotionError(f"{path} has a number that is not finite or absurd; mend the archive")
    rate = options.rate or _rate(arrays) or options.rate_without_file()
    notes: list[str] = []
    rest = _rest(arrays)
    if rest is None:
        rest = usual_rest()
        notes.append("the body model's joints are not in the file: usual proportions")
    local = Rotation.from_rotvec(vectors.reshape(-1, 3)).as_matrix().reshape(-1, count, 3, 3)
    turns, places = np.empty_like(local), np.empty((frames, count, 3))
    for joint, (_, parent, _) in enumerate(JOINTS):
        if parent < 0:
            turns[:, joint], places[:, joint] = local[:, joint], trans + rest[0]
        else:
            turns[:, joint] = turns[:, parent] @ local[:, joint]
            offset = rest[joint] - rest[parent]
            places[:, joint] = places[:, parent] + turns[:, parent] @ offset
    tree = SkeletonTree(
        tuple(name for name, _, _ in JOINTS), tuple(parent for _, parent, _ in JOINTS), rest
    )

    def load(wanted: list[int]) -> JointMotion:
        return JointMotion(
            tree.part(wanted), places[:, wanted], turns[:, wanted], rate, tuple(notes)
        )

    return [read_foreign(path, options, tree, load, metres_per_unit=1.0)]


def _arrays(path: Path) -> dict[str, ndarray]:
    """The arrays of numbers in an archive, by name."""
    read_bytes(path)
    wanted = ("poses", "root_orient", "pose_body", "trans", "joints_rest", "J", *_RATES)
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(
                entry.file_size
                for entry in archive.infolist()
                if entry.filename.removesuffix(".npy") in wanted
            )
        if size > LARGEST_FILE:
            raise MotionError(f"{path} unpacks to {size / 2**30:.1f} GiB; cut it into takes")
        with np.load(path, allow_pickle=False) as archive:
            return {
                name: np.asarray(archive[name], dtype=float)
                for name in wanted
                if name in archive.files
            }
    except MotionError:
        raise
    except Exception as error:  # damaged archives fail in zlib, zipfile, NumPy and elsewhere
        raise MotionError(
            f"{path} is no archive of NumPy arrays that can be read; download it again"
        ) from error


def _vectors(path: Path, arrays: dict[str, ndarray]) -> Float[ndarray, "frames 66"]:
    """The rotation vectors of the body's joints, side by side [rad]."""
    poses = arrays.get("poses")
    if poses is None and "root_orient" in arrays and "pose_body" in arrays:
        parts = [arrays["root_orient"], arrays["pose_body"]]
        if all(part.ndim == 2 and len(part) == len(parts[0]) for part in parts):
            poses = np.hstack(parts)
    width = 3 * len(JOINTS)
    if poses is None or poses.ndim != 2 or not len(poses) or poses.shape[1] < width:
        raise MotionError(
            f"{path} has no `poses` with at least {width} numbers a frame; this is no motion of "
            "an SMPL model"
        )
    return poses[:, :width]


def _rate(arrays: dict[str, ndarray]) -> float | None:
    for name in _RATES:
        if name in arrays and arrays[name].size == 1:
            rate = float(arrays[name].ravel()[0])
            if 1e-3 < rate < 1e6:
                return rate
    return None


def _rest(arrays: dict[str, ndarray]) -> Float[ndarray, "22 3"] | None:
    for name in ("joints_rest", "J"):
        places = arrays.get(name)
        if places is None or places.ndim != 2 or places.shape[1] != 3:
            continue
        if len(places) >= len(JOINTS) and np.all(np.abs(places) < 10.0):
            return places[: len(JOINTS)]
    return None


def usual_rest() -> Float[ndarray, "22 3"]:
    """Joint places in the model's T pose for our usual proportions [m]."""
    subject = canonical_subject()
    starts, turns = rest_starts(subject), t_pose(subject)
    places = np.zeros((len(JOINTS), 3))
    for joint, (name, parent, bone) in enumerate(JOINTS):
        if parent < 0:
            places[joint] = _PELVIS
            continue
        body, above = BODY_NAMES.index(bone), BODY_NAMES.index(JOINTS[parent][2])
        offset = turns[above] @ (starts[body] - starts[above])
        if name == "Spine3":
            offset = 0.5 * subject.offsets[BODY_NAMES.index("thorax") - 1]
        elif parent == 9:
            offset = offset - 0.5 * subject.offsets[BODY_NAMES.index("thorax") - 1]
        places[joint] = places[parent] + offset
    return places
