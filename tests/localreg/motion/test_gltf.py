"""Binary glTF: valid for Khronos' validator, and moved by three.js as we move it."""

import json
import struct

import numpy as np
import pytest

from localreg.body.skeleton import BODY_NAMES
from localreg.motion.body_poses import body_points
from localreg.motion.formats import read_motion, write_motion
from localreg.motion.formats.capsules import capsule, joined
from localreg.motion.formats.joint_trees import FAMILIES, joint_names
from tests.localreg.motion import npm
from tests.localreg.motion.strategies import make_calm_motion, make_motion

VALIDATE = """
import fs from "fs";
import validator from "gltf-validator";
const reports = {};
for (const file of process.argv.slice(2))
  reports[file] = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
console.log(JSON.stringify(reports));
"""

POSE = """
import fs from "fs";
globalThis.self = globalThis;
const THREE = await import("three");
const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
const [file, times] = process.argv.slice(2);
const bytes = new Uint8Array(fs.readFileSync(file)).buffer;
const gltf = await new GLTFLoader().parseAsync(bytes, "");
const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const poses = [];
for (const time of JSON.parse(times)) {
  mixer.setTime(time);
  gltf.scene.updateMatrixWorld(true);
  const joints = {};
  let low = null;
  gltf.scene.traverse((node) => {
    if (node.isBone)
      joints[node.name] = node.getWorldPosition(new THREE.Vector3()).toArray();
    if (node.isSkinnedMesh) {
      node.skeleton.update();
      node.computeBoundingBox();
      low = node.boundingBox;
    }
  });
  poses.push({ joints, low: low.min.toArray(), high: low.max.toArray() });
}
console.log(JSON.stringify({ seconds: gltf.animations[0].duration, poses }));
"""


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    return npm.install(tmp_path_factory.mktemp("npm"))


def test_the_validator_finds_nothing(packages, tmp_path):
    motions = {
        "one": make_calm_motion(0, count=1),
        "two": make_motion(1, count=2),
        "wild": make_motion(2, count=9, special=0.3),
        "calm": make_calm_motion(3, count=60, rate=59.94),
    }
    files = []
    for index, (name, motion) in enumerate(motions.items()):
        files.append(tmp_path / f"{name}.glb")
        write_motion(motion, files[-1], names=FAMILIES[index % len(FAMILIES)])
    reports = npm.run(packages, VALIDATE, *files)
    for file in files:
        report = reports[str(file)]
        assert report["issues"]["messages"] == []
        assert report["info"]["animationCount"] == 1
        assert report["info"]["hasSkins"]
    broken = tmp_path / "broken.glb"
    broken.write_bytes(files[0].read_bytes()[:-400])
    assert npm.run(packages, VALIDATE, broken)[str(broken)]["issues"]["numErrors"] > 0


@pytest.mark.parametrize("family", FAMILIES)
def test_three_js_moves_every_joint_as_we_do(packages, tmp_path, family):
    motion = make_calm_motion(4, count=30, rate=30.0)
    write_motion(motion, tmp_path / "x.glb", names=family)
    frames = [0, 7, 18]
    times = json.dumps([frame / 30.0 for frame in frames])
    seen = npm.run(packages, POSE, tmp_path / "x.glb", times)
    assert seen["seconds"] == pytest.approx(29 / 30)
    starts, ends = body_points(motion.qpos[frames], motion.subject)
    for pose, here, there in zip(seen["poses"], y_up(starts), y_up(ends), strict=True):
        names = joint_names(family)
        assert len(pose["joints"]) == len(names)
        for body, name in names.items():
            place = pose["joints"][name.replace(":", "")]  # three.js drops colons
            np.testing.assert_allclose(place, here[BODY_NAMES.index(body)], atol=2e-6)
        # The body that is seen lies around the bones, no farther than its girth.
        points = np.concatenate([here, there])
        np.testing.assert_allclose(pose["low"], points.min(axis=0), atol=0.2)
        np.testing.assert_allclose(pose["high"], points.max(axis=0), atol=0.2)


def test_real_motion_is_small_and_whole(motions_dir, tmp_path):
    (motion,) = read_motion(motions_dir / "cmu/subjects/02/02_05.amc")
    write_motion(motion, tmp_path / "x.glb")
    data = (tmp_path / "x.glb").read_bytes()
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    assert len(data) < 200_000 + 520 * len(motion)


def test_capsules_are_closed_and_face_outwards():
    rng = np.random.default_rng(0)
    start, end = rng.normal(size=(2, 3))
    mesh = joined([capsule(start, end, 0.3, 4), capsule(end, end, 0.2, 5)])
    corners = mesh.positions[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = np.sum(normals * mesh.normals[mesh.triangles].mean(axis=1), axis=1)
    assert np.all(outwards > -1e-12)  # a ball has no cylinder, so that its triangles are flat
    # The volume by the divergence theorem: a cylinder and a ball, then a ball, a bit less.
    volume = np.sum(corners[:, 0] * normals) / 6.0
    length = np.linalg.norm(end - start)
    exact = np.pi * 0.09 * length + 4 / 3 * np.pi * (0.3**3 + 0.2**3)
    assert 0.9 * exact < volume < exact
    assert set(mesh.joints) == {4, 5}


def y_up(points):
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)
