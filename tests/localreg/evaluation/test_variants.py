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


def test_any_setting_can_be_changed() -> None:
    name = "lpca:neighbours=24:floor=2e-2:search_by_trackers=False:metric_history=1/0/0-truth"
    variant = find_variant(name)
    assert (variant.method, variant.is_given_truth, variant.is_plain) == ("lpca", True, False)
    settings = variant.settings
    assert (settings.neighbours, settings.floor, settings.search_by_trackers) == (24, 0.02, False)
    assert settings.metric_history == (1.0, 0.0, 0.0)
    assert settings.rank == METHODS["lpca"].rank
    assert variant.estimator == name.removesuffix("-truth")
    both = find_variant("paper:rank=20-floor8-squares")
    assert (both.settings.rank, both.has_squares) == (20, True)
    assert np.degrees(both.settings.floor) == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("paper:ranks=20", "no setting named ranks; choose among neighbours"),
        ("paper:prior=lpcr", "no setting named prior"),
        ("paper:rank=2.5", "rank=2.5 is no change; rank takes a value of type int"),
        ("paper:rank", "takes a value of type int"),
        ("paper:search_by_trackers=yes", "takes a value of type bool"),
        ("localreg:history=2", "metric_history needs one weight for each of the 2"),
    ],
)
def test_changes_that_cannot_be_made_are_refused(name: str, says: str) -> None:
    with pytest.raises(SynthesisError, match=says):
        Protocol(methods=(name,))


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
