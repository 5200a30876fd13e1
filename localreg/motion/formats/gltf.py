"""Motions as binary glTF 2.0: a skeleton, a body of capsules on it, and its animation.

y up, metres, facing +z, as the format has it; one node a joint under the names of a family
(see `joint_trees`), rotations as quaternions x y z w in single precision. Opens in Blender,
three.js, Unity, Unreal and every browser with a viewer.
"""

from pathlib import Path
from typing import Final

import numpy as np
import pygltflib as gl
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES
from localreg.motion.formats.capsules import Mesh, capsule, joined
from localreg.motion.formats.joint_trees import JointTree, joint_tree, local_turns, root_positions
from localreg.motion.motion import Motion
from localreg.motion.quaternions import one_hemisphere

_FLOAT: Final = gl.FLOAT
_COLOR: Final = [0.33, 0.52, 0.71, 1.0]
_STILL: Final = 1e-9  # a joint that never turns by more needs no animation [rad]
_PELVIS: Final = 0.1  # radius of the ball at the root, which has no bone [m]


def write(motion: Motion, path: Path, names: str) -> None:
    """Write a motion as a binary glTF file.

    Args:
        motion: what to write.
        path: the file.
        names: the family of joint names, of `joint_trees.FAMILIES`.
    """
    tree = joint_tree(motion.subject, names)
    joints = len(tree.names)
    document = gl.GLTF2(asset=gl.Asset(version="2.0", generator="localreg"), scene=0)
    document.nodes = _nodes(tree, motion)
    document.nodes.append(gl.Node(name="body", mesh=0, skin=0))
    document.scenes = [gl.Scene(name=motion.provenance.name, nodes=[0, joints])]
    buffer = _Buffer(document)
    matrices = np.tile(np.eye(4, dtype=np.float32), (joints, 1, 1))
    matrices[:, 3, :3] = -tree.rest_positions()  # column-major
    document.skins = [
        gl.Skin(
            name="skeleton",
            inverseBindMatrices=buffer.add(matrices.reshape(-1, 16), gl.MAT4),
            joints=list(range(joints)),
            skeleton=0,
        )
    ]
    _add_body(document, buffer, _body(motion, tree))
    _add_animation(document, buffer, motion, tree)
    blob = bytes(buffer.data)
    document.buffers = [gl.Buffer(byteLength=len(blob))]
    document.set_binary_blob(blob)
    with path.open("wb") as file:
        for part in document.save_to_bytes():
            file.write(part)


class _Buffer:
    """Collects the numbers of a file, and an accessor for each array of them."""

    def __init__(self, document: gl.GLTF2) -> None:
        self.document, self.data = document, bytearray()

    def add(
        self, array: ndarray, kind: str, target: int | None = None, *, bounds: bool = False
    ) -> int:
        """Add an array of float32, uint16 or uint8; returns the number of its accessor."""
        types = {"f": _FLOAT, "H": gl.UNSIGNED_SHORT, "B": gl.UNSIGNED_BYTE}
        view = gl.BufferView(
            buffer=0, byteOffset=len(self.data), byteLength=array.nbytes, target=target
        )
        self.data += array.tobytes()
        self.data += b"\0" * (-len(self.data) % 4)
        self.document.bufferViews.append(view)
        rows = array.reshape(len(array), -1)
        accessor = gl.Accessor(
            bufferView=len(self.document.bufferViews) - 1,
            componentType=types[array.dtype.char],
            count=len(array),
            type=kind,
            min=rows.min(axis=0).tolist() if bounds else None,
            max=rows.max(axis=0).tolist() if bounds else None,
        )
        self.document.accessors.append(accessor)
        return len(self.document.accessors) - 1


def _nodes(tree: JointTree, motion: Motion) -> list[gl.Node]:
    """The joints as they are in the first frame, for programs that show no animation."""
    quaternions = _quaternions(tree, motion.first(1))[0].tolist()
    places = tree.offsets.copy()
    places[0] = root_positions(motion.qpos[:1])[0]
    return [
        gl.Node(
            name=name,
            translation=places[joint].tolist(),
            rotation=quaternions[joint],
            children=[child for child, parent in enumerate(tree.parents) if parent == joint],
        )
        for joint, name in enumerate(tree.names)
    ]


def _quaternions(tree: JointTree, motion: Motion) -> Float[ndarray, "frames joints 4"]:
    """Turns of the joints against their parents, x y z w, without jumps of the sign."""
    turns = local_turns(tree, motion.qpos, motion.subject)
    shape = turns.shape[:2]
    flat = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_quat(canonical=True)
    quaternions = flat.reshape(*shape, 4)
    return np.stack([one_hemisphere(quaternions[:, j]) for j in range(shape[1])], axis=1)


def _body(motion: Motion, tree: JointTree) -> Mesh:
    """A capsule for every bone in the rest posture, following the joint that moves it."""
    places = tree.rest_positions()
    meshes = [capsule(places[0] - [0.05, 0, 0], places[0] + [0.05, 0, 0], _PELVIS, 0)]
    girths = _girths(motion)
    for body in range(1, len(BODY_NAMES)):
        joint = tree.carriers[body]
        start = places[joint]
        if BODY_NAMES[body] in _names_of(tree):
            end = start + tree.ends[joint]
        else:  # a bone without a joint of its own starts where its carrier does
            end = start + tree.rest[joint] @ motion.subject.offsets[body - 1]
        meshes.append(capsule(start, end, girths[body], joint))
    return joined(meshes)


def _names_of(tree: JointTree) -> set[str]:
    return {BODY_NAMES[body] for body in tree.bodies}


def _girths(motion: Motion) -> list[float]:
    """Radii of the bodies' capsules, those of the model that is drawn elsewhere [m]."""
    from localreg.body.model import build_model

    model = build_model(motion.subject)
    return [
        float(model.geom_size[model.body_geomadr[model.body(name).id], 0]) for name in BODY_NAMES
    ]


def _add_body(document: gl.GLTF2, buffer: _Buffer, mesh: Mesh) -> None:
    vertices = len(mesh.positions)
    positions = mesh.positions.astype(np.float32)
    followed = np.zeros((vertices, 4), dtype=np.uint8)
    followed[:, 0] = mesh.joints
    weights = np.zeros((vertices, 4), dtype=np.float32)
    weights[:, 0] = 1.0
    target = gl.ARRAY_BUFFER
    attributes = gl.Attributes(
        POSITION=buffer.add(positions, gl.VEC3, target, bounds=True),
        NORMAL=buffer.add(mesh.normals.astype(np.float32), gl.VEC3, target),
        JOINTS_0=buffer.add(followed, gl.VEC4, target),
        WEIGHTS_0=buffer.add(weights, gl.VEC4, target),
    )
    indices = mesh.triangles.astype(np.uint16).reshape(-1)
    primitive = gl.Primitive(
        attributes=attributes,
        indices=buffer.add(indices, gl.SCALAR, gl.ELEMENT_ARRAY_BUFFER),
        material=0,
    )
    surface = gl.PbrMetallicRoughness(
        baseColorFactor=_COLOR, metallicFactor=0.0, roughnessFactor=0.8
    )
    document.materials = [gl.Material(name="body", pbrMetallicRoughness=surface)]
    document.meshes = [gl.Mesh(name="body", primitives=[primitive])]


def _add_animation(document: gl.GLTF2, buffer: _Buffer, motion: Motion, tree: JointTree) -> None:
    times = (np.arange(len(motion)) / motion.rate).astype(np.float32)
    clock = buffer.add(times, gl.SCALAR, bounds=True)
    animation = gl.Animation(name=motion.provenance.name, channels=[], samplers=[])

    def add(joint: int, what: str, values: ndarray, kind: str) -> None:
        output = buffer.add(np.ascontiguousarray(values, dtype=np.float32), kind)
        animation.samplers.append(
            gl.AnimationSampler(input=clock, output=output, interpolation="LINEAR")
        )
        target = gl.AnimationChannelTarget(node=joint, path=what)
        animation.channels.append(
            gl.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        )

    add(0, "translation", root_positions(motion.qpos), gl.VEC3)
    quaternions = _quaternions(tree, motion)
    for joint in range(len(tree.names)):
        path = quaternions[:, joint]
        if joint == 0 or np.ptp(path, axis=0).max() > _STILL:
            add(joint, "rotation", path, gl.VEC4)
    document.animations = [animation]
