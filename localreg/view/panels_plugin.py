"""The plugin of `mujoco.studio` that makes its viewers show a body.

Nothing in it knows of browsers. But the studio's own window needs Python 3.12, and with a stand-in
for what 3.11 lacks it drew, in mujoco 4.0.0, a part of the body and no panels; so windows are
MuJoCo's classic ones (`native`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui

from localreg.view.controls import Controls, played, pressed
from localreg.view.panels import Desk, Panel, panels_for
from localreg.view.panels_camera import CameraMan
from localreg.view.panels_keys import pressed_keys
from localreg.view.scene import Stage, geoms, marks, show_look

WIDTH: Final = 360.0
"""Of the side window [pixels]."""

_MARGIN: Final = 10.0
_NOTICE: Final = imgui.Vec4(1.0, 0.85, 0.45, 1.0)
_BARE: Final = (
    int(imgui.WindowFlags.NoDecoration)
    | int(imgui.WindowFlags.AlwaysAutoResize)
    | int(imgui.WindowFlags.NoInputs)
    | int(imgui.WindowFlags.NoSavedSettings)
)


class BodyPlugin(plugin.ViewerPlugin):
    """Poses the viewer's own copy of the stage and draws the panels.

    Args:
        stage: the model that the viewer was made with.
        desk: what is shown.
        panels: the sections of the side window; by default all that have something to show.
    """

    def __init__(self, stage: Stage, desk: Desk, panels: Sequence[Panel] | None = None) -> None:
        self._stage = stage
        self._desk = desk
        self._panels = panels_for(desk) if panels is None else list(panels)
        self._size = (0.0, 0.0)

    @messages.handler
    def _on_viewer_init(self, _: plugin.ViewerInitEvent) -> None:
        self._camera_man = CameraMan(self.viewer)

    @messages.handler
    def _on_update(self, _: messages.UpdateEvent) -> None:
        desk, viewer = self._desk, self.viewer
        moment = desk.look()
        for panel in self._panels:
            panel.watch(desk)
        self._obey_keys()
        show_look(viewer.vis_options, desk.style.look)
        if moment is None:
            return
        if desk.target is not None:
            moment = replace(moment, ghost=desk.target, ghost_name="target")
        if desk.camera is not None:
            self._camera_man.place(desk.camera, moment)
            desk.camera = None
        if desk.is_new:
            self._camera_man.mind(moment)
        self._stage.place(viewer.data, moment, desk.style)
        self._stage.scene.turn_sun(viewer.data, math.radians(viewer.camera.azimuth))
        viewer.extra_geoms[:] = geoms(marks(moment, desk.style))

    def _obey_keys(self) -> None:
        desk = self._desk
        for key in pressed_keys():
            after = pressed(Controls(preset=None, style=desk.style), key)
            desk.style, desk.camera = after.style, after.preset or desk.camera
            deck = desk.source.transport
            if deck is not None:
                deck.playhead = played(deck.playhead, key)

    @messages.handler
    def _on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        size = imgui.GetIO().DisplaySize
        # Somebody may move the panel; it is put back when the window changes its size.
        when = imgui.Cond.Once if (size.x, size.y) == self._size else imgui.Cond.Always
        self._size = (size.x, size.y)
        imgui.SetNextWindowPos(imgui.Vec2(_MARGIN, _MARGIN), when)
        height = max(200.0, size.y - 2.0 * _MARGIN)
        imgui.SetNextWindowSize(imgui.Vec2(WIDTH, height), when)
        imgui.SetNextWindowBgAlpha(0.85)
        is_open, _ = imgui.Begin("localreg")
        if is_open:
            if self._desk.moment is None:
                imgui.TextDisabled("waiting for the first pose")
            for panel in self._panels:
                opened = imgui.TreeNodeFlags.DefaultOpen if panel.is_open else 0
                if imgui.CollapsingHeader(panel.title, opened):
                    imgui.PushID(panel.title)
                    panel.draw(self._desk)
                    imgui.PopID()
        imgui.End()
        if self._desk.source.notice:
            _show_notice(self._desk.source.notice, size.x)


def _show_notice(words: str, width: float) -> None:
    """A line above the body, in the middle of what the side window leaves."""
    middle = imgui.Vec2(0.5 * (width + WIDTH + _MARGIN), 2.0 * _MARGIN)
    imgui.SetNextWindowPos(middle, imgui.Cond.Always, imgui.Vec2(0.5, 0.0))
    imgui.SetNextWindowBgAlpha(0.85)
    imgui.Begin("notice", flags=_BARE)
    imgui.TextColored(_NOTICE, words)
    imgui.End()
