"""How JAX computes here: double precision, on the CPU, on the calling thread.

float32 makes Levenberg-Marquardt stall at a relative tolerance of 1e-4; for threads see
`localreg.numerics`. Whatever imports JAX imports this module, too. Loading JAX takes longer
than everything that a live frame needs, so modules that serve the default method import
neither, nor a module that does, except inside a function that is asked for more.
"""

import os
from typing import Any

# The size of XLA's thread pool; it has no option of its own.
os.environ.setdefault("NPROC", "1")

import jax

from localreg import numerics as numerics

__all__ = ["host_arrays", "jax"]

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_platforms", "cpu")


def host_arrays(*arrays: Any) -> Any:
    """NumPy arrays on their way into a compiled function, which takes them as they are.

    Only types change: converting them beforehand would cost as much as a regression.
    """
    return arrays
