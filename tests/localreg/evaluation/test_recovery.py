"""Recovery times of errors that were made up to have known ones."""

import numpy as np
import pytest

from localreg.evaluation.recovery import frames_to_recover, recovery_s

RATE = 40.0


def test_recovery_counts_frames_after_the_end() -> None:
    usual = np.full(50, 2.0)
    error = usual.copy()
    error[10:27] = 5.0
    assert frames_to_recover(error, usual, 20) == 7
    assert frames_to_recover(error, usual, 27) == 0
    error[10:] = 2.3
    assert frames_to_recover(error, usual, 20) == 30, "never back counts all that are left"
    error[10:] = 2.19
    assert frames_to_recover(error, usual, 20) == 0, "110 % is back"


def test_recovery_is_the_mean_over_gaps() -> None:
    error, there = np.full(400, 1.0), np.ones(400, dtype=bool)
    there[100:120] = there[250:260] = False
    error[100:128] = 3.0  # 8 frames after the first gap
    error[250:264] = 3.0  # 4 after the second
    assert recovery_s(error, there, RATE) == pytest.approx(6 / RATE)


def test_a_gap_that_comes_too_soon_ends_the_count() -> None:
    error, there = np.full(400, 1.0), np.ones(400, dtype=bool)
    there[100:120] = there[125:130] = False
    error[100:140] = 3.0
    assert recovery_s(error, there, RATE) == pytest.approx((5 + 10) / 2 / RATE)


def test_without_gaps_there_is_nothing_to_recover_from() -> None:
    assert recovery_s(np.ones(50), np.ones(50, dtype=bool), RATE) is None
    lost = np.ones(50, dtype=bool)
    lost[20:] = False
    assert recovery_s(np.ones(50), lost, RATE) is None, "a gap to the end was not outlasted"
