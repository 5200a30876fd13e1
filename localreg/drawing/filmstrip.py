"""One picture of a whole motion: truth above, synthesis below, the error over time."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure as Sheet
from numpy import ndarray

from localreg.drawing.ground import SOLE, end_heights, floor_under
from localreg.drawing.offscreen import Camera, Drawing, open_canvas
from localreg.drawing.scene import BLUE, GREEN, Color, Figure, build_scene
from localreg.errors import LocalregError
from localreg.motion.motion import Motion

_DPI: Final = 100
_INK, _SOFT, _GRID = "#2b2d31", "#6d7077", "#e4e2de"
_ANGLE_COLOR: Final = "#d1843c"
_FONTS: Final = {"family": "DejaVu Sans"}


def filmstrip(
    truth: Motion,
    synthesis: Motion,
    path: Path,
    *,
    mpjpe: Float[ndarray, " frames"],
    angle_error: Float[ndarray, " frames"] | None = None,
    instants: int = 8,
    width: int = 1800,
    title: str | None = None,
) -> Drawing:
    """Write a PNG of a motion and its synthesis.

    A row of instants of the truth with its trackers, below each the synthesized body,
    under both the errors over time with the instants marked.

    Args:
        truth: the real motion.
        synthesis: the same frames as synthesized.
        path: the PNG to be written.
        mpjpe: mean distance of the bone ends, frame by frame; NaN where not counted [m].
        angle_error: mean error of the joint angles, frame by frame, or nothing [rad].
        instants: how many instants are shown, evenly spread.
        width: of the picture [pixels].
        title: first line of the picture; by default the motion's name.

    Returns:
        Which graphics drew it, and advice if better ones could be had.

    Raises:
        LocalregError: the motions do not fit each other or the errors, or the picture
            cannot be written.
    """
    frames = len(truth)
    if frames == 0 or instants < 1:
        raise LocalregError("a filmstrip needs at least one frame and one instant")
    if len(synthesis) != frames or abs(synthesis.rate - truth.rate) > 1e-6 * truth.rate:
        raise LocalregError(
            f"the synthesis has {len(synthesis)} frames at {synthesis.rate:g} Hz, the truth "
            f"{frames} at {truth.rate:g} Hz; a filmstrip compares frame by frame"
        )
    if len(mpjpe) != frames or (angle_error is not None and len(angle_error) != frames):
        raise LocalregError(f"a filmstrip of {frames} frames needs an error for each of them")
    shown = _spread(frames, instants)
    tile_width = (width - 2 * _margin(width)) // len(shown)
    tile_height = round(min(1.55 * tile_width, 0.3 * width))
    rows, drawing = _tiles(truth, synthesis, shown, tile_width, tile_height)
    sheet = _compose(truth, rows, shown, mpjpe, angle_error, width, title)
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        sheet.savefig(path, dpi=_DPI, format="png")
    except OSError as error:
        raise LocalregError(f"cannot write the picture {path}: {error.strerror}") from error
    return drawing


def _spread(frames: int, instants: int) -> Int[ndarray, " instants"]:
    """Frames in the middles of equal spans, so that neither end is favored."""
    middles = (np.arange(instants) + 0.5) * frames / instants
    return np.unique(np.minimum(middles.astype(int), frames - 1))


def _margin(width: int) -> int:
    return round(0.042 * width)


def _tiles(
    truth: Motion, synthesis: Motion, shown: Int[ndarray, " instants"], width: int, height: int
) -> tuple[list[list[UInt8[ndarray, "height width 3"]]], Drawing]:
    """Pictures of the truth with its trackers, and of the synthesis with the same trackers."""
    framing = _framing(truth)
    rows, drawing = [], Drawing("")
    for motion, color in ((truth, GREEN), (synthesis, BLUE)):
        # The true body is there to ask it for its trackers; it is seen in its own row only.
        figures = [_worn(motion, color), _worn(truth, color, opacity=0.0)]
        scene = build_scene(figures, trackers=truth.subject.trackers, floor=framing.floor)
        # Drawn at twice the size and reduced: smoother than the context's own sampling.
        with open_canvas(scene, 2 * width, 2 * height) as canvas:
            drawing = canvas.drawing
            row = []
            for frame in shown:
                poses = [motion.qpos[frame], truth.qpos[frame]]
                scene.place(canvas.data, poses)
                trackers = scene.tracker_poses(canvas.data, 1)
                camera = framing.camera(truth, int(frame), width / height)
                picture = canvas.draw(poses, camera, trackers)
                row.append(_halved(picture))
            rows.append(row)
    return rows, drawing


def _worn(motion: Motion, color: Color, opacity: float = 1.0) -> Figure:
    return Figure(motion.subject, color, opacity)


def _halved(picture: UInt8[ndarray, "h w 3"]) -> UInt8[ndarray, "h2 w2 3"]:
    height, width = picture.shape[:2]
    blocks = picture.reshape(height // 2, 2, width // 2, 2, 3)
    return blocks.mean(axis=(1, 3)).round().astype(np.uint8)


@dataclass(frozen=True)
class _Framing:
    """How the camera sees a motion: the same size and direction throughout.

    Attributes:
        floor: where the ground is: under the feet when they are lowest [m].
        height: from the ground to the top of the head when it is highest, leaps aside [m].
        lowest: height of the lowest bone end, frame by frame [m].
        azimuth: direction of view [rad].
    """

    floor: float
    height: float
    lowest: Float[ndarray, " frames"]
    azimuth: float

    def camera(self, motion: Motion, frame: int, aspect: float) -> Camera:
        """Follows the root over the ground, and upwards only when the body leaves it."""
        lift = max(0.0, self.lowest[frame] - self.floor - 0.15)
        x, y = motion.qpos[frame, :2]
        middle = self.floor + 0.52 * self.height + lift
        # The body and some air; a lying one or spread arms need the width.
        tall = max(1.22 * self.height, 1.25 / aspect)
        distance = 0.5 * tall / np.tan(np.radians(22.5))
        return Camera((float(x), float(y), float(middle)), self.azimuth, -0.14, distance)


def _framing(motion: Motion) -> _Framing:
    heights = end_heights(motion)
    floor = floor_under(heights)
    top = float(np.percentile(heights[:, 1] - heights[:, 0], 95)) + 2 * SOLE
    return _Framing(floor, max(top, 1.2), heights[:, 0], _azimuth(motion))


def _azimuth(motion: Motion) -> float:
    """Three quarters from the front: of the way walked or, standing, of the way faced [rad]."""
    way = motion.qpos[-1, :2] - motion.qpos[0, :2]
    if np.linalg.norm(way) < 0.5:
        w, x, y, z = motion.qpos[len(motion) // 2, 3:7]
        way = np.array([2 * (x * z + w * y), 2 * (y * z - w * x)])  # the root's z axis
    return float(np.arctan2(way[1], way[0]) + np.radians(180 - 52))


def _compose(
    truth: Motion,
    rows: list[list[UInt8[ndarray, "height width 3"]]],
    shown: Int[ndarray, " instants"],
    mpjpe: Float[ndarray, " frames"],
    angle_error: Float[ndarray, " frames"] | None,
    width: int,
    title: str | None,
) -> Sheet:
    tile_height, tile_width = rows[0][0].shape[:2]
    unit = width / 1800  # everything below is in pixels of a sheet 1800 wide
    margin, head, caption, gap = _margin(width), round(84 * unit), round(52 * unit), round(4 * unit)
    plot_top, plot, foot = round(34 * unit), round(230 * unit), round(64 * unit)
    height = head + 2 * tile_height + gap + caption + plot_top + plot + foot
    sheet = Sheet(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(sheet)

    def area(
        left: float, top: float, wide: float, high: float
    ) -> tuple[float, float, float, float]:
        return left / width, 1 - (top + high) / height, wide / width, high / height

    def text(x: float, y: float, words: str, size: float, **style: Any) -> None:
        size *= unit
        sheet.text(x / width, 1 - y / height, words, fontsize=size, **{**_FONTS, **style})

    name = title or truth.provenance.name
    text(margin, 0.5 * head, name, 19, color=_INK, weight="bold", va="center")
    text(width - margin, 0.5 * head, _summary(truth, mpjpe, angle_error), 13.5, color=_SOFT,
         ha="right", va="center")  # fmt: skip
    for index, row in enumerate(rows):
        top = head + index * (tile_height + gap)
        strip = np.concatenate(row, axis=1)
        axes = sheet.add_axes(area(margin, top, strip.shape[1], tile_height))
        axes.imshow(strip, interpolation="none", aspect="auto")
        axes.set_axis_off()
        for edge in range(1, len(row)):
            axes.axvline(edge * tile_width - 0.5, color="white", linewidth=3 * unit)
        label, color = (("truth", GREEN), ("synthesis", BLUE))[index]
        text(0.68 * margin, top + 0.5 * tile_height, label, 14, color=_darker(color),
             weight="bold", rotation=90, ha="center", va="center")  # fmt: skip
    below = head + 2 * tile_height + gap
    for column, frame in enumerate(shown):
        middle = margin + (column + 0.5) * tile_width
        error = mpjpe[frame]
        figure = f"{100 * error:.1f} cm" if np.isfinite(error) else "not counted"
        text(middle, below + 0.32 * caption, f"{frame / truth.rate:.2f} s", 12.5, color=_SOFT,
             ha="center", va="center")  # fmt: skip
        text(middle, below + 0.76 * caption, figure, 14, color=_INK, ha="center", va="center",
             weight="bold")  # fmt: skip
    axes = sheet.add_axes(area(margin, below + caption + plot_top, len(shown) * tile_width, plot))
    _plot(axes, truth.rate, shown, mpjpe, angle_error, unit)
    return sheet


def _summary(
    truth: Motion,
    mpjpe: Float[ndarray, " frames"],
    angle_error: Float[ndarray, " frames"] | None,
) -> str:
    parts = [f"{len(truth) / truth.rate:.1f} s at {truth.rate:g} Hz"]
    if np.isfinite(mpjpe).any():
        parts.append(f"mean position error {100 * np.nanmean(mpjpe):.2f} cm")
    if angle_error is not None and np.isfinite(angle_error).any():
        parts.append(f"mean joint-angle error {np.degrees(np.nanmean(angle_error)):.2f}°")
    return "   ·   ".join(parts)


def _plot(
    axes: Any,
    rate: float,
    shown: Int[ndarray, " instants"],
    mpjpe: Float[ndarray, " frames"],
    angle_error: Float[ndarray, " frames"] | None,
    unit: float,
) -> None:
    """Position error on the left scale, joint-angle error on the right one."""
    seconds = np.arange(len(mpjpe)) / rate
    curves = [(axes, 100 * mpjpe, _hex(BLUE), "position error (MPJPE) [cm]")]
    if angle_error is not None:
        other = axes.twinx()
        curves.append((other, np.degrees(angle_error), _ANGLE_COLOR, "joint-angle error [deg]"))
    for side, values, color, label in curves:
        side.plot(seconds, values, color=color, linewidth=2.2 * unit, zorder=3)
        side.set_ylabel(label, color=color, fontsize=12.5 * unit, labelpad=8 * unit, **_FONTS)
        side.tick_params(axis="y", colors=color, labelsize=11.5 * unit, length=0)
        top = np.nanmax(values) if np.isfinite(values).any() else 1.0
        side.set_ylim(0.0, 1.25 * max(top, 1e-3))
        side.locator_params(axis="y", nbins=4)
        for spine in side.spines.values():
            spine.set_visible(False)
    axes.fill_between(seconds, 100 * mpjpe, color=_hex(BLUE), alpha=0.12, linewidth=0, zorder=2)
    axes.plot(
        seconds[shown], 100 * mpjpe[shown], "o", color=_hex(BLUE), markersize=8 * unit,
        markeredgecolor="white", markeredgewidth=1.6 * unit, zorder=5,
    )  # fmt: skip
    for instant in seconds[shown]:
        axes.axvline(instant, color=_GRID, linewidth=1.2 * unit, zorder=1)
    axes.grid(axis="y", color=_GRID, linewidth=1.0 * unit)
    axes.set_axisbelow(True)
    axes.set_xlim(0.0, max(seconds[-1], 1.0 / rate))
    axes.tick_params(axis="x", colors=_SOFT, labelsize=11.5 * unit, length=0, pad=6 * unit)
    axes.set_xlabel("time [s]", color=_SOFT, fontsize=12.5 * unit, **_FONTS)


def _hex(color: Color) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in color)


def _darker(color: Color) -> str:
    red, green, blue = (0.78 * part for part in color)
    return _hex((red, green, blue))
