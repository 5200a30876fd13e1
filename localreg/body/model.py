"""From a subject to a MuJoCo model: bodies, hinges, limits, shapes and sites.

MuJoCo is the truth for kinematics and the hand that draws; nothing here simulates forces.
The world is z up, the root body keeps CMU's y-up frame: standing upright and facing
world -y is the root quaternion (0.7071, 0.7071, 0, 0).
"""

from typing import Any, Final

import mujoco
import numpy as np

from localreg.body.skeleton import BONES
from localreg.body.subject import Subject

UPRIGHT: Final = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
"""Root quaternion of a person standing upright and facing world -y."""

_HINGE_COLUMN: Final = {"x": 0, "y": 1, "z": 2}

# Radius of each bone's capsule as a share of its length, with sensible ends [m].
_GIRTH: Final = {
    "femur": (0.17, 0.095), "tibia": (0.13, 0.075), "foot": (0.22, 0.05), "toes": (0.4, 0.04),
    "hipjoint": (0.4, 0.085), "lowerback": (0.9, 0.125), "upperback": (0.9, 0.13),
    "thorax": (0.9, 0.13), "lowerneck": (0.5, 0.055), "upperneck": (0.4, 0.055),
    "head": (0.8, 0.095), "clavicle": (0.28, 0.06), "humerus": (0.16, 0.055),
    "radius": (0.2, 0.045), "wrist": (0.35, 0.035), "hand": (0.4, 0.035),
    "fingers": (0.25, 0.018), "thumb": (0.25, 0.015),
}  # fmt: skip


def tracker_site(tracker: str) -> str:
    """Name of the site where a tracker sits."""
    return f"tracker:{tracker}"


def end_site(body: str) -> str:
    """Name of the site at the far end of a bone; the root's is at its origin."""
    return f"end:{body}"


def build_spec(subject: Subject) -> mujoco.MjSpec:
    """The subject's body as a MuJoCo specification, ready for a scene to be added.

    One body a bone, hinges in the order of `DOF_NAMES`, a free root, a capsule (group 2)
    a bone, a site at each of the 31 bone ends and one for each tracker.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "localreg"
    spec.compiler.degree = False
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    root = spec.worldbody.add_body(name="root", pos=[0.0, 0.0, 1.0], quat=list(UPRIGHT))
    root.add_freejoint(name="root")
    root.add_site(name=end_site("root"), size=[0.01, 0.01, 0.01])
    # The root needs mass of its own; it has no bone, hence no capsule.
    root.add_geom(size=[0.05, 0, 0], group=2, contype=0, conaffinity=0)
    bodies: dict[str, Any] = {"root": root}
    ends: dict[str, Any] = {"root": np.zeros(3)}
    for bone, offset, frame in zip(BONES, subject.offsets, subject.axis_frames, strict=True):
        body = bodies[bone.parent].add_body(name=bone.name, pos=ends[bone.parent])
        for dof, limits in zip(bone.dofs, bone.limits_deg, strict=True):
            body.add_joint(
                name=f"{bone.name}r{dof}",
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=frame[:, _HINGE_COLUMN[dof]],
                range=np.radians(limits),
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            )
        _add_capsule(body, bone.name, offset)
        body.add_site(name=end_site(bone.name), pos=offset, size=[0.01, 0.01, 0.01])
        bodies[bone.name], ends[bone.name] = body, offset
    for mount in subject.mounts:
        bodies[mount.bone].add_site(
            name=tracker_site(mount.tracker),
            pos=mount.position,
            quat=mount.quaternion,
            size=[0.02, 0.02, 0.02],
        )
    return spec


def build_model(subject: Subject) -> mujoco.MjModel:
    """The subject's body as a compiled MuJoCo model (nq = 63, nv = 62)."""
    return build_spec(subject).compile()


def _add_capsule(body: Any, name: str, offset: np.ndarray) -> None:
    share, limit = _GIRTH[name[1:] if name[1:] in _GIRTH else name]
    length = float(np.linalg.norm(offset))
    radius = float(np.clip(share * length, 0.01, limit))
    if length < 2e-3:  # too short for a capsule; the body still needs a shape to have mass
        body.add_geom(size=[radius, 0, 0], group=2, contype=0, conaffinity=0)
        return
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.0, 0.0, 0.0, *offset],
        size=[radius, 0, 0],
        group=2,
        contype=0,
        conaffinity=0,
    )
