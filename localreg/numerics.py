"""How this package computes: in double precision, on the calling thread.

The matrices of one frame are far too small for a second thread: idle workers of OpenBLAS
spin for work, and on two cores shared with a sensor driver that raised a frame from 4 ms to
between 10 and 600 ms. Work that is worth several cores is split over processes.

`localreg.jax_numerics` does the same for JAX, which live frames do without.
"""

import scipy.linalg as scipy_linalg  # what compiled code and XLA call: load it to limit it
from threadpoolctl import threadpool_limits

__all__ = ["scipy_linalg"]

threadpool_limits(limits=1)
