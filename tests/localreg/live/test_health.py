"""What is worth a sentence, what the service manager hears, and lines that end."""

import mmap
import socket
import threading
from pathlib import Path

import pytest

from localreg.errors import LocalregError
from localreg.live.counters import RecentTimes
from localreg.live.health import HealthReport, Notices, resident_memory
from localreg.live.service_manager import notify


def look(
    state: str = "streaming", error: str = "", sink: str = "", recording: dict | None = None
) -> dict:
    device = {"name": "is900", "state": state, "last_error": error}
    return {"devices": [device], "last_sink_error": sink, "recording": recording}


def test_a_device_that_is_lost_and_comes_back_is_told_once_each():
    notices = Notices()
    told = [
        notices.of(document)
        for document in (
            look("connecting"),
            look(),
            look("waiting", "the line is lost"),
            look("waiting", "the line is lost"),
            look("waiting", "cannot open /dev/ttyUSB0"),
            look("setting up"),
            look(),
            look(),
        )
    ]
    assert told == [
        [],
        [],
        ["is900: the line is lost"],
        [],
        ["is900: cannot open /dev/ttyUSB0"],
        [],
        ["is900 is back"],
        [],
    ]


def test_a_sink_that_fails_is_told_once():
    notices = Notices()
    assert notices.of(look(sink="take.bvh stopped")) == ["take.bvh stopped"]
    assert notices.of(look(sink="take.bvh stopped")) == []


def test_a_recording_that_loses_messages_is_told_once():
    notices = Notices()
    good = {"file": "take.mcap", "lost": 0, "error": ""}
    assert notices.of(look(recording=good)) == []
    (notice,) = notices.of(look(recording={**good, "lost": 7}))
    assert "take.mcap has lost 7 messages" in notice
    assert notices.of(look(recording={**good, "lost": 9})) == []


def test_what_a_recording_loses_after_its_end_is_no_news():
    ended = {"file": "take.mcap", "lost": 7, "error": "the disk is full"}
    assert Notices().of(look(recording=ended)) == []


def test_the_service_manager_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    address = tmp_path / "notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(address))
        manager.settimeout(20.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(address))
        notify("READY=1")
        assert manager.recv(100) == b"READY=1"
    notify("READY=1")
    monkeypatch.delenv("NOTIFY_SOCKET")
    notify("READY=1")


class Looks:
    """A health of which only the number of the loop's turns is known."""

    def __init__(self, turns: list[int]) -> None:
        self._turns = turns
        self.done = threading.Event()

    def look(self) -> dict:
        turns = self._turns.pop(0) if len(self._turns) > 1 else self._turns[0]
        if len(self._turns) == 1:
            self.done.set()
        return {**look(), "turns": turns}


def test_the_watchdog_hears_only_of_a_loop_that_turns(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    heard: list[str] = []
    monkeypatch.setattr("localreg.live.health.notify", heard.append)
    monkeypatch.setattr("localreg.live.health.EVERY", 0.001)
    health = Looks([1, 2, 2, 2, 3, 3])
    lines = tmp_path / "health.jsonl"
    with HealthReport(health.look, lambda _: None, str(lines)):
        assert health.done.wait(20.0)
    assert heard == ["WATCHDOG=1"] * 3
    assert len(lines.read_text().splitlines()) >= 6


def test_health_lines_never_overwrite(tmp_path: Path):
    lines = tmp_path / "health.jsonl"
    lines.write_text("precious")
    with pytest.raises(LocalregError, match="exists"):
        HealthReport(Looks([1]).look, lambda _: None, str(lines))


def test_memory_is_that_of_this_process():
    size = 50_000_000
    before = resident_memory()
    # Pages of its own: what the heap gives may have been there all the time.
    with mmap.mmap(-1, size) as ballast:
        ballast.write(b"x" * size)
        assert resident_memory() - before > 0.6 * size


@pytest.mark.parametrize("count", [0, 3, 5, 8, 13])
def test_the_newest_times_are_found_in_the_ring(count: int):
    times = RecentTimes(capacity=5)
    for n in range(count):
        times.add(float(n))
    assert sorted(times.recent(3)) == list(map(float, range(count)))[-3:]
