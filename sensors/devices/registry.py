"""Drivers by name; each is imported only when used."""

import dataclasses
import importlib
from collections.abc import Mapping

from sensors.devices.base import Device
from sensors.errors import ConfigurationError
from sensors.stream import SampleQueue

DRIVERS: dict[str, tuple[str, str, str]] = {
    "is900": ("sensors.devices.is900", "Is900Device", "Is900Config"),
}


def create_device(
    driver: str, settings: Mapping[str, object], samples: SampleQueue | None = None
) -> Device:
    """Make a device from a configuration file's table; it is not started.

    Args:
        driver: a key of `DRIVERS`.
        settings: fields of the driver's configuration class.
        samples: where samples go; by default a queue of its own.

    Raises:
        ConfigurationError: for an unknown driver or setting, listing the valid ones.
    """
    if driver not in DRIVERS:
        raise ConfigurationError(f"no device is called {driver!r}; there are {', '.join(DRIVERS)}")
    module_name, device_name, config_name = DRIVERS[driver]
    module = importlib.import_module(module_name)
    config_class = getattr(module, config_name)
    fields = [f for f in dataclasses.fields(config_class) if f.init]
    valid = {f.name for f in fields}
    unknown = sorted(set(settings) - valid)
    missing = sorted(f.name for f in fields if _required(f) and f.name not in settings)
    if unknown or missing:
        problem = f"unknown {', '.join(unknown)}" if unknown else f"missing {', '.join(missing)}"
        raise ConfigurationError(
            f"settings of {driver}: {problem}; there are {', '.join(sorted(valid))}"
        )
    # TOML has lists where the configuration has tuples.
    values = {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
    return getattr(module, device_name)(config_class(**values), samples)


def _required(f: dataclasses.Field[object]) -> bool:
    return f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
