"""`localreg run` as a child process, and what listens to it."""

import contextlib
import http.client
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle

from localreg.evaluation.body_points import BodyPoints
from localreg.motion.formats.sample import read_sample
from sensors.emulators.source import Playback

PATIENCE = 300.0  # the first program on a machine compiles for a minute of its own
RUN = (sys.executable, "-m", "localreg", "run", "--config")


def eventually(condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Wait until a condition is true, and return what it was."""
    give_up = time.monotonic() + patience
    while not (value := condition()):
        if time.monotonic() > give_up:
            pytest.fail(f"not within {patience} s: {what}")
        time.sleep(0.02)
    return value


def walk_playback() -> Playback:
    """The trackers of the longest sample walk."""
    pytest.importorskip("envpool_assets")
    walk = max(read_sample(), key=len)
    poses = BodyPoints(walk.subject).tracker_poses(walk.qpos)
    times = [n / walk.rate for n in range(len(walk))]
    return Playback(np.array(times), poses.positions, poses.quaternions, walk.subject.trackers)


class Daemon:
    """A running `localreg run`.

    Args:
        config: its configuration.
        arguments: further arguments.
    """

    def __init__(self, config: Path, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [*RUN, str(config), "--status-port", "0", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said: list[str] = []
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        line = eventually(
            lambda: next((w for w in self.said if "status: http" in w), "") or self.has_ended,
            "the status page's address",
        )
        assert not self.has_ended, self.said
        self.status_port = int(str(line).rstrip("/\n").rpartition(":")[2])

    @property
    def has_ended(self) -> bool:
        return self.process.poll() is not None

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line)

    def heard(self, words: str) -> int:
        """How often something was said; lines may have been wrapped nowhere."""
        return sum(words in line for line in self.said)

    def request(self, method: str, path: str) -> tuple[int, dict[str, Any]]:
        """Ask the status page; while the program warms up nobody answers."""
        connection = http.client.HTTPConnection("127.0.0.1", self.status_port, timeout=PATIENCE)
        with contextlib.closing(connection):
            connection.request(method, path)
            response = connection.getresponse()
            return response.status, json.loads(response.read())

    def state(self) -> dict[str, Any]:
        """The present state."""
        try:
            return self.request("GET", "/")[1]
        except ConnectionError:
            self._listener.join(PATIENCE)
            pytest.fail("the daemon ended: " + "".join(self.said))

    def until(self, condition: Callable[[dict[str, Any]], Any], what: str) -> dict[str, Any]:
        """The first state that fulfils a condition."""

        def fulfilled() -> dict[str, Any] | None:
            state = self.state()
            return state if condition(state) else None

        return eventually(fulfilled, what)

    def runs_on(self, frames: int = 10) -> dict[str, Any]:
        """Wait until so many more frames have been solved."""
        before = solved(self.state())
        return self.until(lambda s: solved(s) >= before + frames, "frames")

    def stop(self, number: int = signal.SIGTERM) -> int:
        """End it by a signal; returns its exit code."""
        self.process.send_signal(number)
        try:
            code = self.process.wait(PATIENCE)
        finally:
            self.process.kill()
        self._listener.join(PATIENCE)
        return code


@contextlib.contextmanager
def daemon(config: Path, *arguments: str) -> Iterator[Daemon]:
    """A daemon that does not outlive its test."""
    running = Daemon(config, *arguments)
    try:
        yield running
    finally:
        if not running.has_ended:
            running.process.kill()
        running.process.wait(PATIENCE)
        running._listener.join(PATIENCE)
        for stream in (running.process.stdout, running.process.stderr):
            assert stream is not None
            stream.close()


def solved(state: dict[str, Any]) -> int:
    """Frames with a new pose."""
    return state["published"] - state["held_frames"]


class Ear:
    """A UDP socket on the loopback that keeps the newest datagrams."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(PATIENCE)
        self.port = self._socket.getsockname()[1]

    def hear(self) -> bytes:
        return self._socket.recv(65536)

    def deafen(self) -> None:
        """Forget what has come so far."""
        self._socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                self._socket.recv(65536)
        self._socket.settimeout(PATIENCE)

    def close(self) -> None:
        self._socket.close()


def vmc_bones(ear: Ear) -> dict[str, list[float]]:
    """The bones of one whole VMC frame."""
    bones: dict[str, list[float]] = {}
    is_begun = False
    while len(bones) < 22:
        for message in OscBundle(ear.hear()):
            is_begun |= message.address == "/VMC/Ext/OK"
            if is_begun and message.address == "/VMC/Ext/Bone/Pos":
                name, *numbers = message.params
                bones[name] = numbers
    return bones


def listening_sockets(pid: int) -> dict[str, set[str]]:
    """Local addresses of a process's listening TCP and bound UDP sockets, by protocol."""
    inodes = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            target = str(fd.readlink())
            if target.startswith("socket:["):
                inodes.add(target[8:-1])
    found: dict[str, set[str]] = {}
    for protocol, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        lines = Path(f"/proc/{pid}/net/{protocol}").read_text().splitlines()[1:]
        rows = [line.split() for line in lines]
        found[protocol] = {r[1] for r in rows if r[9] in inodes and r[3] == state}
    return found
