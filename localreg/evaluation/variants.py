"""Methods and their variants by name: `ik`, `ik-truth`, `localreg-squares`.

A variant is a method with one thing changed, so that the two can stand side by side in one
evaluation. `-truth` begins from the true first pose whatever the protocol says; `-squares`
has plain squares in place of the Lorentzian.
"""

from dataclasses import dataclass, replace
from typing import Final

from localreg.errors import SynthesisError
from localreg.synthesis.settings import METHODS, Settings

TRUTH: Final = "-truth"
"""Ending of a method's name that starts from the true first pose."""

SQUARES: Final = "-squares"
"""Ending of a method's name that trusts every tracker alike, outliers included."""

_PLAIN: Final = 1e12  # c of a Lorentzian that is plain squares to twelve digits


@dataclass(frozen=True, slots=True)
class Variant:
    """A method as an evaluation runs it.

    Attributes:
        method: its name among `METHODS`.
        is_given_truth: whether it is given the true first pose.
        has_squares: whether plain squares take the Lorentzian's place.
    """

    method: str
    is_given_truth: bool = False
    has_squares: bool = False

    @property
    def settings(self) -> Settings:
        """The method's settings, changed as the variant says."""
        settings = METHODS[self.method]
        return replace(settings, lorentzian=_PLAIN) if self.has_squares else settings

    @property
    def needs_database(self) -> bool:
        """Whether the method looks at the database."""
        return METHODS[self.method].prior != "ik"

    @property
    def estimator(self) -> str:
        """A name that variants with the same estimator share."""
        return self.method + (SQUARES if self.has_squares else "")


def find_variant(name: str) -> Variant:
    """The variant of a name.

    Raises:
        SynthesisError: there is no such method.
    """
    method, endings = name, set()
    for ending in (TRUTH, SQUARES):
        if method not in METHODS and method.endswith(ending):
            method = method.removesuffix(ending)
            endings.add(ending)
    if method not in METHODS:
        raise SynthesisError(
            f"no method named {name}; choose among {', '.join(METHODS)}, each also with "
            f"{TRUTH} (given the true first pose) or {SQUARES} (not robust) after its name"
        )
    return Variant(method, TRUTH in endings, SQUARES in endings)
