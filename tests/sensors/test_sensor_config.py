"""Configurations: what is valid, and what is said of the rest."""

import tomllib
from pathlib import Path

import pytest

from sensors.assembler import AssemblerConfig
from sensors.config import SensorsConfig, device_config, read_config
from sensors.devices import open_device
from sensors.devices.is900 import Is900Config
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.source import wandering
from sensors.errors import ConfigurationError
from sensors.targets import device_at
from sensors.tracker_input import TrackerInput
from tests.sensors.patience import PATIENCE

TWO_PORTS = """
[[devices]]
driver = "is900"
port = "/dev/ttyUSB0"
stations = { head = 1, torso = 2, lhand = 3, rhand = 4 }

[[devices]]
driver = "is900"
port = "/dev/ttyUSB1"
stations = { lankle = 1, rankle = 2 }

[assembler]
rate = 60

[room]
yaw = 90.0

[other]
thing = true
"""


def test_a_file_gives_its_tables_and_leaves_the_rest(tmp_path):
    path = tmp_path / "stage.toml"
    path.write_text(TWO_PORTS)
    config = read_config(path)
    assert config.trackers == ("head", "torso", "lhand", "rhand", "lankle", "rankle")
    assert [d.name for d in config.named_devices()] == ["is9001", "is9002"]
    assert config.assembler == AssemblerConfig(rate=60.0)
    assert config.room.yaw == 90.0


def device(**values: object) -> dict[str, object]:
    return {"devices": [{"driver": "is900", "port": "x", "stations": {"head": 1}, **values}]}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "the setting devices is missing"),
        ({"devices": []}, "devices is"),
        ({**device(), "assemble": {}}, "unknown setting assemble; did you mean assembler?"),
        (device(bawd=9600), "device is900: unknown setting bawd; did you mean baud?"),
        (device(name="left", bawd=1), "device left: unknown setting bawd"),
        (device(name="a/b"), "device a/b: name is 'a/b'"),
        (device(baud="fast"), "device is900: baud is 'fast'"),
        (device(driver="is90"), "devices[0] has driver 'is90'; did you mean is900?"),
        ({"devices": [{"port": "x"}]}, "devices[0] has no driver"),
        (device(placement={"yow": 1.0}), "unknown setting yow; did you mean yaw?"),
        ({**device(), "assembler": {"rate": 0}}, "assembler: rate is 0"),
        ({**device(), "assembler": {"rate": float("nan")}}, "assembler: rate is nan"),
        ({"devices": device()["devices"] * 2}, "tracker head is reported by two devices"),
        (device(stations={"head": 13}), "1 to 12"),
        (
            {"devices": [{"driver": "vrpn", "server": "host:vrpn"}]},
            "device vrpn: server is 'host:vrpn'; give host or host:port",
        ),
        (
            {"devices": [{"driver": "vrpn", "server": "h", "stations": {"head": 3}}]},
            'give "DEVICE:SENSOR"',
        ),
        (
            {"devices": [{"driver": "replay", "file": "a.mcap"}, *device()["devices"]]},
            "let it be alone",
        ),
    ],
)
def test_what_is_wrong_is_one_sentence(values, words):
    with pytest.raises(ConfigurationError) as raised:
        SensorsConfig.parse(values, "stage.toml")
    text = str(raised.value)
    assert text.startswith("stage.toml: ")
    assert words in text
    assert "\n" not in text


def test_files_that_are_none(tmp_path):
    path = tmp_path / "stage.toml"
    with pytest.raises(ConfigurationError, match="cannot read"):
        read_config(path)
    path.write_text("[devices\n")
    with pytest.raises(ConfigurationError, match=r"is no TOML: .*line 1"):
        read_config(path)


def test_devices_without_names_are_numbered_around_those_with():
    values = [
        {"driver": "osc", "port": n, "stations": {f"t{n}": 1}, "name": "osc1" if n == 2 else ""}
        for n in range(3)
    ]
    config = SensorsConfig.parse({"devices": values})
    assert [d.name for d in config.named_devices()] == ["osc2", "osc3", "osc1"] or [
        d.name for d in config.named_devices()
    ] == ["osc2", "osc1", "osc3"]


@pytest.mark.parametrize(
    ("target", "kind", "address"),
    [
        ("/dev/ttyUSB0", "is900", "/dev/ttyUSB0"),
        ("socket://10.0.0.1:4001", "is900", "socket://10.0.0.1:4001"),
        ("vrpn://tracker:3884", "vrpn", "VRPN server tracker:3884"),
        ("is900-udp://", "is900-udp", "UDP 127.0.0.1:5001"),
        ("vrchat://0.0.0.0:9001", "osc", "UDP 0.0.0.0:9001"),
        ("vmc://", "osc", "UDP 127.0.0.1:39539"),
        ("walk.mcap", "replay", "walk.mcap"),
    ],
)
def test_devices_by_one_word(target, kind, address):
    config = device_at(target, {"head": "a:1" if kind == "vrpn" else 1})
    assert (config.kind, config.address) == (kind, address)


def test_two_ports_of_one_unit_make_one_frame():
    complete = 0
    with (
        Is900Emulator(wandering(4), stations=4) as left,
        Is900Emulator(wandering(2), stations=2) as right,
    ):
        text = TWO_PORTS.replace("/dev/ttyUSB0", left.address)
        tables = _tables(text.replace("/dev/ttyUSB1", right.address))
        config = SensorsConfig.parse({**tables, "assembler": {"delay": 1.0}})
        with TrackerInput(config) as trackers:
            for _ in range(200):
                assembled = trackers.stream.next(PATIENCE)
                assert assembled is not None
                complete += bool(assembled.frame.position_mask.all())
                if complete == 5:
                    break
    assert complete == 5


def _tables(text: str) -> dict[str, object]:
    table = tomllib.loads(text)
    return {k: table[k] for k in ("devices", "assembler", "room")}


def test_rows_follow_the_wish_of_the_caller_and_must_exist():
    config = SensorsConfig.parse(device(stations={"head": 1, "torso": 2}))
    assert TrackerInput(config, trackers=("torso", "head")).assembler.trackers == ("torso", "head")
    with pytest.raises(ConfigurationError, match="no device reports the tracker hips"):
        TrackerInput(config, trackers=("hips",))


def test_a_device_finds_its_stations_by_itself():
    with Is900Emulator(wandering(3), stations=3) as emulator:
        config = device_config({"driver": "is900", "port": emulator.address})
        assert isinstance(config, Is900Config)
        with open_device(config) as found:
            samples = found.samples.drain(PATIENCE)
    assert {s.tracker for s, _ in samples} <= {"1", "2", "3"}
    assert samples


def test_the_examples_of_the_help_are_valid():
    text = Path("sensors/config.py").read_text()
    example = text.split("```toml")[1].split("```")[0]
    assert len(SensorsConfig.parse(_tables(example)).devices) == 2
