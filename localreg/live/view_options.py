"""Where a run is to be seen; imports nothing heavy."""

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

Kind = Literal["none", "web", "native"]
"""No view, a page for browsers, or a window."""


@dataclass(frozen=True, slots=True)
class ViewOptions:
    """Where a run is to be seen.

    Attributes:
        kind: page, window or nothing.
        host: where a page is served.
        port: of the page; None for the first free one from 8080 on, 0 for any.
        takes: folder of what the buttons write.
        falls_back: whether a page will do where no window can be opened.
    """

    kind: Kind = "none"
    host: str = "127.0.0.1"
    port: int | None = None
    takes: Path = Path("takes")
    falls_back: bool = False


def usual_kind() -> Kind:
    """A window where there is a display, else a page."""
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return "native" if has_display and sys.platform.startswith("linux") else "web"
