"""Stick figures in characters: each holds 2 x 4 dots of a Braille pattern."""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from calibration.eigen_skeleton import average_subject, published_prior
from calibration.poses import TargetPose
from localreg.body.skeleton import BODY_NAMES, BONES
from localreg.evaluation.body_points import BodyPoints

_COLUMNS: Final = 28
_ROWS: Final = 17
_METRES_PER_DOT: Final = 2.3 / (4 * _ROWS)
_BRAILLE: Final = 0x2800
_BITS: Final = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_TURN: Final = np.radians(28.0)


class Sticks:
    """Draws poses of the average person, seen from the front and a little from the left."""

    def __init__(self) -> None:
        self.subject = average_subject(published_prior())
        self._points = BodyPoints(self.subject)
        self._drawn: dict[str, str] = {}

    def draw(self, pose: TargetPose) -> str:
        """The figure, in lines of characters."""
        if pose.name not in self._drawn:
            ends = self._points.bone_ends(pose.qpos()[None])[0]
            self._drawn[pose.name] = _characters(_dots(ends))
        return self._drawn[pose.name]


def _dots(ends: Float[ndarray, "31 3"]) -> Bool[ndarray, "height width"]:
    """Lines from bone end to bone end, and a head."""
    # The person faces world -y: their left is the picture's right.
    right = np.array([np.cos(_TURN), np.sin(_TURN), 0.0])
    flat = np.stack([ends @ right, ends[:, 2]], axis=1) / _METRES_PER_DOT
    height, width = 4 * _ROWS, 2 * _COLUMNS
    flat[:, 0] += 0.5 * width - flat[0, 0]
    flat[:, 1] -= flat[:, 1].min() - 1.0
    dots = np.zeros((height, width), dtype=bool)
    for index, bone in enumerate(BONES, start=1):
        a, b = flat[BODY_NAMES.index(bone.parent)], flat[index]
        steps = max(int(2 * np.abs(b - a).max()), 1)
        _mark(dots, a + np.linspace(0.0, 1.0, steps + 1)[:, None] * (b - a))
    neck, crown = flat[BODY_NAMES.index("upperneck")], flat[BODY_NAMES.index("head")]
    around = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = np.stack([np.cos(around), np.sin(around)], axis=1)
    _mark(dots, 0.5 * (neck + crown) + 3.6 * circle)
    return dots


def _mark(dots: Bool[ndarray, "height width"], points: Float[ndarray, "n 2"]) -> None:
    columns = np.round(points[:, 0]).astype(int)
    rows = len(dots) - 1 - np.round(points[:, 1]).astype(int)
    inside = (columns >= 0) & (columns < dots.shape[1]) & (rows >= 0) & (rows < len(dots))
    dots[rows[inside], columns[inside]] = True


def _characters(dots: Bool[ndarray, "height width"]) -> str:
    lines = []
    for row in range(_ROWS):
        line = ""
        for column in range(_COLUMNS):
            block = dots[4 * row : 4 * row + 4, 2 * column : 2 * column + 2]
            code = sum(_BITS[r][c] for r in range(4) for c in range(2) if block[r, c])
            line += chr(_BRAILLE + code) if code else " "
        lines.append(line.rstrip())
    while lines and not lines[0]:
        lines.pop(0)
    return "\n".join(lines)
