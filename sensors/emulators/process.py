"""Starts the emulator in a process of its own and listens to what it says."""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from sensors.errors import ConnectionFailedError

_STARTUP_TIMEOUT = 30.0
_EXIT_TIMEOUT = 5.0


class EmulatorProcess:
    """A running `sensors emulate`; use as a context manager.

    Args:
        playback: playback file, or None for made-up motion.
        arguments: further options of the command, for example `["--at-end", "exit"]`.

    Raises:
        ConnectionFailedError: if it did not start; the message holds its own words.
    """

    def __init__(self, playback: Path | None = None, arguments: Sequence[str] = ()) -> None:
        command = [sys.executable, "-m", "sensors", "emulate", "--control", *arguments]
        if playback is not None:
            command.append(str(playback))
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._changed = threading.Condition()
        self._events: dict[str, dict[str, object]] = {}
        self._complaints: list[str] = []
        self._threads = [
            threading.Thread(target=self._listen, daemon=True),
            threading.Thread(target=self._collect, daemon=True),
        ]
        for thread in self._threads:
            thread.start()
        if not self._wait_for("ready", _STARTUP_TIMEOUT):
            self.close()
            words = " ".join("".join(self._complaints).split()) or "it said nothing"
            raise ConnectionFailedError(f"the emulator did not start: {words}")

    @property
    def address(self) -> str:
        """What the device driver opens."""
        return str(self._events["ready"]["address"])

    @property
    def motion_zero(self) -> float | None:
        """Monotonic time of motion time zero [s], the same clock here; None before."""
        event = self._events.get("start")
        return None if event is None else float(str(event["monotonic"]))

    @property
    def summary(self) -> dict[str, object] | None:
        """The `end` event with the emulator's counters; None while it runs."""
        return self._events.get("end")

    def __enter__(self) -> "EmulatorProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait_started(self, timeout: float) -> bool:
        """Wait until the motion has started, at most `timeout` [s]."""
        return self._wait_for("start", timeout)

    def wait_ended(self, timeout: float) -> bool:
        """Wait until the emulator has ended by itself, at most `timeout` [s]."""
        return self._wait_for("end", timeout)

    def begin(self) -> None:
        """Start the motion with the next cycle (option `--start later`)."""
        self._tell("begin")

    def inject(self, fault: str) -> None:
        """Add a fault, written as on the command line; its `start` counts from now."""
        self._tell(f"fault {fault}")

    def close(self) -> None:
        """End the process. Doing so twice is no error."""
        self._tell("quit")
        try:
            self._process.wait(_EXIT_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for thread in self._threads:
            thread.join()
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None and not stream.closed:
                try:
                    stream.close()
                except BrokenPipeError:
                    continue

    def _tell(self, line: str) -> None:
        stdin = self._process.stdin
        try:
            if stdin is not None and not stdin.closed:
                stdin.write(line + "\n")
                stdin.flush()
        except (BrokenPipeError, OSError):
            return

    def _wait_for(self, event: str, timeout: float) -> bool:
        give_up = time.monotonic() + timeout
        with self._changed:
            while event not in self._events and "closed" not in self._events:
                left = give_up - time.monotonic()
                if left <= 0.0:
                    break
                self._changed.wait(left)
            return event in self._events

    def _listen(self) -> None:
        assert self._process.stdout is not None  # noqa: S101
        for line in self._process.stdout:
            try:
                event = json.loads(line)
            except json.JSONDecodeError:
                continue
            self._note(str(event.get("event", "")), event)
        self._note("closed", {})

    def _collect(self) -> None:
        assert self._process.stderr is not None  # noqa: S101
        for line in self._process.stderr:
            self._complaints = [*self._complaints[-20:], line]

    def _note(self, name: str, event: dict[str, object]) -> None:
        with self._changed:
            self._events[name] = event
            self._changed.notify_all()
