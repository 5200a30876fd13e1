"""Camera presets for the viewers of `mujoco.studio`.

The camera tracks the body, so that browsers can follow it and turn around it on their own; a
preset turns it once, and once more when the body has been found anew.
"""

import math
from typing import Final

import mujoco
from mujoco.studio import viewer_protocol

from localreg.view.cameras import Preset, look_from
from localreg.view.moment import Moment

_TRACKED: Final = 1  # the body's root, behind the world


class CameraMan:
    """Turns the camera of one viewer.

    Args:
        viewer: whose camera.
    """

    def __init__(self, viewer: viewer_protocol.Viewer) -> None:
        self._viewer = viewer
        viewer.camera.type = int(mujoco.mjtCamera.mjCAMERA_TRACKING)
        viewer.camera.trackbodyid = _TRACKED
        viewer.camera.distance, viewer.camera.elevation = 3.2, -9.0
        self._preset: Preset | None = None
        self._is_placed = False

    def place(self, preset: Preset, moment: Moment) -> None:
        """Look at a body from a preset's direction."""
        found = look_from(preset, moment.qpos)
        camera = self._viewer.camera
        camera.azimuth = math.degrees(found.azimuth)
        camera.elevation = math.degrees(found.elevation)
        camera.distance = 1.15 * found.distance
        self._preset = preset
        self._is_placed = True

    def mind(self, moment: Moment) -> None:
        """Look at a body that was just found, as long as nobody has turned the camera."""
        if not self._is_placed:
            self.place("follow", moment)
        elif moment.is_start and self._preset is not None:
            self.place(self._preset, moment)
