"""Our kinematics equals MuJoCo's: positions, rotations and Jacobians."""

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from localreg.body.kinematics import (
    BodyPoses,
    Kinematics,
    SitePoses,
    bone_ends_batch,
    difference,
    integrate,
    tracker_poses_batch,
)
from localreg.body.model import build_model, end_site, tracker_site
from localreg.body.skeleton import BODY_NAMES, TANGENT_SIZE
from localreg.body.subject import Subject, canonical_subject
from tests.localreg.body.random_body import random_poses, random_subject

EXACT = 1e-9
SUBJECTS = [
    canonical_subject(), random_subject(1), random_subject(2, missing_bones=8),
    random_subject(3, missing_bones=30),
]  # fmt: skip
every_subject = pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)


@eqx.filter_jit
def forward(kinematics: Kinematics, qpos: jax.Array) -> BodyPoses:
    return kinematics.forward(qpos)


@eqx.filter_jit
def jacobians(kinematics: Kinematics, qpos: jax.Array) -> dict[str, tuple[SitePoses, jax.Array]]:
    """At trackers and bone ends, for a batch of poses."""
    return {
        name: jax.vmap(lambda q, s=sites: kinematics.jacobian(q, s))(qpos)
        for name, sites in (("trackers", kinematics.trackers), ("ends", kinematics.ends))
    }


def mujoco_at(model: mujoco.MjModel, qpos: ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    return data


def site_jacobian(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> ndarray:
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, linear, angular, model.site(name).id)
    return np.concatenate([linear, angular])


def assert_same_rotations(ours: jax.Array, theirs: ndarray) -> None:
    """Quaternions that may differ in sign."""
    ours = np.asarray(ours)
    aligned = ours * np.sign(np.sum(ours * theirs, axis=-1, keepdims=True))
    np.testing.assert_allclose(aligned, theirs, atol=EXACT)


@every_subject
def test_bodies_are_where_mujoco_puts_them(subject: Subject) -> None:
    model, kinematics = build_model(subject), Kinematics.from_subject(subject)
    for qpos in random_poses(11, 20):
        data, ours = mujoco_at(model, qpos), forward(kinematics, jnp.asarray(qpos))
        np.testing.assert_allclose(ours.positions, data.xpos, atol=EXACT)
        assert_same_rotations(ours.quaternions, data.xquat)


@every_subject
def test_sites_and_their_jacobians_are_mujocos(subject: Subject) -> None:
    model, kinematics = build_model(subject), Kinematics.from_subject(subject)
    names = {
        "trackers": [tracker_site(tracker) for tracker in subject.trackers],
        "ends": [end_site(body) for body in BODY_NAMES],
    }
    poses = random_poses(12, 5)
    ours = jacobians(kinematics, jnp.asarray(poses))
    for frame, qpos in enumerate(poses):
        data = mujoco_at(model, qpos)
        for field, sites in names.items():
            site_poses, jacobian = ours[field]
            ids = [model.site(name).id for name in sites]
            quaternions = np.zeros((len(ids), 4))
            for quaternion, site in zip(quaternions, ids, strict=True):
                mujoco.mju_mat2Quat(quaternion, data.site_xmat[site])
            theirs = np.stack([site_jacobian(model, data, name) for name in sites])
            assert jacobian.shape == (len(poses), len(sites), 6, TANGENT_SIZE)
            np.testing.assert_allclose(jacobian[frame], theirs, atol=EXACT)
            np.testing.assert_allclose(site_poses.positions[frame], data.site_xpos[ids], atol=EXACT)
            assert_same_rotations(site_poses.quaternions[frame], quaternions)


def test_the_jacobian_is_the_derivative_along_a_step() -> None:
    subject = random_subject(5)
    kinematics = Kinematics.from_subject(subject)
    qpos = jnp.asarray(random_poses(13, 1)[0])

    def positions(step: jax.Array) -> jax.Array:
        return kinematics.tracker_poses(integrate(qpos, step)).positions

    ours = jacobians(kinematics, qpos[None])["trackers"][1][0]
    numeric = jax.jit(jax.jacfwd(positions))(jnp.zeros(TANGENT_SIZE))
    np.testing.assert_allclose(ours[:, :3], numeric, atol=EXACT)


@every_subject
def test_batches_of_poses_are_mujocos(subject: Subject) -> None:
    model, kinematics = build_model(subject), Kinematics.from_subject(subject)
    qpos = random_poses(14, 6)
    ends = bone_ends_batch(kinematics, jnp.asarray(qpos))
    trackers = tracker_poses_batch(kinematics, jnp.asarray(qpos))
    end_ids = [model.site(end_site(body)).id for body in BODY_NAMES]
    tracker_ids = [model.site(tracker_site(tracker)).id for tracker in subject.trackers]
    assert ends.shape == (6, 31, 3)
    assert trackers.quaternions.shape == (6, len(subject.trackers), 4)
    for frame, pose in enumerate(qpos):
        data = mujoco_at(model, pose)
        np.testing.assert_allclose(ends[frame], data.site_xpos[end_ids], atol=EXACT)
        np.testing.assert_allclose(
            trackers.positions[frame], data.site_xpos[tracker_ids], atol=EXACT
        )


def test_batches_of_subjects_share_one_program() -> None:
    """The arrays of a subject are traced, so that one program serves all of one tree."""
    traces = 0

    @eqx.filter_jit
    def ends(kinematics: Kinematics, qpos: jax.Array) -> jax.Array:
        nonlocal traces
        traces += 1
        return kinematics.bone_ends(qpos)

    qpos = jnp.asarray(random_poses(16, 1)[0])
    shifted = [canonical_subject(), canonical_subject().mirrored()]
    results = [ends(Kinematics.from_subject(subject), qpos) for subject in shifted]
    assert traces == 1
    assert results[0].shape == results[1].shape


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-8, 0.1, 0.5]))
def test_integrate_is_mujocos_and_difference_undoes_it(seed: int, size: float) -> None:
    model = build_model(canonical_subject())
    start = random_poses(seed, 1)[0]
    step = size * np.random.default_rng(seed).normal(size=TANGENT_SIZE)
    theirs = start.copy()
    mujoco.mj_integratePos(model, theirs, step, 1.0)
    ours = np.asarray(integrate(jnp.asarray(start), jnp.asarray(step)))
    np.testing.assert_allclose(ours[:3], theirs[:3], atol=EXACT)
    np.testing.assert_allclose(ours[7:], theirs[7:], atol=EXACT)
    assert abs(abs(ours[3:7] @ theirs[3:7]) - 1.0) < EXACT
    # A root turned by more than half a turn comes back the shorter way.
    if np.linalg.norm(step[3:6]) < np.pi - 1e-3:
        back = difference(jnp.asarray(start), jnp.asarray(ours))
        np.testing.assert_allclose(back, step, atol=1e-9)


def test_other_trees_are_refused() -> None:
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="root")
    body.add_geom(size=[0.1, 0, 0])
    body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE)
    with pytest.raises(ValueError, match="free root"):
        Kinematics.from_model(spec.compile(), [])
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="root")
    body.add_freejoint()
    body.add_geom(size=[0.1, 0, 0])
    arm = body.add_body(name="arm")
    arm.add_geom(size=[0.1, 0, 0])
    arm.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE)
    with pytest.raises(ValueError, match="joint slide"):
        Kinematics.from_model(spec.compile(), [])
