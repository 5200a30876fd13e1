"""Methods and their variants by name: `ik`, `ik-truth`, `localreg-squares`, `paper-floor8`.

A variant is a method with one thing changed, so that the two can stand side by side in one
evaluation. `-floorN` gives the prior a least deviation of N degrees, of which methods that
cannot tell how far they may be trusted need more where motion is unlike the database;
`-squares` has plain squares in place of the Lorentzian; `-truth` begins from the true first
pose whatever the protocol says. Of several endings this is the order.
"""

import re
from dataclasses import dataclass, replace
from math import radians
from typing import Final

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
    """

    method: str
    is_given_truth: bool = False
    has_squares: bool = False
    floor: str = ""

    @property
    def is_plain(self) -> bool:
        """Whether the estimator is the method's own."""
        return not self.has_squares and not self.floor

    @property
    def settings(self) -> Settings:
        """The method's settings, changed as the variant says."""
        settings = METHODS[self.method]
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
        return self.method + self.floor + (SQUARES if self.has_squares else "")


def find_variant(name: str) -> Variant:
    """The variant of a name.

    Raises:
        SynthesisError: there is no such method.
    """
    method = name.removesuffix(TRUTH)
    is_given_truth = method != name
    has_squares = method.endswith(SQUARES)
    method = method.removesuffix(SQUARES)
    floor = _FLOOR.search(method)
    method = method if floor is None else method[: floor.start()]
    if method not in METHODS:
        raise SynthesisError(
            f"no method named {name}; choose among {', '.join(METHODS)}, each also with "
            f"-floorN (a least deviation of N degrees), {SQUARES} (not robust) or {TRUTH} (given "
            "the true first pose) after its name"
        )
    return Variant(method, is_given_truth, has_squares, "" if floor is None else floor[0])
