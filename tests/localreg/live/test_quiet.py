import gc
import sys

import pytest

from localreg.live.counters import RecentTimes
from localreg.live.quiet import IdleWork, undisturbed
from tests.localreg.live.scripted import Clock


def break_off() -> None:
    with undisturbed():
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
        raise ZeroDivisionError


def test_undisturbed_puts_everything_back():
    interval = sys.getswitchinterval()
    with undisturbed():
        assert sys.getswitchinterval() < interval
    with pytest.raises(ZeroDivisionError):
        break_off()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
    assert sys.getswitchinterval() == interval


def test_idle_work_does_one_chore_a_time_and_each_when_due():
    clock = Clock()
    done: list[tuple[str, float]] = []
    work = IdleWork(
        (0.25, lambda: done.append(("often", clock.now))),
        (10.0, lambda: done.append(("rare", clock.now))),
        now=clock,
    )
    for _ in range(400):
        before = len(done)
        work()
        assert len(done) <= before + 1
        clock.now += 0.01
    assert [name for name, _ in done].count("rare") == 1
    assert 14 <= [name for name, _ in done].count("often") <= 16


def test_recent_times_keep_the_newest():
    times = RecentTimes(capacity=4)
    assert str(times.percentile(50.0)) == str(times.last) == "nan"
    for n in range(10):
        times.add(float(n))
    assert sorted(times.values) == [6.0, 7.0, 8.0, 9.0]
    assert times.last == 9.0
    assert times.percentile(100.0) == 9.0
