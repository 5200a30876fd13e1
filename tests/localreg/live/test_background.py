"""Sinks in a thread of their own: the loop is never held up, and nothing is lost unsaid."""

import threading
import time

import pytest

from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.live.sinks import LivePose, Sink
from localreg.live.sinks.background import Background
from tests.localreg.live.poses import live_pose, random_qpos

SUBJECT = canonical_subject()
POSES = [live_pose(SUBJECT, random_qpos(0), n) for n in range(12)]
LONG = 20.0


class Gate(Sink):
    """Takes poses only while it is open; fails at a given one."""

    def __init__(self, is_open: bool = True, fails_at: int | None = None) -> None:
        self.name = "gate"
        self.taken: list[int] = []
        self.closed = 0
        self.entered = threading.Semaphore(0)
        self.gate = threading.Event()
        self._fails_at = fails_at
        if is_open:
            self.gate.set()

    def publish(self, live: LivePose) -> None:
        self.entered.release()
        assert self.gate.wait(LONG)
        if live.instant == self._fails_at:
            raise OSError(28, "No space left on device")
        self.taken.append(live.instant)

    def close(self) -> None:
        self.closed += 1


def test_everything_arrives_in_order():
    sink = Gate()
    background = Background(sink, 100)
    for live in POSES:
        background.publish(live)
    background.close()
    assert sink.taken == list(range(12))
    assert (sink.closed, background.dropped) == (1, 0)


def test_of_those_that_wait_the_newest_win():
    sink = Gate(is_open=False)
    background = Background(sink, 1)
    background.publish(POSES[0])
    assert sink.entered.acquire(timeout=LONG)
    for live in POSES[1:]:
        background.publish(live)
    assert background.dropped == 10
    sink.gate.set()
    background.close()
    assert sink.taken == [0, 11]


def test_a_failure_is_told_once_and_ends_the_sink():
    sink = Gate(fails_at=2)
    background = Background(sink, 100)
    for live in POSES[:3]:
        background.publish(live)
    give_up = time.monotonic() + LONG
    while background.failure is None and time.monotonic() < give_up:
        time.sleep(0.005)
    with pytest.raises(LocalregError, match="gate stopped: no space left on device; the motion"):
        background.publish(POSES[3])
    background.publish(POSES[4])
    background.close()
    assert sink.taken == [0, 1]
    assert (sink.closed, background.dropped) == (1, 2)


def test_a_failure_that_nobody_heard_of_is_told_at_the_end():
    sink = Gate(fails_at=0)
    background = Background(sink, 100)
    background.publish(POSES[0])
    with pytest.raises(LocalregError, match="gate stopped"):
        background.close()
    background.close()
