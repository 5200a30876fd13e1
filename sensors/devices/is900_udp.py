"""Driver for the native UDP stream of an InterSense tracker."""

from typing import Literal

from pydantic import Field

from sensors.devices.settings import DeviceSettings


class Is900UdpConfig(DeviceSettings):
    """Settings of the driver.

    Attributes:
        host: local address to listen on; "0.0.0.0" hears every network.
        port: UDP port.
        sender: only datagrams from this address count; empty: from anybody.
        stations: station number of each tracker name, for example `{head = 1}`.
        silence_timeout: without a packet for this long the state says silent [s].
    """

    driver: Literal["is900-udp"] = "is900-udp"
    host: str = "127.0.0.1"
    port: int = Field(default=5001, ge=0, le=65535)
    sender: str = ""
    silence_timeout: float = Field(default=2.0, gt=0.0)
