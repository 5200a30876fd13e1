"""Small symmetric positive definite matrices as machine code.

Calls of NumPy's `inv` and `solve` know nothing of symmetry and take twice as long.
"""

from typing import no_type_check

import numpy as np
from numba import njit

# Sums may be taken in any order, which lets the compiler use vector instructions.
_IN_ANY_ORDER = {"reassoc", "contract", "nsz"}


@njit(cache=True, fastmath=_IN_ANY_ORDER)
@no_type_check
def factorize(H, damping, L):
    """Cholesky factor of the lower triangle of H, its diagonal grown; False if there is none."""
    n, one = len(H), H.dtype.type(1.0)
    scale = np.empty(n, H.dtype)
    for i in range(n):
        # Two columns at a time, since each row that is read serves both.
        for j in range(0, i - 1, 2):
            left, right = H[i, j], H[i, j + 1]
            for k in range(j):
                left -= L[i, k] * L[j, k]
                right -= L[i, k] * L[j + 1, k]
            left *= scale[j]
            L[i, j], L[i, j + 1] = left, (right - left * L[j + 1, j]) * scale[j + 1]
        if i % 2:
            last = H[i, i - 1]
            for k in range(i - 1):
                last -= L[i, k] * L[i - 1, k]
            L[i, i - 1] = last * scale[i - 1]
        rest = H[i, i] * (one + damping)
        for k in range(i):
            rest -= L[i, k] * L[i, k]
        if not rest > 0.0:
            return False
        L[i, i] = np.sqrt(rest)
        scale[i] = one / L[i, i]
    return True


@njit(cache=True)
@no_type_check
def substitute(L, b, x):
    """Solve L L^T x = b for a lower triangular L."""
    n = len(b)
    x[:] = b
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        x[i] /= L[i, i]
        for k in range(i):
            x[k] -= L[i, k] * x[i]


@njit(cache=True)
@no_type_check
def invert_triangle(L, M):
    """Write the inverse of a lower triangular L; what is above the diagonal stays as it is."""
    one = L.dtype.type(1.0)
    for i in range(len(L)):
        scale = one / L[i, i]
        M[i, : i + 1] = 0
        for k in range(i):
            factor = scale * L[i, k]
            for j in range(k + 1):
                M[i, j] -= factor * M[k, j]
        M[i, i] = scale


@njit(cache=True)
@no_type_check
def _inverse_at_once(A):
    L, M = np.zeros_like(A), np.zeros_like(A)
    if not factorize(A, A.dtype.type(0.0), L):
        return np.full_like(A, np.nan)
    invert_triangle(L, M)
    return np.dot(M.T, M)


@njit(cache=True)
@no_type_check
def positive_inverse(A):
    """The inverse of a symmetric positive definite matrix; NaN where it is not definite.

    By halves (Schur's complement), so that most of it is products of matrices.
    """
    half = len(A) // 2
    below = A[half:, :half].copy()
    first = _inverse_at_once(A[:half, :half].copy())
    carried = np.dot(below, first)
    last = _inverse_at_once(A[half:, half:] - np.dot(carried, below.T))
    corner = np.dot(last, carried)
    first += np.dot(carried.T, corner)
    inverse = np.empty_like(A)
    inverse[:half, :half], inverse[half:, half:] = first, last
    inverse[half:, :half], inverse[:half, half:] = -corner, -corner.T
    return inverse
