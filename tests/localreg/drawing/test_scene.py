"""Scenes: several bodies and the measured trackers in one model."""

import mujoco
import numpy as np
import pytest

from localreg.body.model import build_model, tracker_site
from localreg.body.subject import canonical_subject
from localreg.drawing.scene import Figure, build_scene
from tests.localreg.body.random_body import random_poses, random_subject


def test_bodies_stand_in_a_scene_as_they_do_alone() -> None:
    subjects = [canonical_subject(), random_subject(1), random_subject(2, missing_bones=4)]
    scene = build_scene([Figure(subject) for subject in subjects])
    data = mujoco.MjData(scene.model)
    poses = random_poses(1, 3)
    scene.place(data, list(poses))
    for index, (subject, pose) in enumerate(zip(subjects, poses, strict=True)):
        model = build_model(subject)
        alone = mujoco.MjData(model)
        alone.qpos[:] = pose
        mujoco.mj_kinematics(model, alone)
        for body in range(1, model.nbody):
            name = model.body(body).name
            together = data.body(f"figure{index}/{name}").xpos
            np.testing.assert_allclose(together, alone.body(body).xpos, atol=1e-12)
        trackers = scene.tracker_poses(data, index)
        assert tuple(trackers) == subject.trackers
        for tracker, (position, _) in trackers.items():
            np.testing.assert_allclose(position, alone.site(tracker_site(tracker)).xpos, atol=1e-12)


def test_measured_trackers_are_where_they_are_put_or_out_of_sight() -> None:
    scene = build_scene([Figure(canonical_subject())], trackers=["head", "lhand"])
    data = mujoco.MjData(scene.model)
    where = np.array([0.1, 0.2, 1.7]), np.array([0.0, 1.0, 0.0, 0.0])
    scene.place(data, [random_poses(2, 1)[0]], {"head": where})
    np.testing.assert_allclose(data.body("measured:head").xpos, where[0])
    np.testing.assert_allclose(data.body("measured:head").xquat, where[1])
    assert data.body("measured:lhand").xpos[2] < -100


def test_the_look_is_what_was_asked_for() -> None:
    scene = build_scene(
        [Figure(canonical_subject(), (0.1, 0.2, 0.3), 0.5, axes=True), Figure(canonical_subject())],
        floor=-0.25,
    )
    skin = scene.model.material("figure0/skin").rgba
    np.testing.assert_allclose(skin, [0.1, 0.2, 0.3, 0.5], atol=1e-6)
    assert scene.model.geom("floor").pos[2] == -0.25
    first = sum(
        scene.model.body(int(b)).name.startswith("figure0") for b in scene.model.geom_bodyid
    )
    second = sum(
        scene.model.body(int(b)).name.startswith("figure1") for b in scene.model.geom_bodyid
    )
    assert first == second + 4 * 6, "three axes and a case for each of six trackers"


def test_nobody_makes_no_scene() -> None:
    with pytest.raises(ValueError, match="needs a body"):
        build_scene([])
