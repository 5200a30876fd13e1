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
    n = len(H)
    for i in range(n):
        for j in range(i + 1):
            total = H[i, j]
            if i == j:
                total *= 1.0 + damping
            row_i, row_j = L[i], L[j]
            for k in range(j):
                total -= row_i[k] * row_j[k]
            if i == j:
                if not total > 0.0:
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
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
def positive_inverse(A):
    """The inverse of a symmetric positive definite matrix; NaN where it is not definite."""
    L, M = np.zeros_like(A), np.zeros_like(A)
    if not factorize(A, 0.0, L):
        return np.full_like(A, np.nan)
    invert_triangle(L, M)
    return np.dot(M.T, M)
