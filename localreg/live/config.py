"""Everything a run is set up by: one TOML file, validated, with defaults in the code.

```toml
[[devices]]
driver = "is900"
port = "/dev/ttyUSB0"
stations = { head = 1, torso = 2, lhand = 3, rhand = 4, lankle = 5, rankle = 6 }

[synthesis]
method = "localreg"
position_error_m = 0.02      # of trackers noisier than an IS-900

[[outputs]]
protocol = "vmc"
host = "192.168.1.30"
```

The tables `devices`, `assembler` and `room` are those of `sensors.config`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from localreg.live.performance_config import PerformanceConfig
from sensors.config import SensorsConfig, read_toml
from sensors.protocols import osc, vrpn
from sensors.settings import Settings

EMULATED_PORT = "emulator"
"""Port of an IS-900 that the table `emulator` stands in for."""

_Port = Annotated[int, Field(ge=1, le=65535)]


class SynthesisConfig(Settings):
    """How poses are made.

    Attributes:
        method: which estimator; `localreg`, or another of `localreg evaluate --methods`.
        position_error_m: what a tracker's position is believed to be off by, as a root mean
            square distance [m]; as the method was tuned if None (`localreg`: 5 mm).
        orientation_error_deg: the same for its orientation [deg] (`localreg`: 0.65).
    """

    method: str = "localreg"
    position_error_m: Annotated[float, Field(gt=0.0, le=0.5)] | None = None
    orientation_error_deg: Annotated[float, Field(gt=0.0, le=60.0)] | None = None


class VmcOutput(Settings):
    """Avatar programs, by the Virtual Motion Capture protocol.

    Attributes:
        protocol: the kind of output.
        host: where the program runs.
        port: its UDP port.
    """

    protocol: Literal["vmc"]
    host: str = "127.0.0.1"
    port: _Port = osc.VMC_PORT


class VrchatOutput(Settings):
    """VRChat's OSC trackers.

    Attributes:
        protocol: the kind of output.
        host: where VRChat runs.
        port: its UDP port.
    """

    protocol: Literal["vrchat"]
    host: str = "127.0.0.1"
    port: _Port = osc.VRCHAT_PORT


class JsonOutput(Settings):
    """One JSON object a datagram, for programs of a dozen lines.

    Attributes:
        protocol: the kind of output.
        host: where the listener runs.
        port: its UDP port.
    """

    protocol: Literal["json"]
    host: str = "127.0.0.1"
    port: _Port = 39550


class VrpnOutput(Settings):
    """A VRPN server whose tracker has the root and the bones as sensors.

    Attributes:
        protocol: the kind of output.
        port: where it listens, on 127.0.0.1 unless `localreg run --host` says otherwise; 0
            for any.
        device: name of the tracker.
    """

    protocol: Literal["vrpn"]
    port: Annotated[int, Field(ge=0, le=65535)] = vrpn.DEFAULT_PORT
    device: str = "Body0"


class LslOutput(Settings):
    """A stream of the Lab Streaming Layer, which announces itself to the whole network.

    Attributes:
        protocol: the kind of output.
        stream: its name.
    """

    protocol: Literal["lsl"]
    stream: str = "MoCap"


OutputConfig = Annotated[
    VmcOutput | VrchatOutput | JsonOutput | VrpnOutput | LslOutput, Field(discriminator="protocol")
]
"""Settings of any output; the key `protocol` says which."""


class EmulatorConfig(Settings):
    """Real motion played by an emulated IS-900, where no device is at hand.

    Attributes:
        clips: names of the sample set's clips, played one after another, over and over; by
            default all.
        noise_position: standard deviation on each axis [m].
        noise_orientation: standard deviation about each axis [deg].
        seed: of the noise.
    """

    clips: tuple[str, ...] = ()
    noise_position: float = Field(default=0.003, ge=0.0)
    noise_orientation: float = Field(default=0.5, ge=0.0)
    seed: int = Field(default=0, ge=0)


class RunConfig(SensorsConfig):
    """A whole configuration file.

    Attributes:
        synthesis: how poses are made.
        performance: when to step, when to hold, when to begin anew.
        outputs: who gets the poses.
        emulator: stands in for the device whose port is `emulator`.

    Raises:
        ConfigurationError: naming the key, what is wrong, and the nearest valid one.
    """

    synthesis: SynthesisConfig = SynthesisConfig()
    performance: PerformanceConfig = PerformanceConfig()
    outputs: tuple[OutputConfig, ...] = ()
    emulator: EmulatorConfig | None = None

    @model_validator(mode="after")
    def _check_emulator(self) -> Self:
        emulated = [d for d in self.devices if getattr(d, "port", "") == EMULATED_PORT]
        if (self.emulator is not None) != (len(emulated) == 1):
            raise ValueError(
                f'the table [emulator] belongs to one device with port = "{EMULATED_PORT}"; '
                "give both or neither"
            )
        return self

    def with_port(self, address: str) -> Self:
        """The same, with an address in place of the emulated port."""
        devices = tuple(
            d.model_copy(update={"port": address}) if getattr(d, "port", "") == EMULATED_PORT else d
            for d in self.devices
        )
        return self.model_copy(update={"devices": devices, "emulator": None})

    def at_rate(self, rate: float) -> Self:
        """The same at a database's rate, unless the file demands one [Hz]."""
        if "rate" in self.assembler.model_fields_set:
            return self
        given: Mapping[str, Any] = self.assembler.model_dump(exclude_unset=True)
        return self.model_copy(update={"assembler": type(self.assembler)(**given, rate=rate)})


def read_run_config(path: Path) -> RunConfig:
    """A configuration from a TOML file.

    Raises:
        ConfigurationError: the file cannot be read, or something in it has no meaning; one
            sentence that names the file and the key.
    """
    return RunConfig.parse(read_toml(path), where=str(path))
