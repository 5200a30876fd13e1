"""Pictures of bodies without a display; those with plots and words are in `filmstrip.py`."""

from localreg.drawing.offscreen import Camera, Canvas, Drawing, open_canvas
from localreg.drawing.scene import Figure, Scene, build_scene

__all__ = [
    "Camera",
    "Canvas",
    "Drawing",
    "Figure",
    "Scene",
    "build_scene",
    "open_canvas",
]
