"""A body placed rigidly where trackers are, whatever they tell."""

import numpy as np
import pytest
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.synthesis.alignment import align_root
from tests.localreg.synthesis.planted import (
    ALL,
    BODY,
    CHAIN,
    NONE,
    bone_end_error,
    observe,
    standing_pose,
)

TORSO = 1


def only(*trackers: int) -> ndarray:
    return np.isin(np.arange(6), trackers)


def turn_between(one: ndarray, other: ndarray) -> float:
    """Angle between the roots of two poses [rad]."""
    a, b = (Rotation.from_quat(np.asarray(q)[3:7], scalar_first=True) for q in (one, other))
    return float((a.inv() * b).magnitude())


def aligned(truth: ndarray, positions: ndarray, orientations: ndarray, fallback: int) -> ndarray:
    observation = observe(truth, positions, orientations)
    qpos = align_root(CHAIN, standing_pose(fallback), truth[7:], observation)
    assert np.linalg.norm(qpos[3:7]) == pytest.approx(1.0)
    np.testing.assert_array_equal(qpos[7:], truth[7:])
    return qpos


@pytest.mark.parametrize(
    ("positions", "orientations"),
    [(ALL, ALL), (ALL, NONE), (only(0, 2, 5), NONE), (only(3), only(3)), (only(0), only(4, 5)),
     (only(1, 2), only(1))],
    ids=["all", "positions", "three positions", "one tracker", "mixed", "two and one"],
)  # fmt: skip
def test_a_rigid_motion_is_found(positions, orientations):
    """From any fallback: its thousandth part of the weight turns the body by less than that."""
    for seed in range(12):
        truth = standing_pose(seed)
        qpos = aligned(truth, positions, orientations, fallback=100 + seed)
        assert turn_between(qpos, truth) < 1e-3
        assert bone_end_error(qpos, truth) < 1e-3


def test_orientations_alone_leave_the_place_to_the_fallback():
    for seed in range(12):
        truth = standing_pose(seed)
        qpos = aligned(truth, NONE, ALL, fallback=100 + seed)
        assert turn_between(qpos, truth) < 1e-3
        np.testing.assert_array_equal(qpos[:3], standing_pose(100 + seed)[:3])


def test_one_position_alone_leaves_the_turn_to_the_fallback():
    truth = standing_pose(1)
    qpos = aligned(truth, only(4), NONE, fallback=101)
    assert turn_between(qpos, standing_pose(101)) < 1e-6
    ours, theirs = (BODY.tracker_poses(q[None]).positions[0, 4] for q in (qpos, truth))
    np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_two_positions_leave_the_turn_about_their_line_to_the_fallback():
    truth = standing_pose(2)
    fallback = truth.copy()
    fallback[:3] += 1.0
    observation = observe(truth, only(2, 3), NONE)
    qpos = align_root(CHAIN, fallback, truth[7:], observation)
    assert bone_end_error(qpos, truth) < 1e-3


def test_without_trackers_the_root_is_the_fallbacks():
    truth, fallback = standing_pose(3), standing_pose(103)
    qpos = aligned(truth, NONE, NONE, fallback=103)
    np.testing.assert_allclose(qpos[:3], fallback[:3])
    assert turn_between(qpos, fallback) < 1e-6


def test_a_mirrored_body_is_not_an_answer():
    """Positions of a mirror image must still give a rotation."""
    truth = standing_pose(4)
    observation = observe(truth, ALL, NONE)
    mirrored = observation._replace(positions=observation.positions * [-1.0, 1.0, 1.0])
    qpos = align_root(CHAIN, standing_pose(104), truth[7:], mirrored)
    assert np.linalg.norm(qpos[3:7]) == pytest.approx(1.0)
    residual = BODY.tracker_poses(qpos[None]).positions[0] - mirrored.positions
    # A body width off at most: a reflection taken for a rotation would be a body height off.
    assert np.linalg.norm(residual, axis=1).max() < 1.0
