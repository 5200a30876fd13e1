"""Methods and their variants by name."""

import numpy as np
import pytest

from localreg.errors import SynthesisError
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.variants import find_variant
from localreg.synthesis.settings import METHODS


@pytest.mark.parametrize("method", METHODS)
def test_every_method_has_its_variants(method: str) -> None:
    assert find_variant(method).settings is METHODS[method]
    given = find_variant(f"{method}-truth")
    assert (given.method, given.is_given_truth, given.has_squares) == (method, True, False)
    assert given.estimator == method
    both = find_variant(f"{method}-squares-truth")
    assert (both.method, both.is_given_truth, both.has_squares) == (method, True, True)
    squares = find_variant(f"{method}-squares")
    assert squares.settings.lorentzian > 1e9
    assert squares.settings.prior == METHODS[method].prior
    assert squares.estimator != method
    wide = find_variant(f"{method}-floor2.5-squares-truth")
    assert (wide.method, wide.is_given_truth, wide.has_squares) == (method, True, True)
    assert np.degrees(wide.settings.floor) == pytest.approx(2.5)
    assert np.degrees(find_variant(f"{method}-floor8").settings.floor) == pytest.approx(8.0)
    names = [f"{method}{ending}" for ending in ("", "-floor8", "-floor9", "-squares")]
    assert len({find_variant(name).estimator for name in names}) == 4
    assert [find_variant(name).is_plain for name in names] == [True, False, False, False]


def test_only_inverse_kinematics_needs_no_database() -> None:
    assert not find_variant("ik-truth").needs_database
    assert not Protocol(methods=("ik", "ik-squares")).needs_database
    assert Protocol(methods=("ik", "lpca-truth")).needs_database


@pytest.mark.parametrize(
    "name",
    ["magic", "magic-truth", "ik-magic", "-truth", "ik-truth-squares", "ik-floor", "ik-floor-8"],
)
def test_what_there_is_not_is_refused(name: str) -> None:
    with pytest.raises(SynthesisError, match="choose among localreg"):
        find_variant(name)
