"""Driver for trackers behind a VRPN server."""

from typing import Literal

from pydantic import Field

from sensors.devices.settings import DeviceSettings


class VrpnConfig(DeviceSettings):
    """Settings of the driver.

    Attributes:
        server: address of the VRPN server, `host` or `host:port`.
        stations: what the server calls each tracker, `"DEVICE:SENSOR"` or just `"DEVICE"`
            for its sensor 0; for example `{head = "Tracker0:0", torso = "Tracker0:1"}`.
        udp: ask for reports by UDP instead of TCP.
        listen_host: local address for reports by UDP; by default the one that the TCP
            connection to the server goes out from.
        connect_timeout: how long connecting may take [s].
        silence_timeout: without any message for this long the connection is made anew [s].
    """

    driver: Literal["vrpn"] = "vrpn"
    server: str = Field(min_length=1)
    udp: bool = False
    listen_host: str = ""
    connect_timeout: float = Field(default=3.0, gt=0.0)
    silence_timeout: float = Field(default=10.0, gt=0.0)
