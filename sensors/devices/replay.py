"""Plays a recording as if its devices were there."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from sensors.devices.settings import DeviceSettings


class ReplayConfig(DeviceSettings):
    """Settings of the driver.

    Attributes:
        file: the recording.
        speed: seconds of the recording in one second.
        stations: may be left out: the trackers are those of the recording.
    """

    driver: Literal["replay"] = "replay"
    file: Path
    speed: float = Field(default=1.0, gt=0.0, le=1000.0)
