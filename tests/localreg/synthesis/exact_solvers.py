"""Both solvers at tolerances far below what a live frame needs.

The reference takes half a minute to compile for each cap and tolerance: use these alone.
"""

from typing import Final

from localreg.synthesis.reference_solver import ReferenceSolver
from localreg.synthesis.solver import CompiledSolver

CAP: Final = 200
COMPILED: Final = CompiledSolver(tolerance=1e-12)
REFERENCE: Final = ReferenceSolver(rtol=1e-9, atol=1e-9)
