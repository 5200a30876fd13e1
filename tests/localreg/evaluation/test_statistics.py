"""Bootstrap intervals of paired differences."""

import numpy as np
import pytest

from localreg.evaluation.statistics import paired_difference


def test_what_clips_agree_on_is_sure_though_they_differ_among_themselves() -> None:
    rng = np.random.default_rng(0)
    hardness = rng.uniform(1.0, 30.0, 30)
    worse = hardness + 0.3 + 0.05 * rng.standard_normal(30)
    found = paired_difference(hardness.tolist(), worse.tolist())
    assert found.mean == pytest.approx(np.mean(hardness - worse))
    assert found.low < found.mean < found.high < 0.0
    assert found.high - found.low < 0.06
    assert found.is_sure
    assert found.clips == 30


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(1)
    covered = 0
    for trial in range(60):
        other = rng.uniform(0.0, 5.0, 25)
        one = other + 0.2 + 0.5 * rng.standard_normal(25)
        found = paired_difference(one.tolist(), other.tolist(), seed=trial)
        covered += found.low <= 0.2 <= found.high
    assert covered >= 50  # 57 of 60 expected


def test_the_same_seed_gives_the_same_interval() -> None:
    one, other = [1.0, 2.0, 4.0, 3.0], [1.5, 1.9, 4.5, 3.3]
    assert paired_difference(one, other) == paired_difference(one, other)


def test_no_difference_is_no_difference() -> None:
    found = paired_difference([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert (found.mean, found.low, found.high) == (0.0, 0.0, 0.0)
    assert not found.is_sure


def test_too_little_to_say_says_nothing() -> None:
    few = paired_difference([1.0, 2.0], [3.0, 3.0])
    assert (few.mean, few.low, few.high, few.clips) == (-1.5, None, None, 2)
    assert not few.is_sure
    assert paired_difference([None, None], [1.0, 2.0]).mean is None
    missing = paired_difference([1.0, None, 2.0], [2.0, 5.0, None])
    assert (missing.mean, missing.clips) == (-1.0, 1)
    broken = paired_difference([1.0, float("nan"), 2.0, 3.0], [1.0, 2.0, 3.0, 4.0])
    assert broken.mean is None
    with pytest.raises(ValueError, match="longer"):
        paired_difference([1.0], [1.0, 2.0])
