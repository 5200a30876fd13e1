"""Emulator, line and driver together, on real pseudo terminals and sockets.

Nothing here asserts tight times: the machine may be busy.
"""

import contextlib
import itertools
import os
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import serial
from typer.testing import CliRunner

from sensors import rotation
from sensors.assembler import AssemblerConfig, FrameAssembler
from sensors.cli import app
from sensors.commands.listing import ask
from sensors.config import device_config
from sensors.devices import open_device
from sensors.devices.is900 import Is900Config, Is900Device
from sensors.emulators.endpoints import Endpoint, PtyEndpoint, TcpEndpoint
from sensors.emulators.faults import (
    Corruption,
    Dropout,
    Jump,
    Junk,
    PowerCycle,
    Silence,
    Stall,
    Swap,
    Truncation,
)
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.process import EmulatorProcess
from sensors.emulators.source import Playback, wandering
from sensors.errors import ConfigurationError, ConnectionFailedError
from sensors.protocols.is900 import Parser, Record, Response, Unit
from sensors.stream import FrameStream, SampleQueue
from tests.sensors.patience import PATIENCE, eventually

NAMES = tuple(f"station{n}" for n in range(1, 7))
# Frames close as soon as they are complete; only a machine that is too busy needs the rest.
PATIENT = AssemblerConfig(rate=40.0, delay=1.0)
STATIONS = {name: n for n, name in enumerate(NAMES, start=1)}


def config(address: str, **settings) -> Is900Config:
    quick = {
        "pause": 0.05,
        "max_pause": 0.2,
        "max_reset_pause": 0.2,
        "reset_timeout": 3.0,
        "silence_timeout": 0.5,
    }
    return Is900Config(port=address, stations=STATIONS, **{**quick, **settings})


def record_count(device: Is900Device) -> int:
    return device.counters.parser.records


@contextlib.contextmanager
def raw_host(address: str) -> Iterator[serial.Serial]:
    port = serial.serial_for_url(address, baudrate=115200, timeout=5.0)
    try:
        yield port
    finally:
        port.close()


@pytest.fixture(params=["pty", "tcp"])
def endpoint(request: pytest.FixtureRequest) -> Endpoint:
    return PtyEndpoint() if request.param == "pty" else TcpEndpoint()


def read_answer(port: serial.Serial) -> bytes:
    return port.read_until(b"\r\n")


@pytest.mark.parametrize("end", [b"\r\n", b"\r"])
def test_the_command_order_of_a_vrpn_host(endpoint, end):
    with Is900Emulator(wandering(4), stations=4, endpoint=endpoint) as emulator:
        with raw_host(emulator.address) as port:
            port.write(b"c")
            port.write(b"S")
            status = port.read(55)
            assert status[:3] == b"21S"
            assert status.endswith(b"\r\n")
            for n in range(1, 5):
                port.write(b"O%d,2,11,21,0" % n + end)
                port.write(b"x%d,0.2,0.2,0.8,0.8" % n + end)
                port.write(b"v%d,0.2,0.2,0.8,0.8" % n + end)
            port.write(b"MT" + end + b"MZ" + end)
            port.write(b"f")
            port.write(b"C")
            data = port.read(36 * 4 * 5)
        for k, station in zip(range(20), itertools.cycle(b"1234")):
            record = data[36 * k : 36 * k + 36]
            assert (record[0], record[1], record[2], record[-1]) == (0x30, station, 0x20, 0x20)
    parser = Parser(dict.fromkeys(range(1, 5), (2, 11, 21, 0)), unit=Unit.INCH)
    records = [m for m in parser.feed(data) if isinstance(m, Record)]
    assert len(records) == 20
    assert all(r.time is not None and r.time < PATIENCE for r in records)
    for r in records[:4]:
        p, q = wandering(4)(0.0)[r.station - 1]
        np.testing.assert_allclose(r.position, p * [1, -1, -1], atol=1e-5)
        np.testing.assert_allclose(r.quaternion, q * [1, 1, -1, -1], atol=1e-5)


# What the VRPN host sends at its first, third and sixth attempt to find the device.
ATTEMPTS = [b"c", b"\r\x19c", b"\rYt\x19c"]


@pytest.mark.parametrize("attempt", ATTEMPTS)
def test_a_vrpn_host_with_every_option_byte_for_byte(endpoint, attempt):
    """Time, buttons and joystick asked for; records read as that host reads them."""
    with (
        Is900Emulator(wandering(4), stations=4, endpoint=endpoint) as emulator,
        raw_host(emulator.address) as port,
    ):
        for byte in attempt:
            port.write(bytes((byte,)))
        port.write(b"S")
        status = port.read(55)
        assert (status[:1], status[-1:]) == (b"2", b"\n")
        for n in range(1, 5):
            port.write(b"O%d,2,11,21,22,23,0\r" % n)
        port.write(b"x0.2,0.2,0.8,0.8\r")
        port.write(b"v0.2,0.2,0.8,0.8\r")
        port.write(b"f")
        port.write(b"C")
        port.write(b"MT\rMZ\r")
        length = 4 + 12 + 16 + 4 + 1 + 2
        data = port.read(length * 4 * 6)
    assert len(data) == length * 4 * 6
    for k in range(24):
        record = data[length * k : length * (k + 1)]
        assert record[:1] == b"0"
        assert record[1] in b"1234"
        assert record[2:3] == record[-1:] == b" "
        values = struct.unpack("<3f4ff3B", record[3:-1])
        assert sum(q * q for q in values[3:7]) == pytest.approx(1.0, abs=1e-5)
        assert 0.0 <= values[7] < 1e3 * PATIENCE
        assert values[8:] == (0, 127, 127)


def test_the_command_order_of_the_vendors_host(endpoint):
    with (
        Is900Emulator(wandering(6), endpoint=endpoint) as emulator,
        raw_host(emulator.address) as port,
    ):
        port.write(b"c")
        port.write(b"S")
        assert len(port.read(55)) == 55
        port.write(b"MS\r\n")
        assert read_answer(port) == b"31S000\r\n"
        for n in b"123456":
            port.write(b"O%c,2,4,40,22,23,1\r\n" % n)
            port.write(b"O%c\r\n" % n)
            assert read_answer(port) == b"2%cO 2 4402223 1\r\n" % n
        port.write(b"f")
        port.write(b"u")
        port.write(b"C")
        port.write(b"\x11")
        port.write(b"l*\r\n")
        port.write(b"MG\r\n")
        parser = Parser(dict.fromkeys(range(1, 7), (2, 4, 40, 22, 23, 1)))
        messages = parser.feed(port.read(33 * 6 * 4))
    records = [m for m in messages if isinstance(m, Record)]
    answers = [m for m in messages if isinstance(m, Response)]
    assert len(records) >= 20
    assert [(a.kind, a.payload) for a in answers if a.kind == "l"] == [("l", "1" * 6 + "0" * 26)]
    assert parser.counters.skipped_bytes == 0
    assert records[0].tracking_status == 1.0


def test_ascii_poll(endpoint):
    with (
        Is900Emulator(wandering(2), stations=2, endpoint=endpoint) as emulator,
        raw_host(emulator.address) as port,
    ):
        port.write(b"cFuP")
        first, second = read_answer(port), read_answer(port)
    assert (first[:3], second[:3]) == (b"01 ", b"02 ")
    assert len(first) == 3 + 21 + 21 + 2
    assert float(first[3:10]) == pytest.approx(50.0)


def test_from_emulator_to_frames(endpoint):
    with Is900Emulator(wandering(6), endpoint=endpoint) as emulator:
        device = open_device(
            device_config({"driver": "is900", "port": emulator.address, "stations": STATIONS})
        )
        assembler = FrameAssembler(NAMES, PATIENT)
        with device:
            frames = FrameStream(device.samples, assembler)
            assert emulator.wait_started(PATIENCE)
            zero = emulator.motion_zero
            errors, complete = [], 0
            give_up = time.monotonic() + PATIENCE
            while complete < 30 and time.monotonic() < give_up:
                assembled = frames.next(PATIENCE)
                assert assembled is not None
                frame = assembled.frame
                complete += bool(frame.position_mask.all())
                if frame.position_mask.all():
                    truth = wandering(6)(frame.time - zero)
                    assert assembled.newest_arrival <= assembled.closed_at
                    positions = np.array([p for p, _ in truth])
                    quaternions = np.array([q for _, q in truth])
                    errors.append(float(np.abs(frame.positions - positions).max()))
                    angles = rotation.angle_between(frame.quaternions, quaternions)
                    assert float(angles.max()) < 0.2
    # 0.8 m/s: a busy machine may delay the whole stream by several milliseconds.
    assert complete >= 30, assembler.counters
    assert np.median(errors) < 0.02
    assert device.state == "stopped"
    assert device.counters.parser.bad_records == 0


def test_garbage_on_the_line_costs_records_not_the_stream():
    faults = [Junk(probability=0.3), Truncation(probability=0.2)]
    with (
        Is900Emulator(wandering(6), rate=100.0, faults=faults, seed=4) as emulator,
        Is900Device(config(emulator.address)) as device,
    ):
        eventually(lambda: record_count(device) > 300, "records in spite of garbage")
        c = device.counters
        assert c.parser.bad_records > 10
        assert c.parser.skipped_bytes > 100
        assert c.recoveries == c.port_losses == 0
        for sample, _ in device.samples.drain(0.0):
            assert np.abs(sample.position).max() < 3.0


def test_silence_leads_to_a_reset_and_back_to_samples():
    with (
        Is900Emulator(wandering(6), rate=100.0) as emulator,
        Is900Device(config(emulator.address)) as device,
    ):
        eventually(lambda: record_count(device) > 50, "first records")
        now = emulator.motion_time(time.monotonic())
        emulator.faults.inject(Silence(start=now, duration=1.5))
        eventually(lambda: device.counters.recoveries >= 1, "silence noticed")
        before = record_count(device)
        eventually(lambda: record_count(device) > before + 50, "records after silence")


def test_a_power_cycle_is_set_up_anew():
    with (
        Is900Emulator(wandering(6), rate=100.0) as emulator,
        Is900Device(config(emulator.address)) as device,
    ):
        eventually(lambda: record_count(device) > 50, "first records")
        now = emulator.motion_time(time.monotonic())
        emulator.faults.inject(PowerCycle(start=now))
        eventually(lambda: device.counters.recoveries == 1, "silence noticed")
        before = record_count(device)
        eventually(lambda: record_count(device) > before + 50, "records after the power cycle")
        assert device.counters.port_losses == 0


@pytest.mark.parametrize("kind", ["pty", "tcp"])
def test_a_port_that_goes_away_and_comes_back(kind, tmp_path):
    link = tmp_path / "tracker"

    def new_endpoint(port: int = 0) -> Endpoint:
        return PtyEndpoint(link) if kind == "pty" else TcpEndpoint(port=port)

    first = Is900Emulator(wandering(6), rate=100.0, endpoint=new_endpoint())
    first.start()
    with Is900Device(config(first.address)) as device:
        eventually(lambda: record_count(device) > 50, "first records")
        first.stop()
        eventually(lambda: device.counters.port_losses >= 1, "port loss noticed")
        port = int(first.address.rpartition(":")[2]) if kind == "tcp" else 0
        with Is900Emulator(wandering(6), rate=100.0, endpoint=new_endpoint(port)):
            before = record_count(device)
            eventually(lambda: record_count(device) > before + 50, "records after reopening")
            assert device.counters.connects >= 2


def test_a_missing_port_is_waited_for(tmp_path):
    link = tmp_path / "tracker"
    with Is900Device(config(str(link))) as device:
        eventually(lambda: device.counters.failures >= 2, "failed attempts")
        assert "cannot open" in device.last_error
        with Is900Emulator(wandering(6), endpoint=PtyEndpoint(link)):
            eventually(lambda: record_count(device) > 20, "records")


def test_unplugged_for_seconds_and_back(tmp_path):
    """With the settings as they come: pauses have grown, yet the return is noticed soon."""
    link = tmp_path / "tracker"
    first = Is900Emulator(wandering(6), endpoint=PtyEndpoint(link))
    first.start()
    with Is900Device(Is900Config(port=first.address, stations=STATIONS)) as device:
        eventually(lambda: record_count(device) > 20, "first records")
        first.stop()
        time.sleep(3.0)
        before, failures = record_count(device), device.counters.failures
        with Is900Emulator(wandering(6), endpoint=PtyEndpoint(link)):
            back = time.monotonic()
            eventually(lambda: record_count(device) > before, "records again")
            taken = time.monotonic() - back
            assert device.counters.port_losses == 1
    assert 3 <= failures <= 12
    # 2 s on a machine that has nothing else to do.
    assert taken < 8.0


def test_a_missing_port_is_said_at_once():
    with Is900Device(config("/dev/nope")) as device:
        assert not device.wait_attempt(PATIENCE)
        assert "there is no such port" in device.last_error


def test_a_stalled_line_keeps_the_capture_times():
    with (
        Is900Emulator(wandering(6), faults=[Stall(start=0.5, duration=0.3)]) as emulator,
        Is900Device(config(emulator.address)) as device,
    ):
        delays = []
        give_up = time.monotonic() + PATIENCE
        while len(delays) < 240 and time.monotonic() < give_up:
            for sample, arrival in device.samples.drain(0.1):
                delays.append(arrival - sample.time)
                truth = wandering(6)(sample.time - emulator.motion_zero)
                position = truth[STATIONS[sample.tracker] - 1][0]
                assert np.abs(sample.position - position).max() < 0.1
    assert max(delays) > 0.2


def test_exchanged_stations_are_reported():
    with (
        Is900Emulator(wandering(6), faults=[Swap(station=1, other=4, start=1.0)]) as emulator,
        Is900Device(config(emulator.address)) as device,
    ):
        stream = FrameStream(device.samples, FrameAssembler(NAMES, PATIENT))
        swaps = []
        for _ in range(70):
            assembled = stream.next(PATIENCE)
            assert assembled is not None
            swaps += assembled.swaps
    assert swaps == [("station1", "station4")]


def test_what_answers_on_a_port(endpoint):
    with Is900Emulator(wandering(3), stations=3, endpoint=endpoint) as emulator:
        answer = ask(emulator.address)
    assert answer.is_tracker
    assert "IS-900 emulated by localreg" in answer.words
    assert "stations 1, 2, 3" in answer.words
    assert ask("/dev/nope").words.startswith("cannot open /dev/nope")


def test_the_monitor_shows_every_station_and_what_is_wrong():
    faults = [Corruption(probability=0.5)]
    with Is900Emulator(wandering(2), stations=2, faults=faults) as emulator:
        arguments = ["monitor", emulator.address, "--seconds", "1.5"]
        result = CliRunner(env={"COLUMNS": "160"}).invoke(app, arguments)
    assert result.exit_code == 0, result.output
    last = result.stdout[result.stdout.rindex("tracker") :]
    rows = [line.split("│") for line in last.splitlines() if line.startswith("│")]
    by_name = {row[1].strip(): [cell.strip() for cell in row[2:-1]] for row in rows}
    for station in ("1", "2"):
        samples, rate, _, _, quality = by_name[station]
        assert int(samples) > 5
        assert 1.0 < float(rate) < 80.0
        assert quality == "1.00"
    state, records, bad, skipped, *_ = by_name["is900"]
    assert (state, int(records) > 10, int(bad) >= 0) == ("streaming", True, True)
    assert int(skipped) > 38


class _Defective(Is900Device):
    """Fails once in the middle of everything."""

    def _read(self, link, lists):
        if not self.counters.failures:
            raise ZeroDivisionError("a defect")
        super()._read(link, lists)


def test_a_defect_of_a_driver_does_not_silence_the_tracker(caplog):
    with (
        Is900Emulator(wandering(6)) as emulator,
        _Defective(config(emulator.address)) as device,
    ):
        eventually(lambda: record_count(device) > 10, "records after all")
    assert device.counters.failures == 1
    assert "a defect" in caplog.text


@pytest.mark.parametrize("protocol", ["vrpn", "vrchat"])
def test_other_emulators_as_a_process(protocol):
    place = "--tcp" if protocol == "vrpn" else "--to"
    arguments = ["--protocol", protocol, place, f"127.0.0.1:{0 if protocol == 'vrpn' else 9}"]
    with EmulatorProcess(arguments=[*arguments, "--start", "later"]) as process:
        process.begin()
        assert process.wait_started(PATIENCE)
        if protocol == "vrpn":
            samples = SampleQueue()
            vrpn = {"driver": "vrpn", "server": process.address}
            with open_device(device_config(vrpn), samples):
                names = {s.tracker for s, _ in samples.drain(PATIENCE)}
            assert names <= {f"Tracker0:{n}" for n in range(6)}
            assert names


def test_stop_is_quick_while_the_device_is_deaf():
    master, slave = os.openpty()
    try:
        device = Is900Device(config(os.ttyname(slave), reset_timeout=60.0, answer_timeout=30.0))
        device.start()
        eventually(lambda: device.state == "setting up", "setting up")
        begun = time.monotonic()
        device.stop()
        assert time.monotonic() - begun < 5.0
    finally:
        os.close(master)
        os.close(slave)


def test_stations_nobody_wants_are_switched_off():
    with Is900Emulator(wandering(6), rate=100.0) as emulator:
        settings = Is900Config(port=emulator.address, stations={"left": 2, "right": 5})
        with Is900Device(settings) as device:
            eventually(lambda: device.counters.samples["right"] > 10, "samples")
            assert [n for n, s in emulator.unit.stations.items() if s.on] == [2, 5]
            assert device.counters.unmapped == 0


def test_dropout_and_jump_reach_the_frames():
    faults = [Dropout(station=3), Jump(station=4, dz=5.0)]
    with (
        Is900Emulator(wandering(6), faults=faults) as emulator,
        Is900Device(config(emulator.address)) as device,
    ):
        stream = FrameStream(device.samples, FrameAssembler(NAMES, PATIENT))
        masks = []
        for _ in range(40):
            assembled = stream.next(PATIENCE)
            assert assembled is not None
            masks.append(assembled.frame.position_mask)
            if assembled.frame.position_mask[3]:
                assert assembled.frame.positions[3, 2] > 4.0
    assert not any(m[2] for m in masks)
    assert sum(bool(m[3]) for m in masks) > 20


def test_the_placement_of_the_configuration_is_applied():
    with Is900Emulator(lambda t: wandering(6)(0.0)) as emulator:
        turned = config(emulator.address, placement={"yaw": 90.0, "translation": (0.0, 0.0, 1.0)})
        with Is900Device(turned) as device:
            eventually(lambda: record_count(device) > 6, "records")
            sample, _ = device.samples.drain(1.0)[0]
    p = wandering(6)(0.0)[STATIONS[sample.tracker] - 1][0]
    np.testing.assert_allclose(sample.position, [-p[1], p[0], p[2] + 1.0], atol=1e-6)


def test_a_host_that_does_not_read_does_not_stop_the_emulator():
    with Is900Emulator(wandering(6), rate=1000.0) as emulator, raw_host(emulator.address) as port:
        port.write(b"fC")
        eventually(lambda: emulator.counters.overruns > 10, "overruns")
        port.reset_input_buffer()
        port.write(b"c")
        eventually(lambda: not emulator.unit.continuous, "stop obeyed")


def test_the_emulator_as_a_process_plays_a_file_and_says_when(tmp_path):
    times = np.arange(0.0, 0.6, 0.025)
    poses = [wandering(2)(float(t)) for t in times]
    positions = np.array([[p for p, _ in row] for row in poses])
    quaternions = np.array([[q for _, q in row] for row in poses])
    Playback(times, positions, quaternions, ("head", "pelvis")).save(tmp_path / "walk.npz")
    with EmulatorProcess(
        tmp_path / "walk.npz", ["--at-end", "exit", "--start", "later"]
    ) as process:
        settings = Is900Config(port=process.address, stations={"head": 1, "pelvis": 2})
        with Is900Device(settings) as device:
            eventually(lambda: device.counters.samples["head"] > 5, "held samples")
            assert process.motion_zero is None
            asked = time.monotonic()
            process.begin()
            assert process.wait_started(PATIENCE)
            assert process.motion_zero is not None
            assert asked - 0.1 < process.motion_zero < asked + PATIENCE
            assert process.wait_ended(PATIENCE)
            received = device.samples.drain(0.0)
    assert process.summary is not None
    assert process.summary["reason"] == "finished"
    moving = [s for s, _ in received if 0.1 < s.time - process.motion_zero < 0.4]
    assert len(moving) > 10
    for s in moving:
        j = ("head", "pelvis").index(s.tracker)
        truth = wandering(2)(s.time - process.motion_zero)[j][0]
        assert np.abs(s.position - truth).max() < 0.05


def test_a_process_that_cannot_start_says_why(tmp_path):
    with pytest.raises(ConnectionFailedError, match="cannot be played"):
        EmulatorProcess(tmp_path / "nothing.npz")


def test_addresses_that_cannot_be_had():
    taken = TcpEndpoint()
    try:
        with pytest.raises(ConnectionFailedError, match="choose another port"):
            TcpEndpoint(port=int(taken.address.rpartition(":")[2]))
    finally:
        taken.close()
    with pytest.raises(ConnectionFailedError, match="choose another path"):
        PtyEndpoint(Path("/nowhere/tracker"))


@pytest.mark.parametrize(
    ("driver", "settings", "words"),
    [
        ("is800", {}, "did you mean is900?"),
        ("is900", {"stations": {"head": 1}}, "setting port is missing"),
        (
            "is900",
            {"port": "x", "stations": {"head": 1}, "bawd": 3},
            "did you mean baud",
        ),
        ("is900", {"port": "x", "stations": {"head": 13}}, "1 to 12"),
        ("is900", {"port": "x", "stations": {"a": 1, "b": 1}}, "of its own"),
        ("is900", {"port": "x", "stations": {"a": 1}, "items": [2, 1]}, "no pose"),
        ("is900", {"port": "x", "stations": {"a": 1}, "prediction": 60}, "0 to 50"),
    ],
)
def test_settings_that_make_no_device(driver, settings, words):
    with pytest.raises(ConfigurationError, match=words):
        device_config({"driver": driver, **settings})
