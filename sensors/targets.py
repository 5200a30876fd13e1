"""Devices by one word on the command line, and the devices that may be meant."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sensors.config import DeviceConfig, SensorsConfig, device_config, read_config
from sensors.errors import ConfigurationError
from sensors.protocols import is900_udp, osc

_LISTENERS = {
    "is900-udp": is900_udp.DEFAULT_PORT,
    "vmc": osc.VMC_PORT,
    "vrchat": osc.VRCHAT_PORT,
    "osc": osc.VMC_PORT,
}


def device_at(target: str, stations: Mapping[str, int | str] | None = None) -> DeviceConfig:
    """Settings of the device that a word names.

    Args:
        target: a serial port (`/dev/ttyUSB0`), a pyserial URL (`socket://host:port`),
            `vrpn://host[:port]`, a recording (`walk.mcap`), or a port to listen on:
            `is900-udp://[host][:port]`, `vmc://...`, `vrchat://...`.
        stations: what the device calls each tracker; empty for all it has.

    Raises:
        ConfigurationError: for a word that names nothing.
    """
    scheme, colon, rest = target.partition("://")
    values: dict[str, Any] = {"stations": dict(stations or {})}
    if colon and scheme == "vrpn":
        values |= {"driver": "vrpn", "server": rest}
    elif colon and scheme in _LISTENERS:
        host, _, port = rest.partition(":")
        if port and not port.isdecimal():
            raise ConfigurationError(f"{target} has no port; give {scheme}://host:port")
        driver = scheme if scheme == "is900-udp" else "osc"
        values |= {"driver": driver, "port": int(port) if port else _LISTENERS[scheme]}
        values |= {"host": host} if host else {}
    elif target.endswith(".mcap"):
        values |= {"driver": "replay", "file": target}
    else:
        values |= {"driver": "is900", "port": target}
    return device_config(values)


def parse_stations(texts: Sequence[str]) -> dict[str, int | str]:
    """Stations as written on the command line, `tracker=station` each.

    Raises:
        ConfigurationError: for another form.
    """
    stations: dict[str, int | str] = {}
    for text in texts:
        name, equals, station = text.partition("=")
        if not (name and equals and station):
            raise ConfigurationError(f"station is {text!r}; write tracker=station, like head=1")
        stations[name] = int(station) if station.isdecimal() else station
    return stations


def chosen(target: str, config: Path | None, stations: Sequence[str]) -> SensorsConfig:
    """The devices that a command's arguments mean: a word, or a configuration file.

    Raises:
        ConfigurationError: for neither, or both.
    """
    if (config is None) == (not target):
        raise ConfigurationError(
            "name either a device, like /dev/ttyUSB0 or vrpn://host, or a file with --config"
        )
    if config is not None:
        return read_config(config)
    return SensorsConfig(devices=(device_at(target, parse_stations(stations)),))
