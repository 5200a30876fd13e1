"""The compiled kinematics equals MuJoCo's and the JAX one: places, rotations, Jacobians."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body import chain, kinematics, rotations
from localreg.body.chain import Placed, blank_placed, place, place_trackers
from localreg.body.kinematics import Kinematics
from localreg.body.model import build_model, tracker_site
from localreg.body.skeleton import DOF_NAMES, TANGENT_SIZE
from localreg.body.subject import Subject, canonical_subject
from tests.localreg.body.random_body import random_poses, random_subject

EXACT = 1e-9
SUBJECTS = [
    canonical_subject(), random_subject(1), random_subject(2, missing_bones=8),
    random_subject(3, missing_bones=30), random_subject(4, trackers=1),
]  # fmt: skip
every_subject = pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
AXES = [np.array([1.0, 0.0, 0.0]), np.array([0.48, -0.6, 0.64]), np.array([-0.6, 0.0, -0.8])]
TURNS = [0.0, 1e-300, 1e-12, 1e-7, 0.99e-4, 1.01e-4, 0.99e-3, 1.01e-3, 0.1, 2.0, 3.1]
CLOSE_TO_PI = [1e-3, 1e-7, 1e-12, 0.0]

jax_integrate, jax_difference = jax.jit(kinematics.integrate), jax.jit(kinematics.difference)
jax_jacobian = jax.jit(rotations.inverse_left_jacobian)


def placed_by(subject: Subject, qpos: ndarray) -> tuple[chain.Chain, Placed]:
    tree = chain.chain_of(subject)
    placed = blank_placed(tree)
    place(tree, qpos, placed)
    return tree, placed


def jacobian_of(tree: chain.Chain, placed: Placed) -> ndarray:
    out = np.full((len(tree.site_body), 6, TANGENT_SIZE), np.nan)
    chain.tracker_jacobian(tree, placed, out)
    return out


def logarithm(quaternion: ndarray) -> ndarray:
    out = np.full(3, np.nan)
    chain.logarithm(quaternion, out)
    return out


def exponential(vector: ndarray) -> ndarray:
    out = np.full(4, np.nan)
    chain.exponential(vector, out)
    return out


def inverse_left_jacobian(vector: ndarray) -> ndarray:
    out = np.full((3, 3), np.nan)
    chain.inverse_left_jacobian(vector, out)
    return out


def integrated(qpos: ndarray, step: ndarray) -> ndarray:
    out = np.full(63, np.nan)
    chain.integrate(qpos, step, out)
    return out


def difference(start: ndarray, end: ndarray) -> ndarray:
    out = np.full(62, np.nan)
    chain.difference(start, end, out)
    return out


def assert_same_rotations(ours: ndarray, theirs: ndarray) -> None:
    """Quaternions that may differ in sign."""
    aligned = ours * np.sign(np.sum(ours * theirs, axis=-1, keepdims=True))
    np.testing.assert_allclose(aligned, theirs, atol=EXACT)


@every_subject
def test_bodies_sites_and_jacobians_are_mujocos(subject: Subject) -> None:
    model = build_model(subject)
    data = mujoco.MjData(model)
    names = [tracker_site(tracker) for tracker in subject.trackers]
    ids = [model.site(name).id for name in names]
    for qpos in random_poses(11, 20):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        tree, placed = placed_by(subject, qpos)
        np.testing.assert_allclose(placed.position, data.xpos, atol=EXACT)
        assert_same_rotations(placed.orientation, data.xquat)
        np.testing.assert_allclose(placed.hinge_axis, data.xaxis[1:], atol=EXACT)
        np.testing.assert_allclose(placed.site_position, data.site_xpos[ids], atol=EXACT)
        turned = Rotation.from_quat(placed.site_orientation, scalar_first=True).as_matrix()
        np.testing.assert_allclose(turned.reshape(len(ids), 9), data.site_xmat[ids], atol=EXACT)
        linear, angular = np.zeros((3, TANGENT_SIZE)), np.zeros((3, TANGENT_SIZE))
        for ours, site in zip(jacobian_of(tree, placed), ids, strict=True):
            mujoco.mj_jacSite(model, data, linear, angular, site)
            np.testing.assert_allclose(ours, np.concatenate([linear, angular]), atol=EXACT)


def test_trackers_are_where_the_jax_kinematics_has_them() -> None:
    other = Kinematics.from_subject(SUBJECTS[1])
    poses = random_poses(12, 6)
    theirs = kinematics.tracker_poses_batch(other, jnp.asarray(poses))
    for index, qpos in enumerate(poses):
        positions, quaternions = place_trackers(chain.chain_of(SUBJECTS[1]), qpos)
        np.testing.assert_allclose(positions, theirs.positions[index], atol=EXACT)
        np.testing.assert_allclose(quaternions, theirs.quaternions[index], atol=EXACT)


def test_placing_again_leaves_nothing_of_before() -> None:
    tree, placed = placed_by(SUBJECTS[1], random_poses(13, 1)[0])
    qpos = random_poses(14, 1)[0]
    place(tree, qpos, placed)
    _, fresh = placed_by(SUBJECTS[1], qpos)
    for again, once in zip(placed, fresh, strict=True):
        np.testing.assert_array_equal(again, once)


@settings(max_examples=100, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 1e-8, 1e-4, 0.1, 0.5, 2.0]))
def test_integrate_is_the_other_one_and_difference_undoes_it(seed: int, size: float) -> None:
    start = random_poses(seed, 1)[0]
    step = size * np.random.default_rng(seed).normal(size=TANGENT_SIZE)
    end = integrated(start, step)
    np.testing.assert_allclose(end, jax_integrate(start, step), atol=EXACT)
    assert np.linalg.norm(end[3:7]) == pytest.approx(1.0, abs=1e-15)
    back = difference(start, end)
    np.testing.assert_allclose(back, jax_difference(start, end), atol=EXACT)
    # A root turned by more than half a turn comes back the shorter way.
    if np.linalg.norm(step[3:6]) < np.pi - 1e-3:
        np.testing.assert_allclose(back, step, atol=EXACT)
    np.testing.assert_allclose(integrated(start, back)[:3], end[:3], atol=EXACT)
    assert_same_rotations(integrated(start, back)[3:7], end[3:7])


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("turn", [*TURNS, *(np.pi - gap for gap in CLOSE_TO_PI)])
def test_exponential_and_logarithm_are_inverse_and_blind_to_signs(axis, turn) -> None:
    quaternion = exponential(turn * axis)
    expected = np.concatenate([[np.cos(turn / 2)], np.sin(turn / 2) * axis])
    np.testing.assert_allclose(quaternion, expected, atol=1e-15)
    found = logarithm(quaternion)
    np.testing.assert_allclose(found, turn * axis, atol=1e-12)
    # q and -q are one rotation; at exactly half a turn both of its vectors are right.
    other = logarithm(-quaternion)
    if turn == np.pi:
        other = other * np.sign(other @ axis)
    np.testing.assert_allclose(other, turn * axis, atol=1e-12)


@pytest.mark.parametrize("quaternion", [np.zeros(4), np.array([1.0, 1e-200, 0.0, 0.0])])
def test_logarithms_of_next_to_nothing_are_zero(quaternion) -> None:
    np.testing.assert_allclose(logarithm(quaternion), 0.0, atol=1e-150)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("turn", [*TURNS, *(np.pi - gap for gap in CLOSE_TO_PI)])
def test_the_inverse_left_jacobian_is_finite_and_right(axis, turn) -> None:
    """Up to half a turn, against the rotation module and against differences."""
    vector = turn * axis
    ours = inverse_left_jacobian(vector)
    np.testing.assert_allclose(ours, jax_jacobian(vector), atol=1e-8)
    if turn < np.pi - 1e-4:  # farther on the vector jumps to its opposite
        rotation = Rotation.from_rotvec(vector)
        for column, direction in zip(ours.T, np.eye(3), strict=True):
            ahead, behind = (
                logarithm((Rotation.from_rotvec(h * direction) * rotation).as_quat(
                    scalar_first=True
                ))
                for h in (1e-5, -1e-5)
            )  # fmt: skip
            np.testing.assert_allclose(column, (ahead - behind) / 2e-5, atol=1e-8)


def test_what_is_not_finite_stays_so_and_ends() -> None:
    """Compiled code must neither raise nor hang."""
    qpos = random_poses(15, 1)[0]
    qpos[7 + DOF_NAMES.index("lowerbackrx")] = np.nan
    tree, placed = placed_by(SUBJECTS[0], qpos)
    assert np.isnan(placed.site_position).any()
    assert np.isnan(jacobian_of(tree, placed)).any()
    assert np.isnan(logarithm(np.full(4, np.nan))).all()
    assert np.isnan(inverse_left_jacobian(np.full(3, np.nan))).all()
