"""The published regressions: input-output projections of K examples ([P]).

Both functions take inputs X (K x n), outputs Y (K x d), the present input x and a rank, and
return the prediction with the standard deviations of the training residuals about it. [P]
"realtime motion control with local regression models and six inertial sensors".
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from localreg import jax_numerics as jax_numerics

_BISECTIONS = 60  # halves the bracket of an eigenvalue down to double precision
_NULL = 1e-13  # eigenvalues below this share of the largest are rounding errors
_LEAST_INPUT = 1e-6  # 1 - |u_y|^2 below which a subspace says nothing about the output


def per_dof_projection(
    X: Float[Array, "K n"], Y: Float[Array, "K d"], x: Float[Array, " n"], rank: int
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    """The published prior: input-output PCA for each output on its own.

    For output d the r leading right singular vectors of A_d = [X, y_d], split into U_x and
    u_y, give alpha_d = U_x u_y / (1 - |u_y|^2). All outputs share X X^T, so it is
    diagonalized once; each A_d A_d^T = X X^T + y_d y_d^T is a rank-one change of it, whose
    eigenvalues are roots of the secular equation 1 + sum z_i^2 / (g_i - lambda) = 0
    (Golub 1973), found by bisection between neighbouring g_i. Nothing n x n is formed.

    Returns:
        The predictions, and the standard deviations of the K training residuals about
        them, both shape (d,). [P], equations of its section on online local models.
    """
    rank = min(rank, len(X))
    X, center = _centered(X)
    Y, mean = _centered(Y)
    x = x - center
    gram = X @ X.T
    g, V = jnp.linalg.eigh(gram)
    g, V = jnp.maximum(g[::-1], 0.0), V[:, ::-1]  # descending
    z = (V.T @ Y).T  # (d, K)
    # Deflation: outputs without a component along an eigenvector keep a hair of one.
    scale = jnp.maximum(jnp.linalg.norm(z, axis=1, keepdims=True), 1e-12)
    z = jnp.where(jnp.abs(z) < 1e-10 * scale, 1e-10 * scale, z)
    shift, directions = _secular(g, z, rank)  # (d, r), (d, r, K)
    eigenvalues = g[:rank] + shift
    inverse_root = _inverse_root(eigenvalues)
    u_y = jnp.einsum("drk,dk->dr", directions, z) * inverse_root
    # |u_y|^2 -> 1: the subspace lies along the output and says nothing about it.
    share = jnp.sum(u_y * u_y, axis=1)
    gain = u_y / jnp.maximum(1.0 - share, _LEAST_INPUT)[:, None]
    along = jnp.einsum("drk,k->dr", directions, V.T @ (X @ x)) * inverse_root
    fitted = jnp.einsum("drk,dr->dk", directions * g, gain * inverse_root)
    residuals = (z - fitted) ** 2  # V is orthogonal: the norm is that of Y - X alpha
    return mean + jnp.sum(along * gain, axis=1), jnp.sqrt(jnp.mean(residuals, axis=1))


def joint_projection(
    X: Float[Array, "K n"], Y: Float[Array, "K d"], x: Float[Array, " n"], rank: int
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    """Input-output PCA of all outputs at once: one decomposition of [X, Y].

    alpha = U_y (U_x^T U_x)^-1 U_x^T. Returns predictions and the standard deviations of
    the training residuals, both shape (d,).
    """
    X, center = _centered(X)
    Y, mean = _centered(Y)
    x = x - center
    values, V = jnp.linalg.eigh(X @ X.T + Y @ Y.T)
    values, V = values[::-1][:rank], V[:, ::-1][:, :rank]
    scale = _inverse_root(values)
    U_x, U_y = X.T @ V * scale, Y.T @ V * scale
    inner, Q = jnp.linalg.eigh(U_x.T @ U_x)
    scores = Q.T @ (U_x.T @ jnp.concatenate([x[:, None], X.T], axis=1))
    predicted = U_y @ (Q @ (scores / jnp.maximum(inner, _LEAST_INPUT)[:, None]))
    residuals = Y - predicted[:, 1:].T
    return mean + predicted[:, 0], jnp.sqrt(jnp.mean(residuals**2, axis=0))


def _centered(A: Float[Array, "K n"]) -> tuple[Float[Array, "K n"], Float[Array, " n"]]:
    """Rows about their mean, and the mean; a column that never changes is exactly zero.

    Otherwise rounding errors of the mean would be all that is left of equal examples, and
    would be scaled up to a direction.
    """
    center = jnp.mean(A, axis=0)
    return jnp.where(jnp.ptp(A, axis=0) > 0.0, A - center, 0.0), center


def _inverse_root(eigenvalues: Float[Array, "*d r"]) -> Float[Array, "*d r"]:
    """1 / sqrt of eigenvalues, descending; zero for directions that are not there."""
    there = eigenvalues > jnp.maximum(_NULL * eigenvalues[..., :1], 1e-200)
    return jnp.where(there, 1.0 / jnp.sqrt(jnp.where(there, eigenvalues, 1.0)), 0.0)


def _secular(
    g: Float[Array, " K"], z: Float[Array, "d K"], rank: int
) -> tuple[Float[Array, "d r"], Float[Array, "d r K"]]:
    """The leading eigenpairs of diag(g) + z z^T, g descending.

    Eigenvalue k lies between g_k and g_(k-1), the first below g_0 + |z|^2. It is kept as
    its distance from g_k, in which the eigenvector z_i / (g_i - lambda) loses no digits.

    Returns:
        The distances, and the unit eigenvectors in the basis of diag(g).
    """
    gaps = jnp.concatenate([jnp.full(1, jnp.inf), g[:-1] - g[1:]])[:rank]
    squares = z * z
    low = jnp.zeros((len(z), rank), dtype=g.dtype)
    high = jnp.minimum(gaps[None, :], jnp.sum(squares, axis=1, keepdims=True))
    distance = g[None, :] - g[:rank, None]  # (r, K): g_i - g_k

    def halve(bracket: tuple[Array, Array], _: None) -> tuple[tuple[Array, Array], None]:
        low, high = bracket
        middle = 0.5 * (low + high)
        poles = distance[None] - middle[:, :, None]
        poles = jnp.where(poles == 0.0, 1e-300, poles)
        rising = 1.0 + jnp.sum(squares[:, None, :] / poles, axis=2) < 0.0
        return (jnp.where(rising, middle, low), jnp.where(rising, high, middle)), None

    (low, high), _ = jax.lax.scan(halve, (low, high), None, length=_BISECTIONS)
    shift = 0.5 * (low + high)
    poles = distance[None] - shift[:, :, None]
    vectors = z[:, None, :] / jnp.where(poles == 0.0, 1e-300, poles)
    return shift, vectors / jnp.linalg.norm(vectors, axis=2, keepdims=True)
