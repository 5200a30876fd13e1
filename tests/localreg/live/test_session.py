import math
import os
import signal
import threading

import numpy as np
import pytest

from localreg.errors import LocalregError
from localreg.live.session import Session, stopped_by_interrupt
from localreg.live.sinks import LivePose
from localreg.synthesis.estimator import Result
from sensors.devices.base import Device, DeviceCounters
from sensors.devices.is900 import Is900Config
from sensors.pose import PoseSample
from sensors.stream import Received
from tests.localreg.live.scripted import (
    DELAY,
    PERIOD,
    START,
    Clock,
    Inline,
    Listener,
    ScriptedEstimator,
    ScriptedStream,
    arrived,
    instant,
)

LIMIT = DELAY + PERIOD


def run(frames, *, clock=None, estimator=None, start=-math.inf, end=math.inf, **options):
    """A session over given frames; without an end it stops after the last of them."""
    clock = clock or Clock()
    frames = list(frames)
    estimator = estimator or ScriptedEstimator(clock)
    listener = Listener()
    session = Session(
        ScriptedStream(clock, frames),
        lambda _: estimator,
        [listener],
        now=clock,
        executor=Inline(),
        **options,
    )
    if math.isinf(end):
        end = frames[-1].frame.time + 1e-3
    session.run(start, end)
    return session, listener


def test_frames_reach_the_sinks_in_order():
    session, listener = run(arrived(n) for n in range(10))
    assert listener.shown == list(range(10))
    assert listener.closed == 1
    assert session.counters.frames == session.counters.published == 10
    assert session.counters.late_frames == 0
    assert session.counters.starts == 1


@pytest.mark.parametrize(
    ("reached", "late"), [(LIMIT - 1e-6, 0), (LIMIT + 1e-6, 1)], ids=["in time", "late"]
)
def test_a_frame_is_late_past_a_period_and_the_buffer_after_its_instant(reached, late):
    clock = Clock()
    lag = 0.002
    estimator = ScriptedEstimator(clock, costs={5: reached - lag})
    frames = [*(arrived(n, lag=lag) for n in range(6))]
    session, _ = run(frames, clock=clock, estimator=estimator)
    assert session.counters.late_frames == late
    assert session.counters.missing_frames == 0


def test_one_slow_frame_makes_those_late_that_wait_behind_it():
    clock = Clock()
    # Frame 2 takes four periods; each of those behind it a fifth of one.
    costs = dict.fromkeys(range(20), PERIOD / 5) | {2: 4 * PERIOD}
    session, _ = run(
        (arrived(n, lag=0.0) for n in range(20)),
        clock=clock,
        estimator=ScriptedEstimator(clock, costs=costs),
    )
    late = 0
    ready = instant(0)
    for n in range(20):
        ready = max(ready, instant(n)) + costs[n]
        late += ready > instant(n) + LIMIT
    assert 3 <= late <= 5
    assert session.counters.late_frames == late


def test_a_hiccup_is_caught_up_with_and_no_frame_is_left_out():
    clock = Clock()
    costs = dict.fromkeys(range(20), PERIOD / 5) | {2: 0.14}
    session, listener = run(
        (arrived(n, lag=0.0) for n in range(20)),
        clock=clock,
        estimator=ScriptedEstimator(clock, costs=costs),
    )
    assert listener.shown == list(range(20))
    assert session.counters.passed_frames == 0


@pytest.mark.parametrize("slowness", [1.2, 3.0, 20.0])
def test_on_a_slow_machine_the_newest_frame_wins(slowness):
    clock = Clock()
    costs = dict.fromkeys(range(400), slowness * PERIOD)
    session, listener = run(
        (arrived(n, lag=0.0) for n in range(400)),
        clock=clock,
        estimator=ScriptedEstimator(clock, costs=costs),
    )
    shown = listener.shown
    assert shown == sorted(set(shown))
    assert len(shown) == pytest.approx(400 / slowness, rel=0.1)
    counters = session.counters
    assert counters.frames == shown[-1] + 1
    assert 0 < counters.passed_frames == counters.missing_frames
    # However long it goes on, nothing gets older than this.
    oldest = 0.15 + DELAY + PERIOD + slowness * PERIOD
    assert counters.latency.percentile(100.0) < oldest


def test_latency_counts_from_the_newest_sample():
    clock = Clock()
    costs = dict.fromkeys(range(8), 0.003)
    frames = [arrived(n, lag=0.004) for n in range(8)]
    session, _ = run(frames, clock=clock, estimator=ScriptedEstimator(clock, costs=costs))
    assert session.counters.latency.percentile(50.0) == pytest.approx(0.003)
    assert session.counters.compute.percentile(99.0) == pytest.approx(0.003)


def test_instants_nobody_polled_for_are_late():
    frames = [arrived(n) for n in (0, 1, 2, 6, 7)]
    session, listener = run(frames)
    assert listener.shown == [0, 1, 2, 6, 7]
    assert session.counters.frames == 8
    assert session.counters.missing_frames == session.counters.late_frames == 3


@pytest.mark.parametrize(
    ("given", "missing"), [(range(10), 0), (range(3, 10), 3), (range(7), 3), ((), 10)]
)
def test_between_start_and_end_every_instant_counts(given, missing):
    half = 0.5 * PERIOD
    session, _ = run((arrived(n) for n in given), start=START - half, end=instant(10) - half)
    assert session.counters.frames == 10
    assert session.counters.missing_frames == session.counters.late_frames == missing


def test_frames_before_the_start_are_passed_over():
    frames = [arrived(n) for n in range(12)]
    session, listener = run(frames, start=instant(4) - 0.5 * PERIOD)
    assert listener.shown == list(range(4, 12))
    assert session.counters.frames == 8


def test_the_end_ends_the_run_though_frames_go_on():
    session, listener = run((arrived(n) for n in range(12)), end=instant(5) - 0.5 * PERIOD)
    assert listener.shown == list(range(5))
    assert session.counters.late_frames == 0


def test_a_frame_without_any_pose_yet_counts_as_never_come():
    session, listener = run([arrived(0, seen=0), arrived(1, seen=2), arrived(2), arrived(3)])
    assert listener.shown == [2, 3]
    assert session.counters.frames == 4
    assert session.counters.missing_frames == session.counters.late_frames == 2


def test_dropped_samples_are_those_of_this_run():
    class Line(Device):
        trackers = ("head",)
        counters = DeviceCounters()

        def start(self) -> None: ...

        def stop(self) -> None: ...

        def wait_attempt(self, timeout: float) -> bool:
            return True

    clock = Clock()
    device = Line(Is900Config(port="nowhere", stations={"head": 1}))
    device.counters.parser.bad_records = 7
    stream = ScriptedStream(clock, [arrived(0), arrived(1), arrived(2)])

    def disturb(live: LivePose) -> None:
        device.counters.parser.bad_records += 2
        stream.assembler.push(PoseSample("tail", START, np.zeros(3), np.zeros(4)))

    estimator = ScriptedEstimator(clock)
    session = Session(
        stream,
        lambda _: estimator,
        [Listener(disturb)],
        devices=[device],
        now=clock,
        executor=Inline(),
    )
    sample = PoseSample("head", START, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    stream.samples.put([Received(sample, START)] * 1024)
    session.run(end=instant(3))
    assert session.dropped_samples == 9
    stream.samples.put([Received(sample, START)] * 5)
    assert session.dropped_samples == 14


@pytest.mark.parametrize("error", [OSError("gone"), LocalregError("full")])
def test_a_sink_that_fails_stops_nobody(error):
    def fail(live: LivePose) -> None:
        raise error

    clock = Clock()
    broken, sound = Listener(fail), Listener()
    estimator = ScriptedEstimator(clock)
    stream = ScriptedStream(clock, (arrived(n) for n in range(4)))
    session = Session(stream, lambda _: estimator, [broken, sound], now=clock, executor=Inline())
    session.run(end=instant(4))
    assert sound.shown == [0, 1, 2, 3]
    assert session.counters.sink_errors == 4
    assert session.counters.last_sink_error == str(error)


def test_sinks_are_closed_though_the_loop_breaks():
    def defect(live: LivePose) -> None:
        raise RuntimeError("a defect")

    clock = Clock()
    broken, sound = Listener(defect), Listener()
    estimator = ScriptedEstimator(clock)
    stream = ScriptedStream(clock, (arrived(n) for n in range(4)))
    session = Session(stream, lambda _: estimator, [broken, sound], now=clock, executor=Inline())
    with pytest.raises(RuntimeError):
        session.run(end=instant(4))
    assert (broken.closed, sound.closed) == (1, 1)


def test_interrupt_ends_the_run_after_the_frame_in_hand():
    clock = Clock()

    def interrupt(live: LivePose) -> None:
        if live.instant == 3:
            os.kill(os.getpid(), signal.SIGINT)

    listener = Listener(interrupt)
    estimator = ScriptedEstimator(clock)
    stream = ScriptedStream(clock, (arrived(n) for n in range(9)))
    session = Session(stream, lambda _: estimator, [listener], now=clock, executor=Inline())
    before = signal.getsignal(signal.SIGINT)
    with stopped_by_interrupt(session):
        session.run(end=instant(9))
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    assert listener.shown == [0, 1, 2, 3]
    assert listener.closed == 1
    # Nobody waited for the rest, so it is not late.
    assert (session.counters.frames, session.counters.late_frames) == (4, 0)


def test_a_session_may_run_in_any_thread():
    clock = Clock()
    listener = Listener()
    estimator = ScriptedEstimator(clock)
    session = Session(
        ScriptedStream(clock, (arrived(n) for n in range(3))),
        lambda _: estimator,
        [listener],
        now=clock,
        executor=Inline(),
    )

    def serve() -> None:
        with stopped_by_interrupt(session):
            session.run()

    thread = threading.Thread(target=serve)
    thread.start()
    session.stop()
    thread.join(10.0)
    assert not thread.is_alive()
    assert listener.closed == 1


def test_idle_work_is_left_when_frames_wait():
    clock = Clock()
    called: list[float] = []
    estimator = ScriptedEstimator(clock)
    stream = ScriptedStream(clock, [arrived(n) for n in range(3)])
    # The assembler's grid says when the next instant is: first far off, then past.
    quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    stream.assembler.push(PoseSample("head", START + 1.0, np.zeros(3), quaternion), START + 1.0)
    session = Session(
        stream, lambda _: estimator, on_idle=lambda: called.append(clock.now), now=clock
    )
    session.run(end=instant(3))
    assert len(called) == 3
    clock.now = START + 2.0
    behind = Session(
        stream, lambda _: estimator, on_idle=lambda: called.append(clock.now), now=clock
    )
    stream._frames = [arrived(n) for n in range(3)]
    behind.run(end=instant(3))
    assert len(called) == 3


def test_failures_are_counted_and_the_pose_marked():
    estimator = ScriptedEstimator(results={2: Result.FAILED})
    session, listener = run((arrived(n) for n in range(4)), estimator=estimator)
    assert listener.shown == [0, 1, 1, 3]
    assert listener.held == [False, False, True, False]
    assert session.counters.failed_frames == session.counters.held_frames == 1
    assert session.counters.late_frames == 0
    held = listener.heard[2].pose
    assert held.result == Result.FAILED
    assert held.time == instant(2)
    assert np.isnan(held.position_residuals).all()
