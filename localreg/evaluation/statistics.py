"""How sure a difference between two methods is: paired bootstrap over clips."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import bootstrap

LEVEL: Final = 0.95
"""Confidence level of the intervals."""

_RESAMPLES: Final = 9999
_FEWEST: Final = 3  # clips below which an interval says nothing


@dataclass(frozen=True, slots=True)
class Difference:
    """The mean of one method's figure minus another's over the same clips.

    Attributes:
        mean: of the differences; negative where the first method's figure is lower.
        low: lower end of the confidence interval; None where there is none.
        high: its upper end.
        clips: how many both have a figure for.
    """

    mean: float | None
    low: float | None
    high: float | None
    clips: int

    @property
    def is_sure(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low is not None and self.high is not None and self.low * self.high > 0.0


def paired_difference(
    one: Sequence[float | None], other: Sequence[float | None], *, seed: int = 0
) -> Difference:
    """Compare two methods' figures of the same clips, clip by clip.

    The clips are what is resampled (Efron's bootstrap, bias-corrected and accelerated):
    frames of one clip are too alike to count as independent.

    Args:
        one: a figure of the first method for every clip; None where it could not be had.
        other: the same of the second method, in the same order.
        seed: of the resampling.

    Raises:
        ValueError: the numbers of clips differ.
    """
    pairs = [(a, b) for a, b in zip(one, other, strict=True) if a is not None and b is not None]
    differences = np.array([a - b for a, b in pairs])
    if not pairs or not np.all(np.isfinite(differences)):
        return Difference(None, None, None, len(pairs))
    mean = float(differences.mean())
    if len(pairs) < _FEWEST:
        return Difference(mean, None, None, len(pairs))
    if np.ptp(differences) <= 1e-12 * max(1.0, float(np.abs(differences).max())):
        return Difference(mean, mean, mean, len(pairs))
    found = bootstrap(
        (differences,),
        np.mean,
        confidence_level=LEVEL,
        n_resamples=_RESAMPLES,
        method="BCa",
        rng=np.random.default_rng(seed),
    )
    low, high = found.confidence_interval
    return Difference(mean, float(low), float(high), len(pairs))
