"""How soon a method is back to its usual errors once a disturbance is over."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.evaluation.metrics import SETTLING_FRAMES

BACK: Final = 1.1
"""How many times the undisturbed error still counts as recovered."""


def frames_to_recover(
    error: Float[ndarray, " frames"], undisturbed: Float[ndarray, " frames"], end: int
) -> int:
    """Frames from the end of a disturbance until the error is no more than `BACK` times.

    Args:
        error: frame by frame, in any unit.
        undisturbed: what it is without the disturbance, or would be.
        end: the first frame after the disturbance.

    Returns:
        0 where the first frame is well already; all that are left where none is.
    """
    well = np.flatnonzero(error[end:] <= BACK * undisturbed[end:])
    return int(well[0]) if well.size else len(error) - end


def recovery_s(
    error: Float[ndarray, " frames"], all_there: Bool[ndarray, " frames"], rate: float
) -> float | None:
    """How long errors outlast dropouts, mean over the gaps [s].

    From the first frame with all trackers back until the error is no more than `BACK` times
    its median over frames that are a second and more after any gap (or, if there is none
    such, over all frames without a gap). Where the next gap comes sooner, until then.

    Args:
        error: frame by frame.
        all_there: in which frames no tracker is away.
        rate: frames a second [Hz].

    Returns:
        None without gaps, or without frames between them.
    """
    ends = np.flatnonzero(all_there[1:] & ~all_there[:-1]) + 1
    if not ends.size:
        return None
    since = np.arange(len(error)) - np.maximum.accumulate(
        np.where(all_there, -len(error), np.arange(len(error)))
    )
    counted = np.arange(len(error)) >= SETTLING_FRAMES
    calm = all_there & (since >= rate) & counted
    calm = calm if calm.any() else all_there & counted
    if not calm.any():
        return None
    usual = np.full(len(error), np.median(error[calm]))
    away = np.flatnonzero(~all_there)
    spans = []
    for end in ends:
        later = away[away > end]
        stop = int(later[0]) if later.size else len(error)
        spans.append(frames_to_recover(error[:stop], usual[:stop], int(end)))
    return float(np.mean(spans)) / rate
