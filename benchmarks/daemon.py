"""`localreg run` in a process of its own, and what its status page says."""

import contextlib
import http.client
import json
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_STARTUP = 300.0


@dataclass(frozen=True)
class RunningDaemon:
    """A daemon that has begun.

    Attributes:
        process: its process.
        port: of its status page on the loopback.
    """

    process: subprocess.Popen[str]
    port: int

    def state(self) -> dict[str, Any]:
        """What the status page says now."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=_STARTUP)
        with contextlib.closing(connection):
            connection.request("GET", "/")
            return json.loads(connection.getresponse().read())

    def until_published(self, frames: int) -> dict[str, Any]:
        """Wait until so many frames have been published; returns the state then.

        Raises:
            RuntimeError: it took too long.
        """
        give_up = time.monotonic() + _STARTUP
        # Nobody answers until it is warm.
        while (state := self.state())["published"] < frames:
            if time.monotonic() > give_up:
                raise RuntimeError("the daemon publishes nothing; see localreg doctor")
            time.sleep(0.01)
        return state


@contextlib.contextmanager
def running_daemon(config: Path, arguments: Sequence[str] = ()) -> Iterator[RunningDaemon]:
    """A daemon with this configuration, ended when done.

    Raises:
        RuntimeError: it did not start.
    """
    command = [sys.executable, "-m", "localreg", "run", "--config", str(config)]
    with subprocess.Popen(
        [*command, "--status-port", "0", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stderr is not None  # noqa: S101
            line = process.stderr.readline()
            match = re.search(r"127\.0\.0\.1:(\d+)", line)
            if match is None:
                raise RuntimeError(f"the daemon did not start: {line.strip()}")
            threading.Thread(target=process.stderr.read, daemon=True).start()
            yield RunningDaemon(process, int(match[1]))
        finally:
            process.terminate()
