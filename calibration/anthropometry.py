"""Lengths of body segments from published tables, so that no motion data is needed.

Ratios of segment lengths to stature are those of Drillis and Contini, "Body segment
parameters", 1966, as tabulated by Winter, "Biomechanics and motor control of human
movement". Statures are those of the ANSUR II survey (Gordon et al., 2014), men and women in
equal parts. Only the figures are theirs.

Joints of the canonical skeleton are where CMU's fits put them, which is not always where
an anthropometer finds a landmark; so a ratio is only as good as its `spread` says.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg.body.skeleton import BONE_NAMES, mirror_name

GROUPS: Final[tuple[str, ...]] = (
    "hipjoint", "femur", "tibia", "foot", "toes", "lowerback", "upperback", "thorax",
    "lowerneck", "upperneck", "head", "clavicle", "humerus", "radius", "wrist", "hand",
    "fingers", "thumb",
)  # fmt: skip
"""The lengths of a person: left and right share one."""

GROUP_COUNT: Final = len(GROUPS)

MEN_STATURE: Final = (1.756, 0.0686)
WOMEN_STATURE: Final = (1.629, 0.0642)
"""Mean and standard deviation of standing height in ANSUR II [m]."""

ANKLE_HEIGHT: Final = 0.039
CROWN: Final = 0.045
"""Sole to ankle, and end of the head's bone to the crown, as shares of stature."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A length of the table.

    Attributes:
        ratio: mean share of stature.
        parts: bones that share the segment, each with its share of it.
        spread: standard deviation of the logarithm at a given stature; it covers both
            people's proportions and what tables and fits mean by a joint.
        split_spread: the same for each part's share.
    """

    ratio: float
    parts: dict[str, float]
    spread: float
    split_spread: float = 0.015


# A hip or shoulder joint lies about a tenth inside the width that is measured over the
# bones (0.191 / 2 and 0.259 / 2). The trunk from trochanter to acromion (0.818 - 0.530) less
# the drop of the hips and the rise of the shoulders is the back; the rest up to the crown is
# neck and head. The hand's bone reaches a quarter of the hand (0.108), the foot's less than
# half of the foot (0.152).
SEGMENTS: Final[tuple[Segment, ...]] = (
    Segment(0.0860, {"hipjoint": 1.0}, 0.06),
    Segment(0.2450, {"femur": 1.0}, 0.05),
    Segment(0.2460, {"tibia": 1.0}, 0.05),
    Segment(0.0680, {"foot": 1.0, "toes": 0.5}, 0.10),
    Segment(0.1930, {"lowerback": 1 / 3, "upperback": 1 / 3, "thorax": 1 / 3}, 0.07),
    Segment(0.1767, {"lowerneck": 1 / 3, "upperneck": 1 / 3, "head": 1 / 3}, 0.06),
    Segment(0.1160, {"clavicle": 1.0}, 0.06),
    Segment(0.1860, {"humerus": 1.0}, 0.08),
    Segment(0.1460, {"radius": 2 / 3, "wrist": 1 / 3}, 0.08),
    Segment(0.0270, {"hand": 1.0, "fingers": 0.8, "thumb": 1.15}, 0.15),
)

NINE_BONES: Final[dict[str, tuple[str, ...]]] = {
    "femur": ("femur",), "tibia": ("tibia",), "back": ("lowerback", "upperback", "thorax"),
    "neck": ("lowerneck", "upperneck"), "head": ("head",), "clavicle": ("clavicle",),
    "humerus": ("humerus",), "radius": ("radius",), "wrist": ("wrist",),
}  # fmt: skip
"""The nine lengths that calibrations are compared by, and the groups that make each."""


def rows_of(parts: Iterable[str]) -> list[int]:
    """Where groups are in `GROUPS`."""
    return [GROUPS.index(part) for part in parts]


def length_of(parts: Iterable[str], groups: Float[ndarray, "18"]) -> float:
    """A length that several groups make together [m]."""
    return float(groups[rows_of(parts)].sum())


def group_of_bone() -> Int[ndarray, "30"]:
    """For every bone the index of its length in `GROUPS`."""
    return np.array([GROUPS.index(_group(name)) for name in BONE_NAMES])


def _group(name: str) -> str:
    return name[1:] if mirror_name(name) != name else name


def stature_statistics() -> tuple[float, float]:
    """Mean and standard deviation of stature over men and women alike [m]."""
    means = np.array([MEN_STATURE[0], WOMEN_STATURE[0]])
    deviations = np.array([MEN_STATURE[1], WOMEN_STATURE[1]])
    mean = float(means.mean())
    return mean, float(np.sqrt(np.mean(deviations**2 + (means - mean) ** 2)))


def published_statistics() -> tuple[Float[ndarray, "18"], Float[ndarray, "18 18"]]:
    """Mean and covariance of the logarithms of the lengths [log m] by the table."""
    stature, deviation = stature_statistics()
    mean = np.zeros(GROUP_COUNT)
    covariance = np.full((GROUP_COUNT, GROUP_COUNT), (deviation / stature) ** 2)
    for segment in SEGMENTS:
        rows = rows_of(segment.parts)
        mean[rows] = np.log(stature * segment.ratio * np.array(list(segment.parts.values())))
        covariance[np.ix_(rows, rows)] += segment.spread**2
        if len(rows) > 1:
            covariance[rows, rows] += segment.split_spread**2
    return mean, covariance
