"""Bodies as sticks, drawn by Matplotlib where there are no graphics at all."""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure as Sheet
from numpy import ndarray

from localreg.drawing.looks import LOOK_GROUPS
from localreg.drawing.offscreen import Add, Camera, Canvas, Drawing, focal_length
from localreg.drawing.scene import Scene

_BACKGROUND: Final = "#f3f1ee"


class StickCanvas(Canvas):
    """The same bodies, camera and perspective as `SolidCanvas`, without surfaces.

    Positions are those of MuJoCo's kinematics; every capsule becomes a line as thick as
    the capsule, drawn from far to near.
    """

    def __init__(self, scene: Scene, width: int, height: int, drawing: Drawing) -> None:
        super().__init__(scene, width, height)
        self.drawing = drawing
        self._added = mujoco.MjvScene(scene.model, maxgeom=2000)

    def picture(self, camera: Camera, add: Add | None = None) -> UInt8[ndarray, "height width 3"]:
        """The scene as it was placed last, as lines on a grid."""
        self._added.ngeom = 0
        if add is not None:
            add(self._added)
        sheet = Sheet(figsize=(self.width / 100, self.height / 100), dpi=100)
        canvas = FigureCanvasAgg(sheet)
        sheet.set_facecolor(_BACKGROUND)
        axes = sheet.add_axes((0, 0, 1, 1))
        axes.set_xlim(0, self.width)
        axes.set_ylim(self.height, 0)
        axes.set_axis_off()
        self._draw_floor(axes, camera)
        self._draw_bodies(axes, camera)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()

    def close(self) -> None:
        """Nothing is held between pictures."""

    def _draw_floor(self, axes: Axes, camera: Camera) -> None:
        floor = self.scene.model.geom("floor").pos[2]
        x, y = np.round(camera.target[:2])
        steps = np.arange(-5, 6)
        lines = [((x + i, y - 5, floor), (x + i, y + 5, floor)) for i in steps]
        lines += [((x - 5, y + i, floor), (x + 5, y + i, floor)) for i in steps]
        fine = np.array([np.linspace(a, b, 40) for a, b in lines])
        pixels, depth = camera.project(fine.reshape(-1, 3), self.width, self.height)
        pixels = pixels.reshape(len(lines), -1, 2)
        visible = depth.reshape(len(lines), -1) > 0.1
        pieces = [p[v] for p, v in zip(pixels, visible, strict=True) if v.sum() > 1]
        axes.add_collection(LineCollection(pieces, colors="#dcd8d2", linewidths=1.0))

    def _draw_bodies(self, axes: Axes, camera: Camera) -> None:
        rods = _joined(self._bodies(), _rods(self._added))
        pixels, depth = camera.project(rods.ends.reshape(-1, 3), self.width, self.height)
        depth = depth.reshape(-1, 2).mean(axis=1)
        scale = focal_length(self.height) / np.maximum(depth, 0.1)
        widths = np.maximum(2.0 * rods.radii * scale * 0.72, 1.5)
        colors = rods.colors
        order = [i for i in np.argsort(-depth) if depth[i] > 0.1 and colors[i, 3] > 0]
        # A light rim sets limbs apart that cross each other.
        for i in order:
            for extra, color in ((3.0, _BACKGROUND), (0.0, colors[i])):
                axes.add_collection(
                    LineCollection(
                        [pixels.reshape(-1, 2, 2)[i]],
                        colors=[color],
                        linewidths=widths[i] + extra,
                        capstyle="round",
                    )
                )

    def _bodies(self) -> "_Rods":
        """The capsules of the model; bodies are drawn by theirs, whatever their look."""
        model, data = self.scene.model, self.data
        shown = (model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE) & (
            model.geom_group <= LOOK_GROUPS["capsules"]
        )
        capsules = np.flatnonzero(shown)
        return _rods_at(
            data.geom_xpos[capsules],
            data.geom_xmat[capsules].reshape(-1, 3, 3)[:, :, 2],
            model.geom_size[capsules, 1],
            model.geom_size[capsules, 0],
            np.array([self._color(int(geom)) for geom in capsules]).reshape(-1, 4),
        )

    def _color(self, geom: int) -> Float[ndarray, " 4"]:
        material = self.scene.model.geom_matid[geom]
        if material >= 0:
            return np.array(self.scene.model.mat_rgba[material], dtype=float)
        return np.array(self.scene.model.geom_rgba[geom], dtype=float)


@dataclass(frozen=True, eq=False)
class _Rods:
    ends: Float[ndarray, "n 2 3"]
    radii: Float[ndarray, " n"]
    colors: Float[ndarray, "n 4"]


def _rods_at(
    centers: Float[ndarray, "n 3"],
    directions: Float[ndarray, "n 3"],
    halves: Float[ndarray, " n"],
    radii: Float[ndarray, " n"],
    colors: Float[ndarray, "n 4"],
) -> _Rods:
    along = halves[:, None] * directions
    return _Rods(np.stack([centers - along, centers + along], axis=1), radii, colors)


def _rods(scene: mujoco.MjvScene) -> _Rods:
    """The capsules that somebody added to a scene."""
    added = [scene.geoms[i] for i in range(scene.ngeom)]
    added = [geom for geom in added if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE]
    return _rods_at(
        np.array([geom.pos for geom in added], dtype=float).reshape(-1, 3),
        np.array([geom.mat[:, 2] for geom in added], dtype=float).reshape(-1, 3),
        np.array([geom.size[2] for geom in added], dtype=float),
        np.array([geom.size[0] for geom in added], dtype=float),
        np.array([geom.rgba for geom in added], dtype=float).reshape(-1, 4),
    )


def _joined(first: _Rods, second: _Rods) -> _Rods:
    return _Rods(
        np.concatenate([first.ends, second.ends]),
        np.concatenate([first.radii, second.radii]),
        np.concatenate([first.colors, second.colors]),
    )
