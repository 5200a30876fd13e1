"""Axes of bones from directions."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.motion.bone_frames import frame_about, frame_along, mean_turn, shortest_turn, unit

EAST, NORTH = np.eye(3)[:2]


@pytest.mark.parametrize("seed", range(20))
def test_the_shortest_turn_is_scipys(seed):
    start, end = np.random.default_rng(seed).normal(size=(2, 3))
    turn = Rotation.from_matrix(shortest_turn(unit(start), unit(end)))
    expected, _ = Rotation.align_vectors(unit(end), unit(start))
    assert (turn * expected.inv()).magnitude() < 1e-7


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_half_a_turn_brings_a_direction_to_its_opposite(axis, sign):
    start = sign * np.eye(3)[axis]
    turn = shortest_turn(start, -start)
    np.testing.assert_allclose(turn @ start, -start, atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1.0)
    np.testing.assert_allclose(shortest_turn(start, start), np.eye(3), atol=1e-12)


def test_frames_keep_one_axis_and_come_near_to_another():
    beside = unit(np.array([0.3, 0.8, 0.2]))
    along, about = frame_along(EAST, beside), frame_about(NORTH, beside)
    np.testing.assert_allclose(along[:, 0], EAST)
    np.testing.assert_allclose(about[:, 1], NORTH)
    for frame, column in ((along, 1), (about, 0)):
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert frame[:, column] @ beside > 0.0


def test_the_mean_turn_lies_in_the_middle():
    turns = Rotation.from_rotvec([[0.0, 0.0, 0.2], [0.0, 0.0, 0.6]]).as_matrix()
    middle = Rotation.from_matrix(mean_turn(turns)).as_rotvec()
    np.testing.assert_allclose(middle, [0.0, 0.0, 0.4], atol=1e-12)
