"""How a run is doing, as one JSON object a second."""

import json
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np

from localreg.errors import LocalregError
from localreg.evaluation.results import without_nan
from localreg.live.recenter import Recentering
from localreg.live.service_manager import notify
from localreg.live.session import Session
from localreg.live.sinks.base import Sink
from sensors.devices.base import Device
from sensors.recording import Recorder

SCHEMA: Final = 1
"""Version of the layout of the JSON."""

EVERY: Final = 1.0
"""How often it is looked at [s]."""

_PAGE: Final = os.sysconf("SC_PAGE_SIZE")


class Health:
    """Looks at the parts of a run; from any thread, at any time.

    Args:
        session: the loop.
        devices: the drivers.
        sinks: who gets the poses.
        recentering: how often the performer was re-centred.
        recorder: the recording, if there is one.
    """

    def __init__(
        self,
        session: Session,
        devices: Sequence[Device],
        sinks: Sequence[Sink],
        recentering: Recentering,
        recorder: Recorder | None = None,
    ) -> None:
        self._session = session
        self._devices = devices
        self._sinks = sinks
        self._recentering = recentering
        self._recorder = recorder
        self._begun = time.monotonic()

    def look(self) -> dict[str, Any]:
        """The present state, as JSON has it; what could not be had is None."""
        session, counters = self._session, self._session.counters
        latest = session.latest
        recent = counters.latency.recent(_RECENT)
        document = {
            "schema": SCHEMA,
            "turns": session.turns,
            "uptime_s": round(time.monotonic() - self._begun, 3),
            "state": self._state(),
            "frames": counters.frames,
            "published": counters.published,
            "late_frames": counters.late_frames,
            "late_percent": 100.0 * counters.late_frames / max(1, counters.frames),
            "missing_frames": counters.missing_frames,
            "passed_frames": counters.passed_frames,
            "held_frames": counters.held_frames,
            "blind_frames": counters.blind_frames,
            "failed_frames": counters.failed_frames,
            "reacquired_frames": counters.reacquired_frames,
            "starts": counters.starts,
            "dropped_samples": session.dropped_samples,
            "latency_p50_ms": 1e3 * _percentile(recent, 50.0),
            "latency_p99_ms": 1e3 * _percentile(recent, 99.0),
            "buffer_ms": 1e3 * session.buffer,
            "confidence": None if latest is None else float(latest.pose.confidence),
            "recentered": self._recentering.count,
            "memory_mb": resident_memory() / 2**20,
            "devices": [_device(device) for device in self._devices],
            "sinks": [{"name": sink.name, "dropped": sink.dropped} for sink in self._sinks],
            "sink_errors": counters.sink_errors,
            "last_sink_error": counters.last_sink_error,
            "recording": self._recording(),
        }
        return without_nan(document)

    def _state(self) -> str:
        latest = self._session.latest
        if self._session.is_stopped:
            return "stopping"
        if latest is None:
            return "waiting for trackers"
        if self._session.silent_for > _SILENT:
            return "no frames"
        return "holding" if latest.is_held else "running"

    def _recording(self) -> dict[str, Any] | None:
        recorder = self._recorder
        if recorder is None:
            return None
        return {
            "file": str(recorder.path),
            "bytes": recorder.counters.bytes,
            "messages": recorder.counters.messages,
            "lost": recorder.counters.lost,
            "error": recorder.error,
        }


_RECENT: Final = 2400
_SILENT: Final = 1.0


def _percentile(values: np.ndarray, q: float) -> float:
    return float(np.percentile(values, q)) if values.size else math.nan


def _device(device: Device) -> dict[str, Any]:
    counters = device.counters
    return {
        "name": device.name,
        "state": device.state,
        "last_error": device.last_error,
        "samples": dict(counters.samples),
        "bad_records": counters.parser.bad_records,
        "connects": counters.connects,
        "port_losses": counters.port_losses,
        "recoveries": counters.recoveries,
    }


def resident_memory() -> int:
    """Memory of this process that is really there [bytes]."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * _PAGE


class HealthReport:
    """Looks once a second in a thread of its own, says what changed, and writes it down.

    As long as the loop turns, the service manager hears so, too.

    Args:
        look: gives the present state, as `Health.look` does.
        tell: is told in one sentence when a device is lost or comes back, or an output fails.
        to: where a line of JSON goes every second: a file, which must not exist, or `-` for
            standard error; None for nowhere.

    Raises:
        LocalregError: the file cannot be made.
    """

    def __init__(
        self,
        look: Callable[[], dict[str, Any]],
        tell: Callable[[str], None],
        to: str | None = None,
    ) -> None:
        self._get = look
        self._tell = tell
        self._notices = Notices()
        self._file = _open(to)
        self._stop = threading.Event()
        self._turns = 0
        self._thread = threading.Thread(target=self._run, name="health", daemon=True)

    def __enter__(self) -> "HealthReport":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._look()
        if self._file is not None and self._file is not sys.stderr:
            self._file.close()

    def _run(self) -> None:
        while not self._stop.wait(EVERY):
            self._look()

    def _look(self) -> None:
        document = self._get()
        for notice in self._notices.of(document):
            self._tell(notice)
        if document["turns"] > self._turns:
            self._turns = document["turns"]
            notify("WATCHDOG=1")
        if self._file is None:
            return
        try:
            self._file.write(json.dumps(document, allow_nan=False) + "\n")
            self._file.flush()
        except (OSError, ValueError) as error:
            self._file = None
            self._tell(f"the health lines ended: {error}; the motion goes on")


class Notices:
    """What is worth a sentence in one look at a run's health, each thing once."""

    def __init__(self) -> None:
        self._states: dict[str, str] = {}
        self._sink_error = ""
        self._is_loss_told = False

    def of(self, document: dict[str, Any]) -> list[str]:
        """The sentences on what is new since the last look."""
        notices = []
        for device in document["devices"]:
            before = self._states.get(device["name"], "")
            now = device["last_error"]
            if now and now != before:
                notices.append(f"{device['name']}: {now}")
            elif before and not now and device["state"] == "streaming":
                notices.append(f"{device['name']} is back")
            if now or device["state"] == "streaming":
                self._states[device["name"]] = now
        if document["last_sink_error"] != self._sink_error:
            self._sink_error = document["last_sink_error"]
            notices.append(self._sink_error)
        recording = document["recording"]
        # A recording that ended early says so itself, and what it loses from then on is meant.
        if recording and recording["lost"] and not recording["error"] and not self._is_loss_told:
            self._is_loss_told = True
            notices.append(
                f"the recording {recording['file']} has lost {recording['lost']} messages, for the "
                "disk is too slow; what is lost is counted, and the motion goes on"
            )
        return notices


def _open(to: str | None) -> TextIO | None:
    if to is None:
        return None
    if to == "-":
        return sys.stderr
    try:
        return Path(to).open("x", encoding="utf-8")
    except FileExistsError:
        raise LocalregError(f"{to} exists; give --health another name") from None
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write {to}: {reason}; give --health another place") from None
