"""Methods and their variants by name: `ik`, `ik-truth`, `localreg-squares`, `paper:rank=20`.

A variant is a method with something changed, so that the two can stand side by side in one
evaluation. `:SETTING=VALUE` changes one of `Settings` in its own unit, as often as need be
(`localreg:neighbours=24:components=12`; the entries of a tuple stand between slashes).
`-floorN` gives the prior a least deviation of N degrees, of which methods that cannot tell how
far they may be trusted need more where motion is unlike the database; `-squares` has plain
squares in place of the Lorentzian; `-truth` begins from the true first pose whatever the
protocol says. Of several endings this is the order.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from math import radians
from typing import Any, Final

from localreg.errors import SynthesisError
from localreg.synthesis.settings import METHODS, Settings

TRUTH: Final = "-truth"
"""Ending of a method's name that starts from the true first pose."""

SQUARES: Final = "-squares"
"""Ending of a method's name that trusts every tracker alike, outliers included."""

_FLOOR: Final = re.compile(r"-floor(\d+(?:\.\d+)?)$")
_PLAIN: Final = 1e12  # c of a Lorentzian that is plain squares to twelve digits


@dataclass(frozen=True, slots=True)
class Variant:
    """A method as an evaluation runs it.

    Attributes:
        method: its name among `METHODS`.
        is_given_truth: whether it is given the true first pose.
        has_squares: whether plain squares take the Lorentzian's place.
        floor: ending that says the least deviation; empty for the method's own.
        changes: settings by name that differ from the method's own.
        changed: the same as written, each after a colon.
    """

    method: str
    is_given_truth: bool = False
    has_squares: bool = False
    floor: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    changed: str = ""

    @property
    def is_plain(self) -> bool:
        """Whether the estimator is the method's own."""
        return not self.has_squares and not self.floor and not self.changes

    @property
    def settings(self) -> Settings:
        """The method's settings, changed as the variant says."""
        settings = METHODS[self.method]
        if self.changes:
            settings = replace(settings, **self.changes)
        if self.has_squares:
            settings = replace(settings, lorentzian=_PLAIN)
        found = _FLOOR.match(self.floor)
        return settings if found is None else replace(settings, floor=radians(float(found[1])))

    @property
    def needs_database(self) -> bool:
        """Whether the method looks at the database."""
        return METHODS[self.method].prior != "ik"

    @property
    def estimator(self) -> str:
        """A name that variants with the same estimator share."""
        return self.method + self.changed + self.floor + (SQUARES if self.has_squares else "")


def find_variant(name: str) -> Variant:
    """The variant of a name.

    Raises:
        SynthesisError: there is no such method, or no such setting.
    """
    method = name.removesuffix(TRUTH)
    is_given_truth = method != name
    has_squares = method.endswith(SQUARES)
    method = method.removesuffix(SQUARES)
    floor = _FLOOR.search(method)
    method = method if floor is None else method[: floor.start()]
    method, *changed = method.split(":")
    if method not in METHODS:
        raise SynthesisError(
            f"no method named {name}; choose among {', '.join(METHODS)}, each also with "
            f":SETTING=VALUE, -floorN (a least deviation of N degrees), {SQUARES} (not robust) or "
            f"{TRUTH} (given the true first pose) after its name"
        )
    variant = Variant(
        method,
        is_given_truth,
        has_squares,
        "" if floor is None else floor[0],
        dict(_change(one, METHODS[method]) for one in changed),
        "".join(f":{one}" for one in changed),
    )
    _ = variant.settings  # refuses what does not go together
    return variant


def _change(text: str, settings: Settings) -> tuple[str, Any]:
    """A setting and its value, of the type that it has in the method's settings."""
    name, _, value = text.partition("=")
    known = [one.name for one in fields(Settings) if one.name != "prior"]
    if name not in known:
        raise SynthesisError(f"no setting named {name}; choose among {', '.join(known)}")
    try:
        return name, _read(value, getattr(settings, name))
    except (KeyError, ValueError) as error:
        kind = type(getattr(settings, name)).__name__
        raise SynthesisError(f"{text} is no change; {name} takes a value of type {kind}") from error


def _read(text: str, like: Any) -> Any:
    if isinstance(like, bool):
        return {"True": True, "False": False}[text]
    if isinstance(like, tuple):
        return tuple(float(part) for part in text.split("/"))
    return type(like)(text)
