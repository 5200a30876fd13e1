"""Smoothing with look-ahead: no lag, less noise, gaps bridged, jumps kept."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.errors import LocalregError
from localreg.live import smooth as module
from localreg.live.smooth import _band
from tests.localreg.live.poses import random_qpos

RATE = 40.0
FRAMES = 240
CUTOFF = 7.0
T = np.arange(FRAMES) / RATE


def motion(noise: float = 0.0) -> np.ndarray:
    """Angles that swing at 0.5 to 2.5 Hz, a root that walks and turns over."""
    rng = np.random.default_rng(0)
    qpos = np.tile(random_qpos(0), (FRAMES, 1))
    f = np.linspace(0.5, 2.5, 56)
    qpos[:, 7:] += 0.4 * np.sin(2.0 * np.pi * f * T[:, None] + np.arange(56))
    qpos[:, 0] += T
    turn = Rotation.from_rotvec(np.outer(T, [0.3, 2.0, 0.5]))
    qpos[:, 3:7] = turn.as_quat(scalar_first=True) * np.where(T > 3.0, -1.0, 1.0)[:, None]
    qpos[:, 7:] += noise * rng.normal(size=(FRAMES, 56))
    qpos[:, :3] += noise * rng.normal(size=(FRAMES, 3))
    return qpos


def smooth(qpos: np.ndarray, sigma: np.ndarray, rate: float, cutoff: float = CUTOFF, **options):
    return module.smooth(qpos, sigma, rate, cutoff=cutoff, **options)


def sigmas(value: float = 0.05) -> np.ndarray:
    return np.full((FRAMES, 56), value)


def test_the_penalty_is_that_of_third_differences():
    D = np.diff(np.eye(12), n=3, axis=0)
    full = D.T @ D
    band = _band(12)
    for offset in range(4):
        np.testing.assert_allclose(np.diag(full, offset), band[3 - offset, offset:])
    np.testing.assert_array_equal(np.triu(full, 4), 0.0)


def test_what_is_smooth_stays():
    clean = motion()
    np.testing.assert_allclose(smooth(clean, sigmas(), RATE)[:, 7:], clean[:, 7:], atol=8e-3)


def test_noise_goes_and_nothing_lags():
    clean, noisy = motion(), motion(0.02)
    smoothed = smooth(noisy, sigmas(), RATE)
    inner = slice(10, -10)

    def error(a: np.ndarray, shift: int = 0) -> float:
        return float(np.sqrt(np.mean((np.roll(a, shift, axis=0) - clean)[inner, 7:] ** 2)))

    assert error(smoothed) < 0.75 * error(noisy)
    assert error(smoothed) < min(error(smoothed, 1), error(smoothed, -1))
    # The best sub-frame shift is none: early and late are equally bad.
    assert error(smoothed, 1) == pytest.approx(error(smoothed, -1), rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(smoothed[:, 3:7], axis=1), 1.0, atol=1e-12)


def test_time_backwards_gives_the_same():
    noisy = motion(0.02)
    forward = smooth(noisy, sigmas(), RATE)
    backward = smooth(noisy[::-1].copy(), sigmas(), RATE)[::-1]
    np.testing.assert_allclose(forward[:, 7:], backward[:, 7:], atol=1e-9)


def test_held_frames_are_bridged_from_both_sides():
    clean = motion()
    held = np.zeros(FRAMES, dtype=np.bool_)
    held[100:106] = True
    frozen = clean.copy()
    frozen[held] = clean[99]
    smoothed = smooth(frozen, sigmas(), RATE, held=held)
    before = np.abs(frozen - clean)[held, 7:].max()
    assert before > 0.2
    assert np.abs(smoothed - clean)[held, 7:].max() < 0.25 * before


def test_angles_that_are_said_to_be_uncertain_count_less():
    noisy = motion()
    noisy[50, 7:] += 0.3
    doubtful = sigmas()
    doubtful[50] *= 4.0
    clean = motion()[50, 7:]
    trusting = np.abs(smooth(noisy, sigmas(), RATE)[50, 7:] - clean)
    doubting = np.abs(smooth(noisy, doubtful, RATE)[50, 7:] - clean)
    assert (doubting < 0.4 * trusting).all()


def test_nothing_is_smoothed_across_a_start():
    jumping = motion()
    jumping[120:, 7:] += 1.0
    starts = np.zeros(FRAMES, dtype=np.bool_)
    starts[[0, 120]] = True
    smoothed = smooth(jumping, sigmas(), RATE, starts=starts)
    np.testing.assert_allclose(smoothed[:, 7:], jumping[:, 7:], atol=0.02)


def test_sigmas_may_be_missing():
    noisy = motion(0.02)
    np.testing.assert_allclose(
        smooth(noisy, np.full((FRAMES, 56), np.nan), RATE), smooth(noisy, sigmas(), RATE)
    )


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
def test_short_takes_survive(frames: int):
    qpos = motion()[:frames]
    assert smooth(qpos, sigmas()[:frames], RATE).shape == qpos.shape


@pytest.mark.parametrize("cutoff", [0.0, -1.0, 20.0, float("nan")])
def test_cutoffs_beyond_half_the_rate_are_refused(cutoff: float):
    with pytest.raises(LocalregError, match="between 0 and 20 Hz"):
        smooth(motion(), sigmas(), RATE, cutoff=cutoff)
