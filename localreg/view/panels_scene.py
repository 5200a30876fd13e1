"""What of a moment is drawn, and from where it is looked at."""

from dataclasses import replace

from mujoco.studio.dear_imgui import dear_imgui as imgui

from localreg.view.cameras import PRESETS
from localreg.view.panels import Desk, Panel
from localreg.view.scene import LOOKS

_PARTS = {
    "measured": "measured trackers",
    "predicted": "trackers on the body",
    "errors": "errors between them",
    "ghost": "ghost",
    "trails": "trails",
    "labels": "names",
}


class ScenePanel(Panel):
    """Looks of the body, what is drawn beside it, and camera presets."""

    title = "Scene"
    is_open = True

    def draw(self, desk: Desk) -> None:
        """Buttons for looks and cameras, boxes for the rest."""
        imgui.TextUnformatted("look")
        for look in LOOKS:
            imgui.SameLine()
            if imgui.RadioButton(look, desk.style.look == look):
                desk.style = replace(desk.style, look=look)
        for number, name in enumerate(PRESETS):
            if number:
                imgui.SameLine()
            if imgui.SmallButton(name):
                desk.camera = name
        for number, (part, words) in enumerate(_PARTS.items()):
            if number % 2:
                imgui.SameLine(150.0)
            changed, on = imgui.Checkbox(words, getattr(desk.style, part))
            if changed:
                desk.style = replace(desk.style, **{part: on})
