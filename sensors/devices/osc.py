"""Driver for trackers sent by OSC: VMC performers and VRChat trackers."""

from typing import Literal

from pydantic import Field

from sensors.devices.settings import DeviceSettings


class OscConfig(DeviceSettings):
    """Settings of the driver.

    Attributes:
        host: local address to listen on; "0.0.0.0" hears every network.
        port: UDP port: 39539 or 39540 for VMC, 9000 for VRChat trackers.
        sender: only datagrams from this address count; empty: from anybody.
        stations: what the sender calls each tracker: for VMC the serial number in
            `/VMC/Ext/Tra/Pos`, for VRChat `1` to `8` or `head`.
        silence_timeout: without a pose for this long the state says silent [s].
    """

    driver: Literal["osc"] = "osc"
    host: str = "127.0.0.1"
    port: int = Field(default=39539, ge=0, le=65535)
    sender: str = ""
    silence_timeout: float = Field(default=2.0, gt=0.0)
