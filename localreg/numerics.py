"""How this package computes: double precision, on the CPU, on the calling thread.

float32 makes Levenberg-Marquardt stall at a relative tolerance of 1e-4. The matrices of
one frame are far too small for a second thread: idle workers of OpenBLAS and XLA spin for
work, and on two cores shared with a sensor driver that raised a frame from 4 ms to
between 10 and 600 ms. Work that is worth several cores is split over processes.

Import before `jax.numpy`.
"""

import os
from typing import Any

# The size of XLA's thread pool; it has no option of its own.
os.environ.setdefault("NPROC", "1")

import jax
import scipy.linalg as scipy_linalg  # XLA's LAPACK is SciPy's: load it before limiting it
from threadpoolctl import threadpool_limits

__all__ = ["host_arrays", "jax", "scipy_linalg"]

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")
threadpool_limits(limits=1)


def host_arrays(*arrays: Any) -> Any:
    """NumPy arrays on their way into a compiled function, which takes them as they are.

    Only types change: converting them beforehand would cost as much as a regression.
    """
    return arrays
