"""Drivers: one file a transport, found by their settings."""

from sensors.devices.base import Device, DeviceCounters
from sensors.devices.registry import make_decoder, open_device

__all__ = ["Device", "DeviceCounters", "make_decoder", "open_device"]
