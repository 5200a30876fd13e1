"""From settings to drivers."""

from collections.abc import Callable
from typing import Any

from sensors.devices.base import ChunkSink, Device
from sensors.devices.decoder import Decoder
from sensors.devices.is900 import Is900Config, Is900Decoder, Is900Device
from sensors.devices.is900_udp import Is900UdpConfig, Is900UdpDecoder, Is900UdpDevice
from sensors.devices.osc import OscConfig, OscDecoder, OscDevice
from sensors.devices.replay import ReplayConfig, ReplayDevice
from sensors.devices.settings import DeviceSettings
from sensors.devices.vrpn import VrpnConfig, VrpnDecoder, VrpnDevice
from sensors.errors import ConfigurationError
from sensors.stream import SampleQueue

_Entry = tuple[Callable[..., Device], Callable[[Any], Decoder] | None]

_DEVICES: dict[type[DeviceSettings], _Entry] = {
    Is900Config: (Is900Device, Is900Decoder),
    Is900UdpConfig: (Is900UdpDevice, Is900UdpDecoder),
    VrpnConfig: (VrpnDevice, VrpnDecoder),
    OscConfig: (OscDevice, OscDecoder),
    # What a recording was made from is a recording's own affair.
    ReplayConfig: (ReplayDevice, None),
}


def open_device(
    config: DeviceSettings,
    samples: SampleQueue | None = None,
    recorder: ChunkSink | None = None,
) -> Device:
    """The driver for some settings; it is not started.

    Args:
        config: settings of one of the drivers, see `sensors.config.DeviceConfig`.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.
    """
    return _entry(config)[0](config, samples, recorder)


def make_decoder(config: DeviceSettings) -> Decoder:
    """The decoder of a device without the device, for replaying its chunks."""
    decoder = _entry(config)[1]
    if decoder is None:
        raise ConfigurationError(f"the driver {config.kind} has no bytes of its own to decode")
    return decoder(config)


def _entry(config: DeviceSettings) -> _Entry:
    entry = _DEVICES.get(type(config))
    if entry is None:
        raise ConfigurationError(f"there is no driver for {type(config).__name__}")
    return entry
