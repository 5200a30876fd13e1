import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors import rotation
from sensors.assembler import AssembledFrame, AssemblerConfig, FrameAssembler
from sensors.errors import ConfigurationError
from sensors.history import TrackerHistory
from sensors.pose import PoseSample

T = 0.025
TRACKERS = ("head", "pelvis", "left_hand")


def truth(name: str, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Constant velocity and constant angular velocity: interpolation is exact."""
    k = 1.0 + len(name)
    p = np.array([0.3 * t * k, -0.2 * t, 1.0 + 0.1 * k])
    mount = rotation.from_rotation_vector(np.array([0.0, 0.0, 0.1 * k]))
    return p, rotation.multiply(rotation.from_rotation_vector(np.array([0.0, 0.4 * t, 0.0])), mount)


def sample(name: str, t: float, quality: float = 1.0) -> PoseSample:
    return PoseSample(name, t, *truth(name, t), quality)


def play(
    assembler: FrameAssembler,
    arrivals: list[tuple[float, PoseSample]],
    until: float,
    step: float = 0.002,
) -> list[AssembledFrame]:
    """Push samples at their arrival times and poll every other millisecond."""
    queue = sorted(arrivals, key=lambda a: a[0])
    frames: list[AssembledFrame] = []
    now = queue[0][0]
    while now < until:
        while queue and queue[0][0] <= now:
            arrival, s = queue.pop(0)
            assembler.push(s, arrival)
            frames += assembler.poll(arrival)
        frames += assembler.poll(now)
        now += step
    return frames


def stream(
    rate: float, until: float, phase: float = 0.0, delay: float = 0.002, lost=lambda name, t: False
) -> list[tuple[float, PoseSample]]:
    times = 1.0 + phase + np.arange(0.0, until - 1.0, 1.0 / rate)
    return [
        (t + delay, sample(n, t)) for t in map(float, times) for n in TRACKERS if not lost(n, t)
    ]


def worst_error(frames: list[AssembledFrame]) -> float:
    error = 0.0
    for f in frames:
        for j, name in enumerate(TRACKERS):
            if f.frame.position_mask[j]:
                p, q = truth(name, f.frame.time)
                error = max(error, float(np.abs(f.frame.positions[j] - p).max()))
                error = max(error, float(rotation.angle_between(f.frame.quaternions[j], q)))
    return error


@pytest.mark.parametrize("rate", [40.0, 52.0, 58.0, 80.0, 120.0, 180.0])
def test_all_trackers_are_there_and_right_at_any_sample_rate(rate):
    assembler = FrameAssembler(TRACKERS)
    frames = play(assembler, stream(rate, 2.5), 2.4)
    assert len(frames) >= 50
    assert all(f.frame.position_mask.all() and f.frame.orientation_mask.all() for f in frames[1:])
    assert worst_error(frames) < 1e-7
    times = np.array([f.frame.time for f in frames])
    assert np.abs(np.diff(times) / T - 1.0).max() <= 0.0101
    np.testing.assert_array_equal([f.index for f in frames], np.arange(len(frames)))


def test_at_the_frame_rate_frames_close_with_their_last_sample():
    assembler = FrameAssembler(TRACKERS)
    frames = play(assembler, stream(40.0, 2.5), 2.4)
    for f in frames[1:]:
        assert f.closed_at == pytest.approx(f.newest_arrival, abs=1e-9)
        assert f.closed_at - f.frame.time < 0.005


def test_the_grid_settles_on_a_stream_that_changes_phase():
    first = [a for a in stream(40.0, 2.0) if a[0] < 1.9]
    second = [(a + 0.011, sample(s.tracker, s.time + 0.011)) for a, s in stream(40.0, 6.0)]
    assembler = FrameAssembler(TRACKERS)
    frames = play(assembler, first + [a for a in second if a[0] > 1.92], 5.9)
    late = [f for f in frames if f.frame.time > 5.0]
    phases = np.array([(f.frame.time - 0.011) / T for f in late])
    assert np.abs(phases - np.round(phases)).max() < 0.05
    assert all(f.closed_at - f.frame.time < 0.006 for f in late)


def test_a_line_slower_than_the_delay_shifts_the_grid_instead_of_losing_trackers():
    # Three stations of one instant arrive 3, 11 and 19 ms later; the delay is 12.5 ms.
    arrivals = [
        (s.time + 0.003 + 0.008 * TRACKERS.index(s.tracker), s) for _, s in stream(40.0, 5.0)
    ]
    frames = play(FrameAssembler(TRACKERS), arrivals, 4.9)
    late = [f for f in frames if f.frame.time > 3.5]
    assert all(f.frame.position_mask.all() for f in late)
    assert worst_error(late) < 1e-7
    assert max(f.closed_at - f.newest_arrival for f in late) < 0.002


def test_no_frame_waits_longer_than_the_delay():
    frames = play(FrameAssembler(TRACKERS), stream(52.0, 2.5), 2.4)
    assert max(f.closed_at - f.frame.time for f in frames) <= 0.0125 + 0.0021


def test_a_silent_tracker_is_masked_not_coasted_and_not_waited_for():
    gone = stream(40.0, 5.0, lost=lambda n, t: n == "pelvis" and 2.0 <= t < 3.0)
    frames = play(FrameAssembler(TRACKERS), gone, 4.9)
    for f in frames:
        if 2.01 < f.frame.time < 2.98:
            np.testing.assert_array_equal(f.frame.position_mask, [True, False, True])
            np.testing.assert_array_equal(f.frame.orientation_mask, [True, False, True])
            assert np.isfinite(f.frame.positions).all()
            np.testing.assert_allclose(np.linalg.norm(f.frame.quaternions, axis=1), 1.0)
        if f.frame.time > 3.1 or f.frame.time < 1.98:
            assert f.frame.position_mask.all()
        if 2.1 < f.frame.time < 2.9:
            assert f.closed_at == pytest.approx(f.newest_arrival, abs=1e-9)
    assert worst_error(frames) < 1e-7


def test_total_silence_gives_masked_frames_on_time():
    assembler = FrameAssembler(TRACKERS)
    frames = play(assembler, stream(40.0, 1.5), 2.0)
    silent = [f for f in frames if f.frame.time > 1.55]
    assert len(silent) >= 15
    assert not any(f.frame.position_mask.any() for f in silent)
    assert all(math.isnan(f.newest_arrival) for f in silent)


def test_extrapolation_is_exact_for_even_motion_and_bounded():
    history = TrackerHistory()
    for k in range(4):
        history.insert(k * T, *truth("head", k * T), k * T)
    bracket = history.at(3 * T + 0.02, 0.0025, 0.02375, 0.1)
    assert bracket is not None
    assert bracket.fraction > 1.0
    assert history.at(3 * T + 0.025, 0.0025, 0.02375, 0.1) is None


def test_a_gap_is_not_bridged_but_its_edges_are_used():
    history = TrackerHistory()
    for t in (0.0, 0.025, 1.0):
        history.insert(t, *truth("head", t), t)
    assert history.at(0.5, 0.0025, 0.02, 0.1) is None
    edge = history.at(0.999, 0.0025, 0.02, 0.1)
    assert edge is not None
    np.testing.assert_array_equal(edge.newer[0], truth("head", 1.0)[0])


def test_the_first_frame_waits_for_trackers_not_seen_yet():
    assembler = FrameAssembler(TRACKERS)
    assembler.push(sample("head", 1.0), 1.001)
    assert assembler.poll(1.002) == []
    assembler.push(sample("pelvis", 1.0), 1.004)
    assembler.push(sample("left_hand", 1.0), 1.007)
    (frame,) = assembler.poll(1.008)
    assert frame.frame.position_mask.all()
    assert frame.newest_arrival == 1.007


def test_bad_samples_are_refused_and_counted():
    assembler = FrameAssembler(TRACKERS)
    p, q = truth("head", 1.0)
    nan = np.full(3, np.nan)
    assert assembler.push(sample("head", 1.0), 1.0)
    assert not assembler.push(sample("head", 1.0), 1.0)
    assert not assembler.push(sample("tail", 1.0), 1.0)
    assert not assembler.push(PoseSample("head", 1.1, nan, q), 1.1)
    assert not assembler.push(PoseSample("head", 1.1, p, np.zeros(4)), 1.1)
    assert not assembler.push(PoseSample("head", math.nan, p, q), 1.1)
    assert not assembler.push(sample("head", 1.1, quality=0.0), 1.1)
    assert not assembler.push(sample("head", 5.0), 1.1)
    c = assembler.counters
    assert (c.samples, c.duplicates, c.unknown, c.not_finite, c.lost, c.skewed) == (
        1,
        1,
        1,
        3,
        1,
        1,
    )
    assert c.dropped == 7


def test_late_and_disordered_samples_are_counted_and_still_help():
    assembler = FrameAssembler(("head",), AssemblerConfig(lock_phase=False))
    for k in range(3):
        assembler.push(sample("head", 1.0 + k * T), 1.0 + k * T)
        assembler.poll(1.0 + k * T)
    assert assembler.counters.frames == 3
    assembler.push(sample("head", 1.0 + 1.5 * T), 1.06)
    assert assembler.counters.late == 1
    assert assembler.counters.out_of_order == 1
    assert assembler.counters.samples == 4


def test_after_a_long_pause_of_the_consumer_old_frames_are_skipped_and_counted():
    assembler = FrameAssembler(TRACKERS)
    play(assembler, stream(40.0, 1.3), 1.3)
    frames = assembler.poll(11.3)
    assert len(frames) == assembler.config.max_backlog
    assert assembler.counters.skipped_frames > 380
    assert frames[-1].frame.time > 11.3 - 0.0125 - 2 * T


@settings(deadline=None, max_examples=20)
@given(
    events=st.lists(
        st.tuples(
            st.sampled_from([*TRACKERS, "nobody"]),
            st.floats(0.0, 1.0) | st.just(math.nan),
            st.floats(-0.05, 0.2),
        ),
        max_size=120,
    )
)
def test_whatever_arrives_frames_stay_finite_and_in_order(events):
    assembler = FrameAssembler(TRACKERS)
    frames: list[AssembledFrame] = []
    now = 0.0
    for name, t, delay in events:
        now = max(now, (0.0 if math.isnan(t) else t) + delay)
        p, q = truth(name, 0.5)
        assembler.push(PoseSample(name, t, p, q), now)
        frames += assembler.poll(now)
    times = [f.frame.time for f in frames]
    assert times == sorted(times)
    for f in frames:
        assert f.frame.positions.shape == (3, 3)
        assert np.isfinite(f.frame.positions).all()
        np.testing.assert_allclose(np.linalg.norm(f.frame.quaternions, axis=1), 1.0)


@given(st.permutations(list(range(50))))
def test_history_is_sorted_and_bounded_in_any_order(order):
    history = TrackerHistory(capacity=8)
    for k in order:
        history.insert(float(k), np.zeros(3), np.array([1.0, 0, 0, 0]), 0.0)
    assert len(history) <= 8
    assert history.newest == 49.0


@pytest.mark.parametrize(
    "make",
    [
        lambda: AssemblerConfig(rate=0.0),
        lambda: AssemblerConfig(delay=-1.0),
        lambda: AssemblerConfig(max_extrapolation=0.1),
        lambda: FrameAssembler(()),
        lambda: FrameAssembler(("a", "a")),
    ],
)
def test_impossible_settings_are_refused(make):
    with pytest.raises(ConfigurationError):
        make()
