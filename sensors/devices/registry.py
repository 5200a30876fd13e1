"""From settings to drivers."""

from collections.abc import Callable
from typing import Any

from sensors.devices.base import ChunkSink, Device
from sensors.devices.decoder import Decoder
from sensors.devices.is900 import Is900Config, Is900Decoder, Is900Device
from sensors.devices.settings import DeviceSettings
from sensors.errors import ConfigurationError
from sensors.stream import SampleQueue

_DEVICES: dict[type[DeviceSettings], tuple[Callable[..., Device], Callable[[Any], Decoder]]] = {
    Is900Config: (Is900Device, Is900Decoder),
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
    return _entry(config)[1](config)


def _entry(
    config: DeviceSettings,
) -> tuple[Callable[..., Device], Callable[[Any], Decoder]]:
    entry = _DEVICES.get(type(config))
    if entry is None:
        raise ConfigurationError(f"there is no driver for {type(config).__name__}")
    return entry
