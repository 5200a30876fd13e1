"""Which clips settings may be chosen by; everything else is for reporting only."""

from collections.abc import Sequence
from typing import Final

from localreg.motion.motion import Motion

SAMPLE_STRIDE: Final = range(1, 36, 6)
"""Of the sample set's 36 walks, by their place: every sixth from the second."""

CMU_SUBJECTS: Final = ("01", "02")
"""Of varied CMU motion: playground and mixed actions of two people."""


def tuning_clips(motions: Sequence[Motion]) -> list[Motion]:
    """The clips of a source that may be used for tuning.

    Of the sample set every sixth, else those of two subjects; where there are none of
    those, every sixth as well.
    """
    chosen = [motion for motion in motions if motion.provenance.subject in CMU_SUBJECTS]
    return chosen or list(motions[SAMPLE_STRIDE.start :: SAMPLE_STRIDE.step])
