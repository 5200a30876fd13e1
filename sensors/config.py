"""The settings of everything on the tracker side, and the file they come from.

A file may hold more tables than these; `read_config` takes its own and leaves the rest.

```toml
[[devices]]
driver = "is900"
port = "/dev/ttyUSB0"
stations = { head = 1, torso = 2, lhand = 3, rhand = 4 }

[[devices]]
driver = "is900"
port = "/dev/ttyUSB1"
stations = { lankle = 1, rankle = 2 }

[assembler]
rate = 40.0

[room]
yaw = 90.0
translation = [0.5, 0.0, 1.2]
```
"""

import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from sensors.assembler import AssemblerConfig
from sensors.devices.is900 import Is900Config
from sensors.devices.is900_udp import Is900UdpConfig
from sensors.devices.osc import OscConfig
from sensors.devices.replay import ReplayConfig
from sensors.devices.vrpn import VrpnConfig
from sensors.errors import ConfigurationError
from sensors.placement import Placement
from sensors.settings import Settings

DeviceConfig = Annotated[
    Is900Config | Is900UdpConfig | VrpnConfig | OscConfig | ReplayConfig,
    Field(discriminator="driver"),
]
"""Settings of any device; the key `driver` says which."""


class SensorsConfig(Settings):
    """The tracker side of a configuration.

    Attributes:
        devices: at least one.
        assembler: how frames are made of samples.
        room: where the trackers' world sits in the room.
    """

    devices: tuple[DeviceConfig, ...] = Field(min_length=1)
    assembler: AssemblerConfig = AssemblerConfig()
    room: Placement = Placement()

    @model_validator(mode="after")
    def _check(self) -> Self:
        twice = [name for name, n in Counter(self.trackers).items() if n > 1]
        if twice:
            raise ValueError(f"tracker {twice[0]} is reported by two devices; name each once")
        if len(self.devices) > 1 and any(isinstance(d, ReplayConfig) for d in self.devices):
            raise ValueError("a replay lives on the time of its recording; let it be alone")
        names = [d.name for d in self.devices if d.name]
        if len(set(names)) != len(names):
            raise ValueError(f"devices are named {', '.join(names)}; give each a name of its own")
        return self

    @property
    def trackers(self) -> tuple[str, ...]:
        """All trackers in the order of the file."""
        return tuple(name for device in self.devices for name in device.stations)

    def named_devices(self) -> tuple[DeviceConfig, ...]:
        """The devices, each with a unique name: its own, else its driver's with a number."""
        alone = Counter(d.kind for d in self.devices)
        taken = {d.name for d in self.devices if d.name}
        count: Counter[str] = Counter()
        named: list[DeviceConfig] = []
        for device in self.devices:
            name = device.name
            while not name:
                count[device.kind] += 1
                number = "" if alone[device.kind] == 1 else str(count[device.kind])
                name = device.kind + number
                name = "" if name in taken and number else name
            taken.add(name)
            named.append(device.model_copy(update={"name": name}))
        return tuple(named)


def device_config(values: Mapping[str, Any]) -> DeviceConfig:
    """Settings of one device from a table with a key `driver`.

    Raises:
        ConfigurationError: one sentence that names the key and the nearest valid one.
    """
    return SensorsConfig.parse({"devices": [dict(values)]}).devices[0]


def read_config(path: Path) -> SensorsConfig:
    """The tables `devices`, `assembler` and `room` of a TOML file.

    Raises:
        ConfigurationError: if the file cannot be read or its tables have no meaning.
    """
    table = read_toml(path)
    return SensorsConfig.parse(
        {key: table[key] for key in SensorsConfig.model_fields if key in table}, where=str(path)
    )


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file.

    Raises:
        ConfigurationError: if it cannot be read, naming the line.
    """
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except OSError as error:
        raise ConfigurationError(f"cannot read {path}: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path} is no TOML: {error}") from error
