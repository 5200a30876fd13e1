import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sensors import rotation

component = st.floats(-1.0, 1.0)


@st.composite
def quaternions(draw: st.DrawFn) -> np.ndarray:
    v = np.array([draw(component) for _ in range(4)])
    if np.linalg.norm(v) < 1e-3:
        v = np.array([1.0, 0.0, 0.0, 0.0])
    return rotation.normalize(v)


def test_yaw_of_ten_degrees():
    q = rotation.from_euler(np.array([math.radians(10.0), 0.0, 0.0]))
    np.testing.assert_allclose(q, [0.9962, 0.0, 0.0, 0.0872], atol=5e-5)


@given(quaternions(), quaternions())
def test_product_and_matrix_agree(a, b):
    np.testing.assert_allclose(
        rotation.to_matrix(rotation.multiply(a, b)),
        rotation.to_matrix(a) @ rotation.to_matrix(b),
        atol=1e-12,
    )


@given(quaternions())
def test_matrix_round_trip_including_half_turns(q):
    for p in (q, np.array([0.0, *rotation.normalize(q[1:] + 1e-9)])):
        assert float(rotation.angle_between(rotation.from_matrix(rotation.to_matrix(p)), p)) < 1e-7


@given(quaternions(), quaternions(), st.floats(-0.5, 1.5))
def test_slerp_turns_at_constant_speed(a, b, f):
    angle = float(rotation.angle_between(a, b))
    q = rotation.slerp(a, b, np.array(f))
    assert np.linalg.norm(q) == pytest.approx(1.0)
    if angle < 2.0:
        assert float(rotation.angle_between(a, q)) == pytest.approx(abs(f) * angle, abs=1e-6)


@given(quaternions())
def test_slerp_between_equal_and_opposite_signs_stays(q):
    for other in (q, -q):
        assert float(rotation.angle_between(rotation.slerp(q, other, np.array(0.3)), q)) < 1e-7
