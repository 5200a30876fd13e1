"""`localreg run` as performers run it: a child process, a pseudo terminal, real sockets."""

import contextlib
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from localreg.body.skeleton import BODY_NAMES
from localreg.live.take import Take
from localreg.live.unity import HUMAN_BONES, HUMAN_PARENTS
from localreg.motion.formats import read_motion
from sensors import rotation
from sensors.devices.registry import open_device
from sensors.devices.vrpn import VrpnConfig
from sensors.emulators.endpoints import PtyEndpoint
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.is900_udp import Is900UdpEmulator
from sensors.emulators.osc import OscEmulator
from sensors.emulators.process import EmulatorProcess
from sensors.emulators.source import PoseSource
from sensors.emulators.vrpn import VrpnEmulator
from sensors.stream import SampleQueue
from tests.localreg.live.daemons import (
    RUN,
    Daemon,
    Ear,
    daemon,
    eventually,
    listening_sockets,
    vmc_bones,
    walk_playback,
)

CONFIG = """
[[devices]]
driver = "is900"
port = "{port}"
pause = 0.05
max_pause = 0.2
max_reset_pause = 0.2
silence_timeout = 1.0
stations = {{ {stations} }}

[[outputs]]
protocol = "vmc"
port = {vmc}

[[outputs]]
protocol = "json"
port = {json}

[[outputs]]
protocol = "vrpn"
port = 0
"""

OTHER_DEVICES = """
[[devices]]
driver = "vrpn"
server = "{vrpn}"
stations = {{ lhand = "Tracker0:0", rhand = "Tracker0:1" }}

[[devices]]
driver = "is900-udp"
port = {udp}
stations = {{ lankle = 1 }}

[[devices]]
driver = "osc"
port = {osc}
stations = {{ rankle = "station1" }}
"""


class Stage:
    """An emulated IS-900, ears, and the configuration that joins them."""

    def __init__(self, folder: Path, stations: str) -> None:
        self.link = folder / "is900"
        self.take, self.dance = folder / "take.mcap", folder / "dance.bvh"
        self.vmc, self.json = Ear(), Ear()
        self.config = folder / "stage.toml"
        self.config.write_text(
            CONFIG.format(port=self.link, vmc=self.vmc.port, json=self.json.port, stations=stations)
        )

    @property
    def recording(self) -> tuple[str, ...]:
        return ("--record", str(self.take), "--record", str(self.dance))

    def close(self) -> None:
        self.vmc.close()
        self.json.close()


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    stations = "head = 1, torso = 2, lhand = 3, rhand = 4, lankle = 5, rankle = 6"
    with contextlib.closing(Stage(tmp_path_factory.mktemp("stage"), stations)) as stage:
        yield stage


@pytest.fixture(scope="module")
def performer(stage: Stage) -> Iterator[Daemon]:
    """A recording daemon that has found its body; at the end it is asked to terminate."""
    walk = stage.link.with_name("walk.npz")
    walk_playback().save(walk)
    line = EmulatorProcess(walk, ["--at-end", "loop", "--link", str(stage.link)])
    with line, daemon(stage.config, *stage.recording) as running:
        running.runs_on(5)
        yield running
        assert running.stop() == 0
        assert running.heard("Traceback") == 0


def test_poses_reach_avatar_programs_by_vmc(stage: Stage, performer: Daemon):
    stage.vmc.deafen()
    bones = vmc_bones(stage.vmc)
    assert set(bones) == set(HUMAN_BONES)
    turns = np.array([bones[name][3:] for name in bones])
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0, atol=1e-5)
    # Somebody walks upright: the head above the hips, the hips above the feet.
    places: dict[str, np.ndarray] = {}
    spins: dict[str, np.ndarray] = {}
    for name in HUMAN_BONES:
        p, (x, y, z, w) = np.array(bones[name][:3]), bones[name][3:]
        q, parent = np.array([w, x, y, z]), HUMAN_PARENTS.get(name)
        places[name] = p if parent is None else places[parent] + rotation.rotate(spins[parent], p)
        spins[name] = q if parent is None else rotation.multiply(spins[parent], q)
    assert places["Head"][1] > places["Hips"][1] + 0.4
    assert places["Hips"][1] > places["LeftFoot"][1] + 0.5


def test_poses_reach_small_programs_by_json(stage: Stage, performer: Daemon):
    stage.json.deafen()
    first, second = (json.loads(stage.json.hear()) for _ in range(2))
    assert second["instant"] > first["instant"]
    assert set(first["bones"]) == set(BODY_NAMES)


@pytest.mark.skipif(shutil.which("oscdump") is None, reason="needs oscdump (liblo-tools)")
def test_another_osc_library_understands_the_bundles(stage: Stage, performer: Daemon):
    """liblo's oscdump, on datagrams that the daemon sent."""
    stage.vmc.deafen()
    datagrams = [stage.vmc.hear() for _ in range(20)]
    with contextlib.closing(Ear()) as spare:
        port = spare.port
    with subprocess.Popen(["oscdump", "-L", str(port)], stdout=subprocess.PIPE, text=True) as dump:
        assert dump.stdout is not None
        lines: list[str] = []

        def is_understood() -> bool:
            for datagram in datagrams:
                spare_socket.sendto(datagram, ("127.0.0.1", port))
            lines.append(dump.stdout.readline())  # type: ignore[union-attr]
            return len(lines) > 60

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as spare_socket:
            eventually(lambda: port_is_bound(port), "oscdump listening")
            eventually(is_understood, "lines of oscdump")
        dump.kill()
    text = "".join(lines)
    assert '/VMC/Ext/Bone/Pos sfffffff "' in text
    assert "/VMC/Ext/OK i 1" in text


def port_is_bound(port: int) -> bool:
    return f":{port:04X} " in Path("/proc/net/udp").read_text()


def test_nothing_listens_beyond_the_loopback(performer: Daemon):
    sockets = listening_sockets(performer.process.pid)
    listening = {address for address in sockets["tcp"] if not address.startswith("0100007F:")}
    assert listening == set()
    assert f"0100007F:{performer.status_port:04X}" in sockets["tcp"]
    assert sockets["tcp6"] == sockets["udp6"] == set()
    # Senders are bound by their first datagram, to a port that nobody is told: one for VMC,
    # one for JSON. The third is the VRPN server's.
    senders = {address for address in sockets["udp"] if not address.startswith("0100007F:")}
    assert len(senders) == 2 == len(sockets["udp"]) - 1


def test_the_state_tells_what_goes_on(performer: Daemon):
    state = performer.runs_on(2)
    assert state["schema"] == 1
    assert state["state"] == "running"
    assert state["devices"][0]["state"] == "streaming"
    assert all(n > 0 for n in state["devices"][0]["samples"].values())
    assert 0.0 < state["latency_p50_ms"] <= state["latency_p99_ms"]
    assert state["memory_mb"] > 50.0
    assert [sink["dropped"] for sink in state["sinks"][:2]] == [0, 0]
    assert state["recording"]["bytes"] > 0


@pytest.mark.parametrize("way", ["status page", "signal"])
def test_the_performer_is_recentered(way: str, stage: Stage, performer: Daemon):
    before = performer.state()["recentered"]
    if way == "signal":
        performer.process.send_signal(signal.SIGUSR1)
    else:
        assert performer.request("POST", "/recenter")[0] == 202
    performer.until(lambda s: s["recentered"] == before + 1, "the performer re-centred")
    stage.json.deafen()
    x, y, *_ = json.loads(stage.json.hear())["bones"]["root"]
    assert np.hypot(x, y) < 3.0


def test_a_second_daemon_that_wants_the_same_port_says_so(stage: Stage, performer: Daemon):
    second = subprocess.run(
        [*RUN, str(stage.config), "--status-port", str(performer.status_port)],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert second.returncode == 1
    assert f"cannot listen on 127.0.0.1:{performer.status_port}" in second.stderr
    assert "Traceback" not in second.stderr


def test_poses_reach_vrpn_clients(performer: Daemon):
    name = next(s["name"] for s in performer.state()["sinks"] if s["name"].startswith("vrpn"))
    server = name.partition("@")[2]
    stations = {bone: f"Body0:{n}" for n, bone in enumerate(BODY_NAMES)}
    samples = SampleQueue()
    with open_device(VrpnConfig(server=server, stations=stations), samples):
        received: dict[str, np.ndarray] = {}

        def is_whole() -> bool:
            received.update({r.sample.tracker: r.sample.position for r in samples.drain(0.1)})
            return set(received) == set(BODY_NAMES)

        eventually(is_whole, "every bone")
    assert received["head"][2] > received["root"][2] + 0.3 > received["lfoot"][2] + 0.8


def test_a_full_disk_ends_the_recording_only(stage: Stage, performer: Daemon):
    performer.runs_on(20)
    # No file of the daemon's may grow any more.
    full = min(stage.take.stat().st_size, stage.dance.stat().st_size)
    resource.prlimit(performer.process.pid, resource.RLIMIT_FSIZE, (full, full))
    state = performer.until(
        lambda s: s["recording"]["error"] and s["last_sink_error"], "the full disk"
    )
    assert "dance.bvh stopped: file too large; the motion goes on" in state["last_sink_error"]
    state = performer.runs_on(40)
    assert state["sink_errors"] == 1
    eventually(lambda: performer.heard("dance.bvh stopped"), "a sentence on the motion file")
    assert performer.heard("dance.bvh stopped") == 1
    assert performer.heard("take.mcap ended early") == 1
    assert Take.read(stage.take).frames > 10
    (motion,) = read_motion(stage.dance)
    assert len(motion) > 10


def test_four_kinds_of_devices_a_pulled_plug_and_a_kill(performer: Daemon, tmp_path: Path):
    """What was recorded until then is good, and is repeated to the last bit.

    Meanwhile another daemon runs on the same machine, and neither minds the other.
    """
    walk = walk_playback()
    zero = time.monotonic()

    def columns(*names: str) -> PoseSource:
        """All emulators play the same instant, whenever they were started."""
        indices = [walk.names.index(name) for name in names]
        return lambda _: [
            walk.pose_at((time.monotonic() - zero) % walk.duration)[i] for i in indices
        ]

    def plug() -> Is900Emulator:
        return Is900Emulator(
            columns("head", "torso"), stations=2, endpoint=PtyEndpoint(stage.link), start="now"
        )

    stage = Stage(tmp_path, "head = 1, torso = 2")
    udp, osc = free_udp_port(), free_udp_port()
    with (
        contextlib.closing(stage),
        VrpnEmulator(columns("lhand", "rhand"), port=0) as hands,
        Is900UdpEmulator(columns("lankle"), port=udp),
        OscEmulator(columns("rankle"), port=osc),
    ):
        others = OTHER_DEVICES.format(vrpn=hands.address, udp=udp, osc=osc)
        stage.config.write_text(stage.config.read_text() + others)
        with daemon(stage.config, *stage.recording) as running:
            # Head and torso are not there yet.
            running.until(lambda s: s["devices"][0]["last_error"], "the missing port")
            with plug():
                state = running.runs_on(20)
                assert all(all(d["samples"].values()) for d in state["devices"])
            running.until(lambda s: s["devices"][0]["state"] != "streaming", "the lost port")
            eventually(lambda: running.heard("is900: "), "a sentence on the lost port")
            with plug():
                state = running.runs_on(40)
                eventually(lambda: running.heard("is900 is back"), "a sentence on its return")
                os.kill(running.process.pid, signal.SIGKILL)
                running.process.wait()
    performer.runs_on(5)
    kept = Take.read(stage.take)
    assert len(kept.indices) > state["published"] - 40
    (motion,) = read_motion(stage.dance)
    assert len(motion) > state["published"] - 10
    again = tmp_path / "again.bvh"
    command = [sys.executable, "-m", "localreg", "synthesize", str(stage.take), "--out", str(again)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    assert "bit for bit those seen live" in result.stdout
    (repeated,) = read_motion(again)
    common = min(len(repeated), len(motion))
    np.testing.assert_allclose(repeated.qpos[:common], motion.qpos[:common], atol=1e-5)


def free_udp_port() -> int:
    with contextlib.closing(Ear()) as ear:
        return ear.port
