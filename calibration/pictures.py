"""Pictures of the poses: one PNG each, and a sheet of all."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Sheet
from numpy import ndarray

from calibration.eigen_skeleton import average_subject, published_prior
from calibration.poses import TargetPose
from localreg.body.subject import Subject
from localreg.drawing import Camera, Figure, build_scene, open_canvas
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints

SHEET: Final = "poses.png"
"""File name of the sheet of all poses."""

_WIDTH, _HEIGHT = 420, 620
_SOLE: Final = 0.035
_INK, _SOFT = "#2b2d31", "#6d7077"


def draw_poses(
    poses: Sequence[TargetPose], folder: Path, subject: Subject | None = None
) -> tuple[list[Path], str]:
    """Write a PNG of every pose, and one of all with their words.

    Args:
        poses: to be drawn, seen from the front and a little from the left.
        folder: where to; made if need be.
        subject: whose body; the average person by default.

    Returns:
        The files written, the sheet last, and advice if better graphics could be had.

    Raises:
        LocalregError: a file cannot be written.
    """
    body = subject or average_subject(published_prior())
    pictures, note = _pictures(poses, body)
    files = [folder / f"{n}-{pose.name.replace(' ', '-')}.png" for n, pose in enumerate(poses, 1)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for file, picture in zip(files, pictures, strict=True):
            _sheet([picture], None).savefig(file, dpi=100)
        _sheet(pictures, poses).savefig(folder / SHEET, dpi=100)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write pictures to {folder}: {reason}") from error
    return [*files, folder / SHEET], note


def grounded(
    pose: TargetPose, subject: Subject, points: BodyPoints | None = None
) -> Float[ndarray, "63"]:
    """The pose facing world -y, its lowest bone end just above the floor z = 0."""
    qpos = pose.qpos()
    ends = (points or BodyPoints(subject)).bone_ends(qpos[None])[0]
    qpos[2] += _SOLE - ends[:, 2].min()
    return qpos


def _pictures(
    poses: Sequence[TargetPose], subject: Subject
) -> tuple[list[UInt8[ndarray, "height width 3"]], str]:
    scene = build_scene([Figure(subject, axes=True)])
    points = BodyPoints(subject)
    # From the front, three quarters: arms that point forward must not hide the body.
    camera = Camera((0.0, 0.0, 0.98), np.radians(90.0 + 28.0), -0.12, 3.1)
    with open_canvas(scene, 2 * _WIDTH, 2 * _HEIGHT) as canvas:
        drawn = [canvas.draw([grounded(pose, subject, points)], camera) for pose in poses]
        return [_halved(picture) for picture in drawn], canvas.drawing.note


def _halved(picture: UInt8[ndarray, "h w 3"]) -> UInt8[ndarray, "h2 w2 3"]:
    height, width = picture.shape[:2]
    blocks = picture.reshape(height // 2, 2, width // 2, 2, 3)
    return blocks.mean(axis=(1, 3)).round().astype(np.uint8)


def _sheet(pictures: list[UInt8[ndarray, "h w 3"]], poses: Sequence[TargetPose] | None) -> Sheet:
    columns = min(4, len(pictures))
    rows = -(-len(pictures) // columns)
    caption = 0 if poses is None else 44
    width, height = columns * _WIDTH, rows * (_HEIGHT + caption)
    sheet = Sheet(figsize=(width / 100, height / 100), dpi=100, facecolor="white")
    FigureCanvasAgg(sheet)
    for index, picture in enumerate(pictures):
        row, column = divmod(index, columns)
        bottom = height - (row + 1) * (_HEIGHT + caption)
        place = (column * _WIDTH / width, bottom / height, _WIDTH / width, _HEIGHT / height)
        axes: Any = sheet.add_axes(place)
        axes.imshow(picture, interpolation="none", aspect="auto")
        axes.set_axis_off()
        if poses is not None:
            x, y = (column + 0.5) * _WIDTH / width, (bottom + _HEIGHT + 0.5 * caption) / height
            sheet.text(x, y, f"{index + 1}  {poses[index].name}", fontsize=17, color=_INK,
                       weight="bold", ha="center", va="center")  # fmt: skip
    return sheet
