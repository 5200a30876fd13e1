"""Pictures of a scene without a display, by whatever graphics this machine has.

MuJoCo draws through EGL or, failing that, OSMesa; where neither works Matplotlib draws
the bones as sticks. The choice is made by trying, in a process of its own, since a
failed attempt would spoil the next one.
"""

import functools
import os
import subprocess
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Final, Self

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from localreg.drawing.looks import show_look
from localreg.drawing.scene import Scene

# PyOpenGL's EGL needs libOpenGL or libGL beside libEGL, and Mesa's driver to draw with.
ADVICE: Final = (
    "no off-screen graphics here, so bodies are drawn as plain sticks; for solid bodies install "
    "EGL (Debian: apt-get install libegl1 libopengl0 libgl1-mesa-dri) or OSMesa (apt-get "
    "install libosmesa6)"
)
"""One line for who sees a stick figure."""

_FIELD_OF_VIEW: Final = np.radians(45.0)  # vertical, of MuJoCo's free camera
_BACKENDS: Final = ("egl", "osmesa")
_OFF: Final = ("disable", "disabled", "off", "false", "0")
_PROBE: Final = """
import sys
from importlib import import_module
import mujoco
context = import_module("mujoco." + sys.argv[1]).GLContext(64, 64)
context.make_current()
drawing = mujoco.MjrContext(mujoco.MjSpec().compile(), mujoco.mjtFontScale.mjFONTSCALE_100.value)
assert drawing.offWidth
drawing.free()
context.free()
"""

Add = Callable[[mujoco.MjvScene], None]
"""Adds geoms to a scene that is about to be drawn."""

TrackerPoses = Mapping[str, tuple[Float[ndarray, " 3"], Float[ndarray, " 4"]]]


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from.

    Attributes:
        target: point in the middle of the picture [m].
        azimuth: direction of view about the vertical, 0 along world x [rad].
        elevation: direction of view above the horizontal; negative looks down [rad].
        distance: from the target [m].
    """

    target: tuple[float, float, float]
    azimuth: float = np.pi / 2
    elevation: float = -0.2
    distance: float = 3.5

    def project(
        self, points: Float[ndarray, "n 3"], width: float, height: float
    ) -> tuple[Float[ndarray, "n 2"], Float[ndarray, " n"]]:
        """Where points of the world are in a picture.

        Args:
            points: in the world [m].
            width: of the picture [pixels].
            height: of the picture [pixels].

        Returns:
            Pixels from the upper left corner, and the depth along the view [m]; points of
            no positive depth are behind the camera.
        """
        ahead = np.array(
            [
                np.cos(self.elevation) * np.cos(self.azimuth),
                np.cos(self.elevation) * np.sin(self.azimuth),
                np.sin(self.elevation),
            ]
        )
        right = np.array([np.sin(self.azimuth), -np.cos(self.azimuth), 0.0])
        above = np.cross(right, ahead)
        relative = points - (np.array(self.target) - self.distance * ahead)
        depth = relative @ ahead
        scale = focal_length(height) / np.maximum(depth, 1e-3)
        x = 0.5 * width + scale * (relative @ right)
        y = 0.5 * height - scale * (relative @ above)
        return np.stack([x, y], axis=1), depth

    def to_mujoco(self) -> mujoco.MjvCamera:
        """The same as MuJoCo's free camera."""
        camera = mujoco.MjvCamera()
        camera.lookat[:] = self.target
        camera.distance = self.distance
        camera.azimuth = np.degrees(self.azimuth)
        camera.elevation = np.degrees(self.elevation)
        return camera


def focal_length(height: float) -> float:
    """Of MuJoCo's free camera in a picture so high [pixels]."""
    return 0.5 * height / np.tan(0.5 * _FIELD_OF_VIEW)


@dataclass(frozen=True)
class Drawing:
    """What happened: which backend drew, and what to do for a better picture.

    Attributes:
        backend: `"egl"`, `"osmesa"` or `"matplotlib"`.
        note: one line of advice, empty if there is none.
    """

    backend: str
    note: str = ""


class Canvas(ABC):
    """Draws one scene again and again at one size. Close it, or use it in a `with`.

    Attributes:
        drawing: which graphics draw.
        data: where everything is; `Scene.place` puts it there.
        option: which of the scene's geom groups are seen, such as the looks of bodies.
    """

    drawing: Drawing

    def __init__(self, scene: Scene, width: int, height: int) -> None:
        self.scene = scene
        self.width, self.height = width, height
        self.data = mujoco.MjData(scene.model)
        self.option = mujoco.MjvOption()
        show_look(self.option, "capsules")

    @abstractmethod
    def picture(self, camera: Camera, add: Add | None = None) -> UInt8[ndarray, "height width 3"]:
        """The scene as it was placed last.

        Args:
            camera: from where.
            add: called with the scene to be drawn, to add to it what is no body.
        """

    def draw(
        self,
        poses: Sequence[Float[ndarray, " 63"]],
        camera: Camera,
        trackers: TrackerPoses | None = None,
    ) -> UInt8[ndarray, "height width 3"]:
        """Place bodies and trackers (see `Scene.place`) and take a picture."""
        self.scene.place(self.data, poses, trackers)
        return self.picture(camera)

    @abstractmethod
    def close(self) -> None:
        """Give the graphics back; the canvas cannot draw any more."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class SolidCanvas(Canvas):
    """MuJoCo's renderer on an off-screen context of its own.

    `mujoco.Renderer` takes the backend that the environment named when MuJoCo was first
    imported, which is too early to choose one by trying.
    """

    def __init__(self, scene: Scene, width: int, height: int, backend: str) -> None:
        super().__init__(scene, width, height)
        self.drawing = Drawing(backend)
        # The model's buffer is what the scene allows at most; take only what is needed.
        scene.model.vis.global_.offwidth = width
        scene.model.vis.global_.offheight = height
        scene.model.vis.quality.shadowsize = _shadow_size(height)
        self._context = import_module(f"mujoco.{backend}").GLContext(width, height)
        self._context.make_current()
        self._render = mujoco.MjrContext(scene.model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._render)
        self._geoms = mujoco.MjvScene(scene.model, maxgeom=2000)

    def picture(self, camera: Camera, add: Add | None = None) -> UInt8[ndarray, "height width 3"]:
        """The scene as it was placed last, with light and shadow."""
        if self._context is None:
            raise RuntimeError("this canvas was closed")
        self._context.make_current()
        self.scene.turn_sun(self.data, camera.azimuth)
        mujoco.mjv_updateScene(
            self.scene.model,
            self.data,
            self.option,
            None,
            camera.to_mujoco(),
            mujoco.mjtCatBit.mjCAT_ALL.value,
            self._geoms,
        )
        self._geoms.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        if add is not None:
            add(self._geoms)
        area = mujoco.MjrRect(0, 0, self.width, self.height)
        pixels = np.empty((self.height, self.width, 3), dtype=np.uint8)
        mujoco.mjr_render(area, self._geoms, self._render)
        mujoco.mjr_readPixels(pixels, None, area, self._render)
        return pixels[::-1].copy()

    def close(self) -> None:
        """Free the context; the canvas cannot draw any more."""
        if self._context is not None:
            self._context.make_current()
            self._render.free()
            self._context.free()
            self._context = None


def open_canvas(scene: Scene, width: int, height: int) -> Canvas:
    """A canvas by the best backend that works here.

    `MUJOCO_GL` set to `egl` or `osmesa` allows only that one, `disabled` allows none.

    Args:
        scene: what is drawn.
        width: of the pictures [pixels].
        height: of the pictures [pixels].
    """
    backend = working_backend(os.environ.get("MUJOCO_GL", ""))
    if backend:
        return SolidCanvas(scene, width, height, backend)
    from localreg.drawing.sticks import StickCanvas

    return StickCanvas(scene, width, height, Drawing("matplotlib", ADVICE))


@functools.cache
def working_backend(wanted: str = "") -> str:
    """The first off-screen backend of MuJoCo's that works here, empty if none does.

    Args:
        wanted: what `MUJOCO_GL` says.
    """
    wanted = wanted.lower().strip()
    if wanted in _OFF:
        return ""
    # A platform that this process has already loaded cannot be exchanged for another.
    loaded = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    for backend in (wanted,) if wanted in _BACKENDS else _BACKENDS:
        if loaded in ("", backend) and _works(backend):
            return backend
    return ""


def _shadow_size(height: int) -> int:
    """Of the shadow map: no finer than is seen, for without graphics hardware it is costly."""
    return int(np.clip(2 ** np.ceil(np.log2(2 * height)), 256, 4096))


def _works(backend: str) -> bool:
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE, backend],
            env=environment,
            capture_output=True,
            timeout=60,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return probe.returncode == 0
