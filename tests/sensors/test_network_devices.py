"""UDP, VRPN and OSC: emulator, real socket, driver and frames together."""

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from sensors import rotation
from sensors.config import SensorsConfig
from sensors.devices.osc import OscConfig, OscDevice
from sensors.devices.udp_device import UdpDevice
from sensors.devices.udp_link import UdpLink
from sensors.devices.vrpn import VrpnConfig, VrpnDevice
from sensors.emulators.beat import BeatEmulator
from sensors.emulators.faults import Corruption, Junk, Silence, Stall
from sensors.emulators.is900_udp import Is900UdpEmulator
from sensors.emulators.osc import OscEmulator
from sensors.emulators.source import StationPose, wandering
from sensors.emulators.vrpn import VrpnEmulator
from sensors.protocols import vrpn
from sensors.tracker_input import TrackerInput
from tests.sensors.patience import PATIENCE, eventually

NAMES = ("head", "torso", "lhand", "rhand", "lankle", "rankle")
MOTION = wandering(6)
Running = tuple[BeatEmulator, TrackerInput]


def settings(device: dict[str, object]) -> SensorsConfig:
    return SensorsConfig.parse({"devices": [device], "assembler": {"delay": 1.0}})


def listening(
    driver: str, stations: dict[str, object], send: Callable[[int], BeatEmulator]
) -> Iterator[Running]:
    """A receiver on a free port, and an emulator that sends there."""
    config = settings({"driver": driver, "port": 0, "stations": stations})
    with TrackerInput(config) as trackers:
        (device,) = trackers.devices
        assert device.wait_attempt(PATIENCE), device.last_error
        assert isinstance(device, UdpDevice)
        with send(device.port) as emulator:
            yield emulator, trackers


@contextmanager
def running(kind: str, **options: object) -> Iterator[Running]:
    numbers = {name: n for n, name in enumerate(NAMES, start=1)}
    if kind == "is900-udp":
        yield from listening(
            "is900-udp", numbers, lambda port: Is900UdpEmulator(MOTION, port=port, **options)
        )
    elif kind == "vmc":
        names = {name: f"station{n}" for name, n in numbers.items()}
        yield from listening("osc", names, lambda port: OscEmulator(MOTION, port=port, **options))
    elif kind == "vrchat":
        yield from listening(
            "osc",
            {name: numbers[name] for name in NAMES[:2]},
            # Twelve datagrams a cycle are much for a machine that checks every call.
            lambda port: OscEmulator(
                lambda t: MOTION(t)[:2], port=port, dialect="vrchat", **options
            ),
        )
    else:
        with VrpnEmulator(MOTION, port=0, **options) as emulator:
            sensors = {name: f"Tracker0:{n - 1}" for name, n in numbers.items()}
            config = settings(
                {
                    "driver": "vrpn",
                    "server": emulator.address,
                    "stations": sensors,
                    "udp": kind == "vrpn-udp",
                }
            )
            with TrackerInput(config) as trackers:
                yield emulator, trackers


KINDS = ["is900-udp", "vrpn-tcp", "vrpn-udp", "vmc", "vrchat"]


@pytest.mark.parametrize("kind", KINDS)
def test_from_emulator_to_frames(kind):
    with running(kind) as (emulator, trackers):
        assert emulator.wait_started(PATIENCE)
        zero, complete = emulator.motion_zero, 0
        errors, angles = [], []
        assert zero is not None
        give_up = time.monotonic() + PATIENCE
        while complete < 20 and time.monotonic() < give_up:
            assembled = trackers.stream.next(PATIENCE)
            assert assembled is not None
            frame = assembled.frame
            if not frame.position_mask.all():
                continue
            complete += 1
            truth = MOTION(frame.time - zero)[: len(trackers.trackers)]
            positions = np.array([p for p, _ in truth])
            quaternions = np.array([q for _, q in truth])
            errors.append(float(np.abs(frame.positions - positions).max()))
            angles.append(float(rotation.angle_between(frame.quaternions, quaternions).max()))
        assert complete >= 20, trackers.assembler.counters
        # 0.8 m/s: a busy machine may delay the whole stream by several milliseconds; and what
        # has no time stamps is as late as its sender's thread.
        assert np.median(errors) < (0.2 if kind == "vrchat" else 0.03)
        assert np.median(angles) < (0.4 if kind == "vrchat" else 0.06)
        (device,) = trackers.devices
        assert device.counters.parser.bad_records == 0
        assert device.counters.unmapped == 0


@pytest.mark.parametrize("kind", ["is900-udp", "vrpn-udp", "vmc"])
def test_damaged_datagrams_cost_records_not_the_stream(kind):
    faults = [Junk(probability=0.3), Corruption(probability=0.3)]
    with running(kind, faults=faults, seed=3, rate=100.0) as (_, trackers):
        (device,) = trackers.devices
        eventually(lambda: min(device.counters.samples.values()) > 30, "samples")
        assert device.counters.foreign + device.counters.parser.bad_records > 5
        assert device.counters.port_losses == device.counters.failures == 0


def test_a_sender_that_pauses_is_noticed_and_heard_again():
    with running("is900-udp", rate=100.0) as (emulator, trackers):
        (device,) = trackers.devices
        eventually(lambda: device.state == "streaming", "stream")
        now = emulator.motion_time(time.monotonic())
        emulator.faults.inject(Silence(start=now, duration=3.0))
        eventually(lambda: device.state == "silent", "silence noticed")
        assert "nothing heard" in device.last_error
        eventually(lambda: device.state == "streaming", "stream again")


def test_a_stall_keeps_the_capture_times():
    stall = Stall(start=1.0, duration=0.3)
    with running("is900-udp", faults=[stall], rate=100.0) as (emulator, trackers):
        zero = None
        delays = []
        give_up = time.monotonic() + PATIENCE
        while time.monotonic() < give_up and len(delays) < 900:
            for sample, arrival in trackers.samples.drain(0.1):
                delays.append(arrival - sample.time)
                zero = emulator.motion_zero
                assert zero is not None
                truth = MOTION(sample.time - zero)[NAMES.index(sample.tracker)][0]
                assert np.abs(sample.position - truth).max() < 0.1
        assert max(delays) > 0.2


def test_a_taken_port_is_named():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        with OscDevice(OscConfig(port=port, stations={"head": 1})) as device:
            assert not device.wait_attempt(PATIENCE)
            assert f"UDP port {port} of 127.0.0.1" in device.last_error
            assert "choose another port" in device.last_error


def test_two_receivers_do_not_share_a_port_silently():
    with OscDevice(OscConfig(port=0)) as first:
        assert first.wait_attempt(PATIENCE)
        with OscDevice(OscConfig(port=first.port)) as second:
            assert not second.wait_attempt(PATIENCE)
            assert "close the other program" in second.last_error


def test_receivers_listen_on_this_machine_only():
    with OscDevice(OscConfig(port=0)) as device:
        assert device.wait_attempt(PATIENCE)
        with open("/proc/net/udp") as table:  # noqa: PTH123
            bound = [line.split()[1] for line in table if f":{device.port:04X}" in line]
    assert bound == [f"0100007F:{device.port:04X}"]


def test_other_senders_are_counted_not_believed():
    config = OscConfig(port=0, sender="127.0.0.2", stations={"head": 1})
    with OscDevice(config) as device:
        assert device.wait_attempt(PATIENCE)
        with OscEmulator(MOTION, port=device.port, dialect="vrchat"):
            eventually(lambda: device.counters.foreign > 10, "foreign datagrams")
        assert device.counters.samples == {"head": 0}


def test_without_stations_every_station_is_a_tracker():
    with OscDevice(OscConfig(port=0)) as device:
        assert device.wait_attempt(PATIENCE)
        with OscEmulator(MOTION, port=device.port):
            eventually(lambda: len(device.counters.samples) == 6, "all stations found")
    assert sorted(device.counters.samples) == [f"station{n}" for n in range(1, 7)]


def test_a_vrpn_server_that_goes_away_and_comes_back():
    first = VrpnEmulator(MOTION, port=0, rate=100.0)
    first.start()
    config = VrpnConfig(server=first.address, stations={"head": "Tracker0"}, pause=0.05)
    with VrpnDevice(config) as device:
        eventually(lambda: device.counters.samples["head"] > 10, "first samples")
        first.stop()
        eventually(lambda: device.counters.port_losses == 1, "loss noticed")
        with VrpnEmulator(MOTION, port=first.port, rate=100.0):
            before = device.counters.samples["head"]
            eventually(lambda: device.counters.samples["head"] > before + 10, "samples again")


def test_a_server_that_speaks_something_else_is_named():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with VrpnDevice(VrpnConfig(server=f"127.0.0.1:{port}")) as device:
            client, _ = server.accept()
            with client:
                client.sendall(b"SSH-2.0-OpenSSH_9.2p1 Debian-2\r\n")
                eventually(lambda: device.counters.failures > 0, "nonsense noticed")
                assert "does not speak VRPN" in device.last_error


def test_a_missing_server_is_named():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with VrpnDevice(VrpnConfig(server=f"127.0.0.1:{port}")) as device:
        assert not device.wait_attempt(PATIENCE)
        assert f"127.0.0.1:{port}" in device.last_error


def read_messages(tcp: socket.socket, reader: vrpn.MessageReader, count: int) -> list[vrpn.Message]:
    messages: list[vrpn.Message] = []
    while len(messages) < count:
        data = tcp.recv(4096)
        assert data
        messages += reader.feed(data)
    return messages


def test_a_scripted_standard_client_reads_the_vrpn_server():
    """What a client of the reference implementation sends, byte for byte."""
    with VrpnEmulator(MOTION, port=0) as server:  # noqa: SIM117 - the port must be known
        with socket.create_connection(("127.0.0.1", server.port), PATIENCE) as tcp:
            tcp.sendall(b"vrpn: ver. 07.35  0\0\0\0\0\0")
            cookie = tcp.recv(24, socket.MSG_WAITALL)
            assert cookie == b"vrpn: ver. 07.38  0\0\0\0\0\0"
            header = bytes.fromhex("00000025 00000000 00000000 00000003 ffffffff 00000000")
            tcp.sendall(header + b"\0\0\0\x09Tracker0\0" + b"\0\0\0")
            name = b"vrpn_Base ping_message\0"
            header = bytes.fromhex("00000033 00000000 00000000 00000005 fffffffe 00000000")
            tcp.sendall(header + b"\0\0\0\x17" + name + b"\0\0\0\0\0")
            tcp.sendall(bytes.fromhex("00000018 00000001 00000002 00000003 00000005 00000000"))
            messages = read_messages(tcp, vrpn.MessageReader(False), 60)
    names = vrpn.NameTable()
    poses = [m for m in messages if not names.learn(m) and names.types[m.kind] == vrpn.POSE]
    pongs = [m for m in messages if m.kind >= 0 and names.types[m.kind] == vrpn.PONG]
    assert names.senders == {0: "VRPN Control", 1: "Tracker0"}
    assert [names.senders[m.sender] for m in pongs] == ["Tracker0"]
    assert {vrpn.decode_pose(m.payload).sensor for m in poses} == set(range(6))
    assert all(abs(m.time - time.time()) < 3600.0 for m in poses)


def test_a_classic_client_is_called_back():
    with (
        VrpnEmulator(MOTION, port=0) as server,
        socket.create_server(("127.0.0.1", 0)) as listener,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
    ):
        listener.settimeout(PATIENCE)
        request = vrpn.connection_request("127.0.0.1", listener.getsockname()[1])
        udp.sendto(request, ("127.0.0.1", server.port))
        tcp, _ = listener.accept()
        with tcp:
            tcp.settimeout(PATIENCE)
            tcp.sendall(vrpn.COOKIE)
            messages = read_messages(tcp, vrpn.MessageReader(True), 10)
    assert [m.kind for m in messages[:5]] == [-1, -1, -2, -2, -2]


def test_a_forged_request_makes_the_server_knock_nowhere():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.3)
        with (
            VrpnEmulator(MOTION, port=0) as server,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp,
        ):
            udp.bind(("127.0.0.2", 0))
            request = vrpn.connection_request("127.0.0.1", listener.getsockname()[1])
            udp.sendto(request, ("127.0.0.1", server.port))
            with pytest.raises(TimeoutError):
                listener.accept()


def test_y_up_servers_are_turned_upright():
    pose: StationPose = (
        np.array([1.0, 2.0, 3.0]),
        rotation.from_rotation_vector(np.array([0, 0.5, 0])),
    )
    with VrpnEmulator(lambda t: [pose], port=0) as server:
        config = VrpnConfig(server=server.address, stations={"head": "Tracker0"}, axes="y-up")
        with VrpnDevice(config) as device:
            sample, _ = device.samples.drain(PATIENCE)[0]
    np.testing.assert_allclose(sample.position, [1.0, -3.0, 2.0])
    expected = rotation.from_rotation_vector(np.array([0.0, 0.0, 0.5]))
    np.testing.assert_allclose(sample.quaternion, expected, atol=1e-12)


def test_a_datagram_is_as_old_as_its_arrival_not_as_its_reading():
    link = UdpLink("127.0.0.1", 0)
    time.sleep(0.2)  # kernels begin to stamp a moment after they were asked to
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            before = time.monotonic()
            sender.sendto(b"here", ("127.0.0.1", link.port))
            after = time.monotonic()
        time.sleep(0.5)
        data, arrival = link.read(PATIENCE)
    finally:
        link.close()
    assert data == b"here"
    # Two clocks are compared, which do not tick at once.
    assert before - 0.01 <= arrival <= after + 0.2
