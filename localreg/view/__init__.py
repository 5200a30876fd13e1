"""Seeing a body move: what is drawn of an instant, and where it is drawn."""

from localreg.view.moment import (
    Heard,
    Moment,
    NeighborClip,
    Observer,
    Timing,
    TrackerMoment,
)
from localreg.view.scene import LOOKS, Look, Stage, Style, build_stage

__all__ = [
    "LOOKS",
    "Heard",
    "Look",
    "Moment",
    "NeighborClip",
    "Observer",
    "Stage",
    "Style",
    "Timing",
    "TrackerMoment",
    "build_stage",
]
