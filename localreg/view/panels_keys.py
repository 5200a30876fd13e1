"""Keys pressed in the viewers of `mujoco.studio`, by the codes that `controls` knows."""

from typing import Final

from mujoco.studio.dear_imgui import dear_imgui as imgui

from localreg.view import controls

CODES: Final = {
    **{f"N{digit}": ord(str(digit)) for digit in range(1, 10)},
    "Space": controls.SPACE,
    "LeftArrow": controls.LEFT,
    "RightArrow": controls.RIGHT,
    "UpArrow": controls.UP,
    "DownArrow": controls.DOWN,
    "PageUp": controls.PAGE_UP,
    "PageDown": controls.PAGE_DOWN,
    "Home": controls.HOME,
    "End": controls.END,
    "Enter": controls.ENTER,
}
"""Code of each key by its name in Dear ImGui."""

_REPEATED: Final = ("LeftArrow", "RightArrow", "PageUp", "PageDown")


def pressed_keys() -> list[int]:
    """The codes of the keys that were just pressed, unless somebody is typing."""
    if imgui.IsAnyItemActive():
        return []
    return [
        code
        for name, code in CODES.items()
        if imgui.IsKeyPressed(getattr(imgui.Key, name), name in _REPEATED)
    ]
