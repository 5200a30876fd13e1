"""The MuJoCo model of a subject: its size, order, limits and sites."""

import mujoco
import numpy as np
import pytest

from localreg.body.model import UPRIGHT, build_model, build_spec, end_site, tracker_site
from localreg.body.skeleton import BODY_NAMES, BONE_NAMES, BONES, DOF_NAMES, joint_limits
from localreg.body.subject import Subject, canonical_subject
from tests.localreg.body.random_body import random_subject

SUBJECTS = [
    canonical_subject(), random_subject(1), random_subject(2, missing_bones=5),
    random_subject(3, missing_bones=30),
]  # fmt: skip


@pytest.fixture(params=SUBJECTS, ids=lambda subject: subject.name)
def subject(request: pytest.FixtureRequest) -> Subject:
    return request.param


def test_size_and_order(subject: Subject) -> None:
    model = build_model(subject)
    assert (model.nq, model.nv, model.nbody) == (63, 62, 32)
    assert [model.body(i).name for i in range(32)] == ["world", *BODY_NAMES]
    assert [model.joint(i).name for i in range(57)] == ["root", *DOF_NAMES]
    assert model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE
    assert np.all(model.jnt_type[1:] == mujoco.mjtJoint.mjJNT_HINGE)


def test_limits_are_those_of_the_skeleton(subject: Subject) -> None:
    model = build_model(subject)
    assert model.jnt_limited[1:].all()
    np.testing.assert_allclose(model.jnt_range[1:], joint_limits(), atol=1e-12)


def test_sites_sit_at_bone_ends_and_mounts(subject: Subject) -> None:
    model = build_model(subject)
    np.testing.assert_array_equal(model.site(end_site("root")).pos, np.zeros(3))
    for name, offset in zip(BONE_NAMES, subject.offsets, strict=True):
        site = model.site(end_site(name))
        assert model.body(site.bodyid[0]).name == name
        np.testing.assert_allclose(site.pos, offset, atol=1e-12)
    for mount in subject.mounts:
        site = model.site(tracker_site(mount.tracker))
        assert model.body(site.bodyid[0]).name == mount.bone
        np.testing.assert_allclose(site.pos, mount.position, atol=1e-12)
        assert abs(site.quat @ np.array(mount.quaternion)) == pytest.approx(1.0, abs=1e-12)
    assert model.nsite == 31 + len(subject.mounts)


def test_children_start_at_their_parents_far_end(subject: Subject) -> None:
    model = build_model(subject)
    for bone in BONES:
        parent_end = model.site(end_site(bone.parent)).pos
        np.testing.assert_allclose(model.body(bone.name).pos, parent_end, atol=1e-12)
        assert model.body(model.body(bone.name).parentid[0]).name == bone.parent


def test_hinges_turn_about_the_columns_of_the_axis_frame(subject: Subject) -> None:
    model = build_model(subject)
    for bone, frame in zip(BONES, subject.axis_frames, strict=True):
        for dof in bone.dofs:
            axis = model.joint(f"{bone.name}r{dof}").axis
            np.testing.assert_allclose(axis, frame[:, "xyz".index(dof)], atol=1e-12)


def test_the_neutral_pose_stands_upright() -> None:
    model = build_model(canonical_subject())
    np.testing.assert_allclose(model.qpos0[3:7], UPRIGHT, atol=1e-12)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    head, toes = data.site("end:head").xpos, data.site("end:ltoes").xpos
    foot = data.body("lfoot").xpos
    assert head[2] - toes[2] > 1.5
    assert toes[1] < foot[1] - 0.1, "faces world -y"
    assert data.body("lfemur").xpos[0] > 0.0, "the left side is at +x"


def test_every_bone_has_a_shape_and_nothing_collides(subject: Subject) -> None:
    model = build_model(subject)
    assert set(model.geom_bodyid) == set(range(1, 32))
    assert np.all(model.geom_group == 2)
    assert np.all(model.geom_size[:, 0] >= 0.009)
    assert not model.geom_contype.any()


def test_a_spec_can_be_added_to() -> None:
    spec = build_spec(canonical_subject())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 0.1])
    assert spec.compile().ngeom == 32
