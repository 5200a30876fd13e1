"""What keys do in a window, as a pure function of the key and of how things stand."""

from dataclasses import dataclass, field, replace
from typing import Final

from localreg.view.cameras import PRESETS, Preset
from localreg.view.scene import LOOKS, Style
from localreg.view.transport import Playhead

# Key codes as GLFW has them; printable keys are their characters.
SPACE: Final = 32
ENTER: Final = 257
RIGHT: Final = 262
LEFT: Final = 263
DOWN: Final = 264
UP: Final = 265
PAGE_UP: Final = 266
PAGE_DOWN: Final = 267
HOME: Final = 268
END: Final = 269

_FIRST: Final = ord("1")  # digits are the viewer's own for geom groups, which are ours to set
_LOOK, _GHOST, _TRAILS, _HELP = (ord(key) for key in "7890")
_LEAP: Final = 1.0  # of the page keys [s]

HELP: Final = (
    *((str(number), f"camera: {preset}") for number, preset in enumerate(PRESETS, start=1)),
    ("7", "next look"),
    ("8", "ghost"),
    ("9", "trails"),
    ("0", "this help"),
)
"""Keys and what they do, for every source."""

FILE_HELP: Final = (
    ("space", "play, pause"),
    ("left, right", "one frame"),
    ("page up, down", "one second"),
    ("home, end", "first, last frame"),
    ("up, down", "faster, slower"),
    ("enter", "loop"),
)
"""The same for files."""


@dataclass(frozen=True)
class Controls:
    """How a window shows things.

    Attributes:
        preset: the camera's; None once somebody has turned it by hand.
        style: what is seen.
        shows_help: whether keys are explained.
        aimed: how often a preset was chosen; tells a second choice of the same one.
    """

    preset: Preset | None = "follow"
    style: Style = field(default_factory=Style)
    shows_help: bool = True
    aimed: int = 0


def pressed(controls: Controls, key: int) -> Controls:
    """How a window shows things after a key; unknown keys change nothing."""
    style = controls.style
    if _FIRST <= key < _FIRST + len(PRESETS):
        return replace(controls, preset=PRESETS[key - _FIRST], aimed=controls.aimed + 1)
    if key == _LOOK:
        following = LOOKS[(LOOKS.index(style.look) + 1) % len(LOOKS)]
        return replace(controls, style=replace(style, look=following))
    if key == _GHOST:
        return replace(controls, style=replace(style, ghost=not style.ghost))
    if key == _TRAILS:
        return replace(controls, style=replace(style, trails=not style.trails))
    if key == _HELP:
        return replace(controls, shows_help=not controls.shows_help)
    return controls


def played(playhead: Playhead, key: int) -> Playhead:
    """Where playing stands after a key; unknown keys change nothing."""
    actions = {
        SPACE: lambda: playhead.toggled(),
        RIGHT: lambda: playhead.stepped(1),
        LEFT: lambda: playhead.stepped(-1),
        PAGE_UP: lambda: playhead.scrubbed(playhead.time - _LEAP),
        PAGE_DOWN: lambda: playhead.scrubbed(playhead.time + _LEAP),
        HOME: lambda: playhead.scrubbed(0.0),
        END: lambda: playhead.scrubbed(playhead.seconds),
        UP: lambda: playhead.faster(),
        DOWN: lambda: playhead.slower(),
        ENTER: lambda: playhead.looping(not playhead.is_looping),
    }
    action = actions.get(key)
    return playhead if action is None else action()
