"""Play, pause, scrub, speed, loop and single steps for files."""

from mujoco.studio.dear_imgui import dear_imgui as imgui

from localreg.view.panels import Desk, Panel
from localreg.view.transport import SPEEDS


class TransportPanel(Panel):
    """The controls of a file."""

    title = "Playing"
    is_open = True

    def is_wanted(self, desk: Desk) -> bool:
        """Whether there is a file to play."""
        return desk.source.transport is not None

    def draw(self, desk: Desk) -> None:
        """Buttons, the bar to scrub on, speed and loop."""
        transport = desk.source.transport
        if transport is None:
            return
        if desk.moment is not None and desk.moment.title:
            imgui.TextUnformatted(desk.moment.title)
        if imgui.Button("pause" if transport.is_playing else "play"):
            transport.is_playing = not transport.is_playing
        imgui.SameLine()
        for words, frames in (("< frame", -1), ("frame >", 1)):
            if imgui.Button(words):
                transport.is_playing = False
                transport.time = transport.time + frames * transport.period
            imgui.SameLine()
        changed, is_looping = imgui.Checkbox("loop", transport.is_looping)
        if changed:
            transport.is_looping = is_looping
        imgui.SetNextItemWidth(-1.0)
        moved, time = imgui.SliderFloat(
            "##time", transport.time, 0.0, max(transport.seconds, 1e-3), "%.2f s"
        )
        if moved:
            transport.is_playing = False
            transport.time = time
        names = [f"{speed:g} x" for speed in SPEEDS]
        current = min(range(len(SPEEDS)), key=lambda i: abs(SPEEDS[i] - transport.speed))
        chosen, index = imgui.Combo("speed", current, names)
        if chosen:
            transport.speed = SPEEDS[index]
