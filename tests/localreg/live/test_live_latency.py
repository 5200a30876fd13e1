"""The benchmark's arithmetic; running it takes minutes and is for people."""

import socket
import time

import numpy as np
import pytest

from benchmarks.live_latency import VmcReceiver, figures_of, line, memory_growth
from localreg.body.subject import canonical_subject
from localreg.live.sinks.datagrams import DatagramSink
from localreg.live.sinks.vmc import VmcEncoder
from tests.localreg.live.poses import live_pose, random_qpos

SUBJECT = canonical_subject()


def state(second: int, late: int = 0) -> dict:
    return {
        "uptime_s": 100.0 + second,
        "frames": 400 + 40 * second,
        "late_frames": 3 + late,
        "held_frames": 1,
        "dropped_samples": 2,
        "latency_p50_ms": 8.0 + second,
        "latency_p99_ms": 20.0 - second,
        "memory_mb": 500.0 + max(0, 5 - second),
    }


def test_figures_count_from_the_first_look():
    arrivals = [0.0, 0.025, 0.05, 0.1]
    figures = figures_of([state(n, late=n) for n in range(11)], arrivals, "localreg", False)
    assert (figures["frames"], figures["late_frames"]) == (400, 10)
    assert figures["late_percent"] == pytest.approx(2.5)
    assert (figures["held_frames"], figures["dropped_samples"]) == (0, 0)
    assert figures["latency_p50_ms"] == pytest.approx(13.5)
    assert figures["latency_p99_worst_ms"] == 19.0
    assert figures["gap_max_ms"] == pytest.approx(50.0)
    assert figures["memory_growth_mb_per_hour"] == pytest.approx(0.0, abs=1e-6)
    assert "2.50 % of 400 frames late, latency 13.5 ms" in line(figures)


def test_memory_that_grows_is_seen_and_warming_up_is_not():
    looks = np.arange(600)
    steady = 600.0 - 300.0 * np.exp(-looks / 20.0)
    assert abs(memory_growth(steady)) < 0.1
    assert memory_growth(steady + looks / 3600.0 * 50.0) == pytest.approx(50.0, abs=0.2)


def test_the_receiver_counts_frames_not_datagrams():
    receiver = VmcReceiver()
    sink = DatagramSink("vmc", VmcEncoder(SUBJECT), "127.0.0.1", receiver.port)
    for n in range(5):
        sink.publish(live_pose(SUBJECT, random_qpos(n), n))
    sink.close()
    give_up = time.monotonic() + 20.0
    while len(receiver.arrivals) < 5 and time.monotonic() < give_up:
        time.sleep(0.005)
    receiver.close()
    assert len(receiver.arrivals) == 5
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free_again:
        free_again.bind(("127.0.0.1", receiver.port))
