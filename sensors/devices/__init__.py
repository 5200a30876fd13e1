"""Drivers: one file a transport, found by name."""

from sensors.devices.base import Device, DeviceCounters
from sensors.devices.registry import DRIVERS, create_device

__all__ = ["DRIVERS", "Device", "DeviceCounters", "create_device"]
