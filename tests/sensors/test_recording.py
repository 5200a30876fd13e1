"""Recordings: complete, cut off by a kill, on a full disk; and made into frames again."""

import json
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from typer.testing import CliRunner

from sensors.assembler import AssembledFrame, FrameAssembler
from sensors.cli import app
from sensors.config import SensorsConfig
from sensors.devices.is900 import Is900Config, Is900Device
from sensors.devices.replay import ReplayConfig, ReplayDevice
from sensors.emulators.faults import Dropout, Junk
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.is900_udp import Is900UdpEmulator
from sensors.emulators.recorded import load_motion
from sensors.emulators.source import wandering
from sensors.emulators.vrpn import VrpnEmulator
from sensors.errors import RecordingError
from sensors.placement import Placement
from sensors.recording import Recorder, read_recording
from sensors.recording.replay import read_configuration, replay_frames
from sensors.stream import FrameStream, SampleQueue
from sensors.tracker_input import TrackerInput
from tests.sensors.patience import PATIENCE, eventually

NAMES = ("head", "torso", "lhand", "rhand", "lankle", "rankle")
STATIONS = {name: n for n, name in enumerate(NAMES, start=1)}
POSES = {"title": "poses", "type": "object"}


def same(a: AssembledFrame, b: AssembledFrame) -> bool:
    return (
        a.index == b.index
        and a.closed_at == b.closed_at
        and a.frame.time == b.frame.time
        and all(np.array_equal(x, y) for x, y in zip(a.frame[1:], b.frame[1:], strict=True))
        and (a.newest_arrival == b.newest_arrival or math.isnan(a.newest_arrival))
    )


def take(trackers: TrackerInput, count: int) -> list[AssembledFrame]:
    frames = []
    while len(frames) < count:
        assembled = trackers.stream.next(PATIENCE)
        assert assembled is not None
        frames.append(assembled)
    return frames


def recorded_session(path: Path) -> list[AssembledFrame]:
    """Six trackers on three devices of different kinds, with faults, moved meanwhile."""
    faults = [Junk(probability=0.05), Dropout(station=2, start=0.4, duration=0.3)]
    with (
        Is900Emulator(wandering(3), stations=3, faults=faults, seed=1) as serial,
        VrpnEmulator(wandering(2), port=0) as server,
        Recorder(path) as recorder,
    ):
        config = SensorsConfig.parse(
            {
                "devices": [
                    {
                        "driver": "is900",
                        "port": serial.address,
                        "stations": {"head": 1, "torso": 2, "lhand": 3},
                        "placement": {"yaw": 10.0},
                    },
                    {
                        "driver": "vrpn",
                        "server": server.address,
                        "stations": {"rhand": "Tracker0:0", "lankle": "Tracker0:1"},
                    },
                    {"driver": "is900-udp", "port": 0, "stations": {"rankle": 1}},
                ],
                "assembler": {"delay": 0.3},
                "room": {"yaw": 30.0, "translation": [1.0, 2.0, 3.0]},
            }
        )
        with TrackerInput(config, recorder=recorder) as trackers:
            assert trackers.devices[2].wait_attempt(PATIENCE)
            port = trackers.devices[2].port
            with Is900UdpEmulator(wandering(1), port=port, clock_drift=1e-4):
                frames = take(trackers, 30)
                trackers.room.move(Placement(yaw=-20.0))
                frames += take(trackers, 20)
    assert recorder.counters.lost == 0
    assert recorder.error == ""
    return frames


def test_frames_are_made_again_bit_for_bit(tmp_path):
    path = tmp_path / "session.mcap"
    frames = recorded_session(path)
    again = list(replay_frames(path))
    # Those that were closed together with the last one taken are in the file, too.
    assert len(again) >= len(frames)
    assert all(map(same, frames, again))
    assert sum(bool(a.frame.position_mask.all()) for a in again) > 5
    assert {m.topic for m in read_recording(path)} >= {
        "/sensors",
        "/raw/is900",
        "/raw/vrpn",
        "/raw/is900-udp",
        "/samples",
        "/frames",
        "/room",
    }
    result = CliRunner().invoke(app, ["replay", "--check", str(path)])
    assert result.exit_code == 0, result.output
    assert "bit for bit" in result.stdout
    motion = load_motion(path)
    assert motion.names == read_configuration(path).trackers
    assert motion.positions.shape == (len(again), 6, 3)


def test_a_replay_at_tenfold_speed_gives_the_same_samples(tmp_path):
    path = tmp_path / "session.mcap"
    recorded_session(path)
    recorded = [
        (t["child_frame_id"], t["time"], t["arrival"], t["translation"]["x"], t["rotation"]["w"])
        for m in read_recording(path, ("/samples",))
        for t in m.data["transforms"]
    ]
    device = ReplayDevice(ReplayConfig(file=path, speed=10.0), SampleQueue(100_000))
    with device:
        assert device.finished.wait(PATIENCE)
    assert device.state == "finished"
    replayed = [
        (s.tracker, s.time, arrival, s.position[0], s.quaternion[0])
        for s, arrival in device.samples.drain(0.0)
    ]
    assert replayed == recorded


def test_a_replay_stands_in_for_the_devices(tmp_path):
    path, second = tmp_path / "session.mcap", tmp_path / "again.mcap"
    frames = recorded_session(path)
    config = SensorsConfig.parse(
        {"devices": [{"driver": "replay", "file": str(path), "speed": 4.0}]}
    )
    with Recorder(second) as recorder, TrackerInput(config, recorder=recorder) as trackers:
        assert trackers.trackers == NAMES
        again = take(trackers, 20)
    begin, end = frames[0].frame.time, frames[-1].frame.time
    assert all(begin - 0.1 <= a.frame.time <= end for a in again)
    # Recorded once more it is a recording like any other.
    assert all(map(same, again, replay_frames(second)))


def test_samples_that_gave_way_give_way_again(tmp_path):
    path = tmp_path / "slow.mcap"
    with Is900Emulator(wandering(6), rate=100.0) as emulator, Recorder(path) as recorder:
        config = Is900Config(name="is900", port=emulator.address, stations=STATIONS)
        queue, assembler = SampleQueue(capacity=40), FrameAssembler(NAMES)
        stream = FrameStream(queue, assembler, recorder=recorder)
        settings = assembler.config.model_dump(mode="json")
        recorder.configuration(NAMES, [config.model_dump(mode="json")], settings, {})
        frames = []
        with Is900Device(config, queue, recorder):
            for k in range(30):
                assembled = stream.next(PATIENCE)
                assert assembled is not None
                frames.append(assembled)
                if k % 10 == 9:
                    before = queue.dropped
                    eventually(lambda: queue.dropped > before + 20, "drops")  # noqa: B023
    assert queue.dropped > 60
    assert all(map(same, frames, replay_frames(path)))


def test_a_recording_with_holes_is_made_again_up_to_the_first(tmp_path):
    path = tmp_path / "holes.mcap"
    with Is900Emulator(wandering(6)) as emulator:
        stations = {"driver": "is900", "port": emulator.address, "stations": STATIONS}
        config = SensorsConfig.parse({"devices": [stations]})
        with (
            Recorder(path, flush_interval=1.0, capacity=50) as recorder,
            TrackerInput(config, recorder=recorder) as trackers,
        ):
            eventually(lambda: (take(trackers, 1), recorder.counters.lost > 30)[1], "loss")
            eventually(lambda: (take(trackers, 1), recorder.counters.messages > 90)[1], "more")
    recorded = [m.data["time"] for m in read_recording(path, ("/frames",))]
    again = []
    with pytest.raises(RecordingError, match="could not keep up"):
        again.extend(a.frame.time for a in replay_frames(path))
    assert 1 < len(again) < len(recorded)
    assert again == recorded[: len(again)]


WRITER = """
import sys, time
from pathlib import Path
from sensors.recording import Recorder
recorder = Recorder(Path(sys.argv[1]))
channel = recorder.channel("/count", "count", {"type": "object"})
begun = time.monotonic()
n = 0
while True:
    now = time.monotonic()
    channel.write({"n": n, "t": now}, now)
    n += 1
    if n % 10 == 0:
        sys.stdout.write(f"{n} {recorder.counters.messages}\\n")
        sys.stdout.flush()
    time.sleep(0.001)
"""


@pytest.mark.parametrize("moment", [0.15, 0.33, 0.5, 0.71])
def test_a_killed_recording_holds_all_but_the_last_moment(tmp_path, moment):
    path = tmp_path / "killed.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        time.sleep(moment)
        killed = time.monotonic()
        os.kill(child.pid, signal.SIGKILL)
        said = [tuple(map(int, line.split())) for line in child.stdout if line.endswith("\n")]
    ours = [m.data for m in read_recording(path, ("/count",))]
    assert [m["n"] for m in ours] == list(range(len(ours)))
    # Whatever the recorder had called written is there.
    assert len(ours) >= said[-1][1]
    # The recorder promises 0.1 s; a busy machine may keep its thread waiting longer.
    assert killed - ours[-1]["t"] < 1.0
    theirs: list[object] = []
    with path.open("rb") as file, pytest.raises(McapError):
        theirs.extend(
            json.loads(r.data) for r in StreamReader(file).records if isinstance(r, Message)
        )
    assert theirs == ours


@pytest.fixture(scope="module")
def counted(tmp_path_factory):
    """A recording of sixty messages in several chunks."""
    path = tmp_path_factory.mktemp("recording") / "whole.mcap"
    with Recorder(path, flush_interval=0.01) as recorder:
        channel = recorder.channel("/count", "count", POSES)
        for n in range(60):
            channel.write({"n": n}, time.monotonic())
            time.sleep(0.002)
    return path.read_bytes()


def test_a_recording_cut_anywhere_is_a_shorter_recording(counted, tmp_path):
    data = counted
    cut = tmp_path / "cut.mcap"
    longest = 0
    for length in [*range(8, len(data), 37), len(data)]:
        cut.write_bytes(data[:length])
        found = [m.data["n"] for m in read_recording(cut, ("/count",))]
        assert found == list(range(len(found)))
        assert len(found) >= longest
        longest = len(found)
    assert longest == 60


@pytest.mark.parametrize("junk", [b"\xff" * 8, b"\x00\x00\x00\x00\x04\x00\x00\x00"])
def test_a_recording_damaged_anywhere_is_a_shorter_recording(counted, tmp_path, junk):
    """Lengths of exabytes and of gigabytes, and names that are no text."""
    damaged = tmp_path / "damaged.mcap"
    shorter = 0
    for place in range(8, len(counted) - 8, 5):
        damaged.write_bytes(counted[:place] + junk + counted[place + 8 :])
        found = [m.data.get("n") for m in read_recording(damaged, ("/count",))]
        assert len(found) <= 60
        shorter += len(found) < 60
    assert shorter > 10


def test_other_readers_find_everything_by_the_index(tmp_path):
    path = tmp_path / "walk.mcap"
    with Recorder(path) as recorder:
        schema = {"title": "poses", "type": "object"}
        channel = recorder.channel("/poses", "foxglove.PosesInFrame", schema)
        assert recorder.channel("/poses", "foxglove.PosesInFrame", schema) is channel
        for n in range(5):
            channel.write({"n": n, "q": np.arange(3.0), "bad": [math.nan, 1.0]}, 100.0 + n)
        with pytest.raises(RecordingError, match="another topic"):
            recorder.channel("/poses", "other", {})
        channel.write({"n": object()}, 105.0)
    c = recorder.counters
    assert (c.messages, c.lost, c.refused) == (5, 0, 1)
    with path.open("rb") as file:
        found = list(make_reader(file, validate_crcs=True).iter_messages())
    assert [json.loads(m.data) for _, _, m in found] == [
        {"n": n, "q": [0.0, 1.0, 2.0], "bad": [None, 1.0]} for n in range(5)
    ]
    assert {(c.topic, c.message_encoding) for _, c, _ in found} == {("/poses", "json")}
    assert json.loads(found[0][0].data) == schema
    assert found[1][2].log_time - found[0][2].log_time == 1_000_000_000


FULL = """
import resource, sys, time
from pathlib import Path
from sensors.recording import Recorder
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
recorder = Recorder(Path(sys.argv[1]))
channel = recorder.channel("/count", "count", {"type": "object"})
n = 0
while not recorder.error:
    filler = [(n * k * 7919) % 10007 for k in range(100)]
    channel.write({"n": n, "filler": filler}, time.monotonic())
    n += 1
    time.sleep(0.001)
before = recorder.counters.lost
for _ in range(100):
    channel.write({"n": n}, time.monotonic())
recorder.close()
print(recorder.counters.lost - before)
"""


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path):
    path = tmp_path / "full.mcap"
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(path)], capture_output=True, text=True, timeout=60.0
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "100\n"
    assert done.stderr.count("\n") == 1
    assert "the recording" in done.stderr
    assert "Make room" in done.stderr
    found = [m.data["n"] for m in read_recording(path)]
    assert found == list(range(len(found)))
    assert len(found) > 10


def test_what_does_not_fit_into_the_queue_is_counted_and_said(tmp_path):
    path = tmp_path / "busy.mcap"
    with Recorder(path, flush_interval=30.0, capacity=10) as recorder:
        channel = recorder.channel("/count", "count", POSES)
        for n in range(100):
            channel.write({"n": n}, time.monotonic())
        assert recorder.counters.lost == 90
    assert [m.data["n"] for m in read_recording(path, ("/count",))] == list(range(10))
    assert [m.data for m in read_recording(path, ("/recorder",))] == [{"lost": 90}]


def test_files_that_are_no_recordings(tmp_path):
    taken = tmp_path / "taken.mcap"
    taken.write_bytes(b"precious")
    with pytest.raises(RecordingError, match="never overwritten"):
        Recorder(taken)
    assert taken.read_bytes() == b"precious"
    with pytest.raises(RecordingError, match="choose another place"):
        Recorder(tmp_path / "nowhere" / "walk.mcap")
    with pytest.raises(RecordingError, match="is no recording"):
        list(read_recording(taken))
    with pytest.raises(RecordingError, match="cannot read"):
        list(read_recording(tmp_path / "absent.mcap"))
    with Recorder(tmp_path / "empty.mcap"):
        pass
    with pytest.raises(RecordingError, match="no tracker data"):
        list(replay_frames(tmp_path / "empty.mcap"))


def test_a_command_records_and_checks(tmp_path):
    path = tmp_path / "walk.mcap"
    with Is900Emulator(wandering(2), stations=2) as emulator:
        arguments = ["record", str(path), emulator.address, "--seconds", "1"]
        result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert read_configuration(path).trackers == ("station1", "station2")
    assert len(list(replay_frames(path))) > 10
