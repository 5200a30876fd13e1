"""What the settings of all devices have in common."""

from collections.abc import Mapping
from typing import Any, Self

from pydantic import Field, model_validator

from sensors.placement import Placement
from sensors.settings import Settings


class DeviceSettings(Settings):
    """Common settings of devices. Each kind adds `driver`, a word that stands for the kind.

    Attributes:
        name: what to call the device in messages and recordings; by default its driver,
            numbered if there are several.
        stations: for each tracker name what the device calls it, for example
            `{head = 1}` or `{head = "Tracker0:0"}`. Empty: every station that reports
            becomes a tracker of its own name (for looking about, not for a body).
        placement: the device's world in the world common to all devices.
        pause: first pause between attempts to open the device [s]; it doubles each time.
        max_pause: longest such pause [s].
    """

    name: str = Field(default="", pattern=r"^[\w.-]*$")
    stations: Mapping[str, int | str] = Field(default_factory=dict)
    placement: Placement = Placement()
    pause: float = Field(default=0.25, gt=0.0)
    max_pause: float = Field(default=1.0, gt=0.0)

    @model_validator(mode="after")
    def _check_stations(self) -> Self:
        used = [str(s) for s in self.stations.values()]
        if len(set(used)) != len(used):
            raise ValueError(
                f"stations are {dict(self.stations)}; give each tracker a station of its own"
            )
        return self

    @classmethod
    def title_of(cls, values: Mapping[str, Any]) -> str:
        """A device goes by its name, else by its driver."""
        return f"device {values.get('name') or cls.model_fields['driver'].default}"

    @property
    def kind(self) -> str:
        """The value of `driver`."""
        return str(type(self).model_fields["driver"].default)

    @property
    def address(self) -> str:
        """What is opened, in words."""
        return self.kind
