"""Rotations against SciPy, and every derivative against finite differences."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body import rotations

SEEDS = st.integers(0, 2**32 - 1)

# Where formulas break: at zero, where series take over (1e-4), near and at half a turn.
ANGLES = st.one_of(
    st.floats(0.0, np.pi),
    st.sampled_from([0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-4, 1.0000001e-4, 9.999999e-5, np.pi / 2]),
    st.floats(1e-12, 1e-3).map(lambda gap: np.pi - gap),
)


def unit(seed: int) -> ndarray:
    vector = np.random.default_rng(seed).normal(size=3)
    return vector / np.linalg.norm(vector)


def scipy_rotation(q: ndarray) -> Rotation:
    return Rotation.from_quat(np.asarray(q), scalar_first=True)


def random_quaternions(seed: int, *shape: int) -> ndarray:
    q = np.random.default_rng(seed).normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def numeric_jacobian(function: Callable[[ndarray], ndarray], step: float = 1e-6) -> ndarray:
    columns = [(function(step * e) - function(-step * e)) / (2.0 * step) for e in np.eye(3)]
    return np.stack(columns, axis=-1)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_products_turns_and_matrices_are_scipys(seed: int) -> None:
    a, b = random_quaternions(seed, 2, 5)
    v = np.random.default_rng(seed + 1).normal(size=(5, 3))
    product = scipy_rotation(a) * scipy_rotation(b)
    np.testing.assert_allclose(
        rotations.to_matrix(rotations.multiply(jnp.asarray(a), jnp.asarray(b))),
        product.as_matrix(),
        atol=1e-14,
    )
    np.testing.assert_allclose(
        rotations.rotate(jnp.asarray(a), jnp.asarray(v)), scipy_rotation(a).apply(v), atol=1e-14
    )
    np.testing.assert_allclose(
        rotations.rotate(rotations.conjugate(jnp.asarray(a)), jnp.asarray(v)),
        scipy_rotation(a).apply(v, inverse=True),
        atol=1e-14,
    )
    np.testing.assert_allclose(
        rotations.cross(jnp.asarray(v), jnp.asarray(v[::-1])), np.cross(v, v[::-1]), atol=1e-14
    )
    np.testing.assert_allclose(
        jnp.einsum("bij,bj->bi", rotations.skew(jnp.asarray(v)), v[::-1]),
        np.cross(v, v[::-1]),
        atol=1e-14,
    )


@settings(max_examples=80, deadline=None)
@given(seed=SEEDS, angle=ANGLES, flip=st.booleans())
def test_exp_and_log_are_scipys_and_undo_each_other(seed: int, angle: float, flip: bool) -> None:
    vector = angle * unit(seed)
    q = np.asarray(rotations.exp(jnp.asarray(vector)))
    assert abs(np.linalg.norm(q) - 1.0) < 1e-15 * 8
    error = scipy_rotation(q).inv() * Rotation.from_rotvec(vector)
    assert error.magnitude() < 1e-14
    # q and -q are one rotation.
    back = np.array(rotations.log(jnp.asarray(-q if flip else q)))
    if angle < np.pi - 1e-9:
        # Close to half a turn the sine, from which the angle is taken, is still exact.
        np.testing.assert_allclose(back, vector, rtol=1e-9, atol=1e-15)
    else:
        assert abs(np.linalg.norm(back) - np.pi) < 1e-8
        assert (Rotation.from_rotvec(back).inv() * scipy_rotation(q)).magnitude() < 1e-8


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, angle=st.floats(-7.0, 7.0))
def test_hinges_are_rotation_vectors(seed: int, angle: float) -> None:
    axis = unit(seed)
    q = rotations.hinge(jnp.asarray(axis), jnp.asarray(angle))
    error = scipy_rotation(np.asarray(q)).inv() * Rotation.from_rotvec(angle * axis)
    assert error.magnitude() < 1e-14


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, angle=ANGLES)
def test_right_jacobian_is_the_derivative_of_exp(seed: int, angle: float) -> None:
    vector = angle * unit(seed)
    inverse = Rotation.from_rotvec(vector).inv()

    def moved(d: ndarray) -> ndarray:
        return (inverse * Rotation.from_rotvec(vector + d)).as_rotvec()

    np.testing.assert_allclose(
        rotations.right_jacobian(jnp.asarray(vector)), numeric_jacobian(moved), atol=1e-8
    )


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, angle=ANGLES.filter(lambda angle: angle < np.pi - 1e-4))
def test_inverse_left_jacobian_is_the_derivative_of_log(seed: int, angle: float) -> None:
    vector = angle * unit(seed)

    def moved(d: ndarray) -> ndarray:
        return (Rotation.from_rotvec(d) * Rotation.from_rotvec(vector)).as_rotvec()

    np.testing.assert_allclose(
        rotations.inverse_left_jacobian(jnp.asarray(vector)), numeric_jacobian(moved), atol=1e-7
    )


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, angle=ANGLES)
def test_the_jacobians_belong_together(seed: int, angle: float) -> None:
    """The right Jacobian is the transposed left one, at half a turn too."""
    vector = jnp.asarray(angle * unit(seed))
    left = rotations.right_jacobian(vector).T
    np.testing.assert_allclose(rotations.inverse_left_jacobian(vector) @ left, np.eye(3), atol=1e-9)


AT_THE_EDGES = [
    [0.0, 0.0, 0.0], [1e-300, 0.0, 0.0], [0.0, 1e-160, 0.0], [1e-9, 0.0, 1e-9], [0.0, 0.0, 1e-4],
    [np.pi, 0.0, 0.0], [0.0, -np.pi, 0.0], [np.nextafter(np.pi, 4), 0.0, 0.0],
]  # fmt: skip


def all_derivatives(function: Callable[[jax.Array], jax.Array], points: list) -> ndarray:
    """Values, forward and reverse derivatives, one row a point."""

    def at(point: jax.Array) -> jax.Array:
        parts = function(point), jax.jacfwd(function)(point), jax.jacrev(function)(point)
        return jnp.concatenate([part.ravel() for part in parts])

    return np.array(jax.jit(jax.vmap(at))(jnp.array(points)))


@pytest.mark.parametrize("name", ["exp", "right_jacobian", "inverse_left_jacobian"])
def test_values_and_derivatives_are_finite_at_the_edges(name: str) -> None:
    assert np.isfinite(all_derivatives(getattr(rotations, name), AT_THE_EDGES)).all()


def test_log_is_finite_at_the_edges() -> None:
    edges = [
        [1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-0.0, 0.0, -1.0, 0.0],
        [1e-17, 0.6, 0.8, 0.0], [-1e-17, 0.6, 0.8, 0.0], [1.0, 1e-200, 0.0, 0.0],
    ]  # fmt: skip
    results = all_derivatives(rotations.log, edges)
    assert np.isfinite(results).all()
    assert np.all(np.linalg.norm(results[:, :3], axis=1) <= np.pi + 1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, angle=ANGLES.filter(lambda angle: angle < np.pi - 1e-3))
def test_autodiff_through_exp_and_log_is_right(seed: int, angle: float) -> None:
    vector = jnp.asarray(angle * unit(seed))
    round_trip = jax.jacfwd(lambda v: rotations.log(rotations.exp(v)))(vector)
    np.testing.assert_allclose(round_trip, np.eye(3), atol=1e-9)
