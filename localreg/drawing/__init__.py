"""Pictures of bodies without a display."""

from localreg.drawing.filmstrip import filmstrip
from localreg.drawing.offscreen import Camera, Canvas, Drawing, open_canvas
from localreg.drawing.scene import Figure, Scene, build_scene

__all__ = [
    "Camera",
    "Canvas",
    "Drawing",
    "Figure",
    "Scene",
    "build_scene",
    "filmstrip",
    "open_canvas",
]
