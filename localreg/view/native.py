"""The body in a window: MuJoCo's classic viewer, showing one source.

The classic viewer on every Python: the window of `mujoco.studio` needs 3.12 and draws none of
the panels in 4.0. So here keys do what buttons do on the page.
"""

import math
import queue
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np

from localreg.drawing.ground import standing_height
from localreg.drawing.offscreen import Camera
from localreg.errors import LocalregError
from localreg.view.cameras import followed, look_from
from localreg.view.controls import FILE_HELP, HELP, Controls, played, pressed
from localreg.view.moment import Moment
from localreg.view.scene import Stage, build_stage, draw, marks, show_look
from localreg.view.source import Source

MOST_FRAMES: Final = 60.0
"""Pictures a second at most [Hz]."""

NO_WINDOW: Final = (
    "no window can be opened here (no display, or one without OpenGL); look at it in a browser "
    "instead: --web, or --view web of a live run"
)
"""What to do without a display."""

_END: Final = 10.0  # how long a last picture may take without graphics hardware [s]
_BY_HAND: Final = 0.01  # a camera that stands otherwise than it was put was turned by hand [deg]


def check_window() -> None:
    """Try whether a window can be opened.

    Where it cannot, the viewer would wait for it forever.

    Raises:
        LocalregError: it cannot; says what else to do.
    """
    try:
        import glfw
    except ImportError as error:
        raise LocalregError(NO_WINDOW) from error
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # GLFW warns of what is told in one sentence below
        if not glfw.init():
            raise LocalregError(NO_WINDOW)
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(64, 64, "localreg", None, None)
        glfw.default_window_hints()
        if not window:
            raise LocalregError(NO_WINDOW)
        glfw.destroy_window(window)


def show_native(
    source: Source,
    ready: Callable[[], None] = lambda: None,
    is_over: Callable[[], bool] = lambda: False,
    *,
    controls: Controls | None = None,
) -> None:
    """Show a source in a window until it is closed, or until all is over.

    Args:
        source: what is shown; it is asked in this thread.
        ready: called once the window is there.
        is_over: asked before every picture.
        controls: how things are shown at first.

    Raises:
        LocalregError: no window can be opened.
    """
    check_window()
    from mujoco import viewer

    stage = build_stage(source.subject, source.ghost)
    window = _Window(stage, source, controls or Controls())
    before = set(threading.enumerate())
    try:
        with viewer.launch_passive(
            stage.model,
            window.data,
            key_callback=window.keys.put,
            show_left_ui=False,
            show_right_ui=False,
        ) as handle:
            ready()
            while handle.is_running() and not is_over():
                begun = time.monotonic()
                window.update(handle, begun)
                time.sleep(max(0.0, 1.0 / MOST_FRAMES - (time.monotonic() - begun)))
    finally:
        # The viewer draws in a thread of its own; were the program to end before it, the
        # display would be gone in the middle of a picture.
        for thread in set(threading.enumerate()) - before:
            thread.join(_END)


class _Window:
    """What changes from picture to picture."""

    def __init__(self, stage: Stage, source: Source, controls: Controls) -> None:
        self.keys: queue.SimpleQueue[int] = queue.SimpleQueue()
        self.data = mujoco.MjData(stage.model)
        self._stage, self._source, self._controls = stage, source, controls
        self._shown: tuple[Moment, Controls] | None = None
        self._camera: Camera | None = None
        self._aimed = controls.aimed
        self._then = 0.0
        self._height = standing_height(source.subject)
        moment = source.newest()
        if moment is not None:
            stage.place(self.data, moment, controls.style)

    def update(self, handle: Any, now: float) -> None:
        self._press_keys()
        moment = self._source.newest()
        if moment is None:
            handle.sync()
            return
        with handle.lock():
            self._aim(handle.cam, moment, now)
            show_look(handle.opt, self._controls.style.look)
            handle.opt.geomgroup[:2] = True
            self._stage.scene.turn_sun(self.data, math.radians(handle.cam.azimuth))
            seen = (moment, self._controls)
            if self._shown is None or self._shown[0] is not moment or self._shown[1] != seen[1]:
                self._stage.place(self.data, moment, self._controls.style)
                handle.user_scn.ngeom = 0
                draw(handle.user_scn, marks(moment, self._controls.style))
                self._shown = seen
        handle.set_texts(_texts(moment, self._controls, self._source))
        handle.sync()

    def _press_keys(self) -> None:
        while not self.keys.empty():
            key = self.keys.get()
            self._controls = pressed(self._controls, key)
            deck = self._source.transport
            if deck is not None:
                deck.playhead = played(deck.playhead, key)

    def _aim(self, view: mujoco.MjvCamera, moment: Moment, now: float) -> None:
        """Put the camera where the preset says, or let it go along as it was turned by hand."""
        elapsed, self._then = now - self._then, now
        chosen, self._aimed = self._controls.aimed != self._aimed, self._controls.aimed
        if self._camera is None or chosen or moment.is_start:
            self._camera = look_from(
                self._controls.preset or "follow", moment.qpos, height=self._height
            )
        else:
            by_hand = self._taken_over(self._camera, view)
            turning = self._controls.preset == "follow"
            self._camera = followed(
                by_hand, moment.qpos, elapsed, turning=turning, height=self._height
            )
        wanted = self._camera.to_mujoco()
        view.type = mujoco.mjtCamera.mjCAMERA_FREE
        view.lookat[:], view.distance = wanted.lookat, wanted.distance
        view.azimuth, view.elevation = wanted.azimuth, wanted.elevation

    def _taken_over(self, camera: Camera, view: mujoco.MjvCamera) -> Camera:
        """The camera as the mouse has left it; the preset holds no more if it was turned."""
        put = camera.to_mujoco()
        turned = abs(view.azimuth - put.azimuth) + abs(view.elevation - put.elevation)
        if turned < _BY_HAND and view.distance == put.distance:
            return camera
        if turned >= _BY_HAND:
            self._controls = replace(self._controls, preset=None)
        return replace(
            camera,
            azimuth=math.radians(view.azimuth),
            elevation=math.radians(view.elevation),
            distance=float(view.distance),
        )


def _texts(moment: Moment, controls: Controls, source: Source) -> list[Any]:
    """What is written into the window: title and time above, keys below."""
    grid, font = mujoco.mjtGridPos, mujoco.mjtFontScale.mjFONTSCALE_150
    words = [line for line in (source.notice, moment.title) if line]
    figures = []
    deck = source.transport
    if deck is not None:
        state = "playing" if deck.is_playing else "paused"
        looping = ", looping" if deck.is_looping else ""
        words.append(f"{state} at {deck.speed:g} x{looping}")
        figures.append(f"{moment.time:.2f} of {deck.seconds:.2f} s")
    if np.isfinite(moment.confidence):
        figures.append(f"confidence {100 * moment.confidence:.0f} %")
    texts = [(font, grid.mjGRID_TOPLEFT, "\n".join([*words, *figures]), "")]
    if controls.shows_help:
        rows = HELP if deck is None else (*HELP, *FILE_HELP)
        keys, meanings = ("\n".join(column) for column in zip(*rows, strict=True))
        texts.append((font, grid.mjGRID_BOTTOMLEFT, keys, meanings))
    return texts
