"""Configurations: those that come along, and what is said about a bad one."""

from pathlib import Path

import pytest

from localreg.errors import LocalregError
from localreg.live import config_files
from localreg.live.config import RunConfig, read_run_config
from localreg.live.config_files import find_config, shipped_configs
from sensors.errors import ConfigurationError

GOOD = """
[[devices]]
driver = "is900"
port = "/dev/ttyUSB0"
stations = { head = 1, torso = 2 }

[synthesis]
method = "paper"

[[outputs]]
protocol = "vmc"
port = 40000
"""


def read(tmp_path: Path, text: str) -> RunConfig:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    return read_run_config(file)


@pytest.mark.parametrize("name", ["is900", "is900-udp", "vrpn", "osc", "demo", "paper"])
def test_what_comes_along_is_good(name: str):
    config = read_run_config(find_config(name))
    assert config.trackers == ("head", "torso", "lhand", "rhand", "lankle", "rankle")
    assert config.outputs[0].protocol == "vmc"


def test_a_list_of_what_comes_along_holds_configurations_only():
    assert set(shipped_configs()) == {"is900", "is900-udp", "vrpn", "osc", "demo", "paper"}


def test_a_file_is_found_by_its_path(tmp_path: Path):
    file = tmp_path / "mine.toml"
    file.write_text(GOOD)
    assert find_config(str(file)) == file
    with pytest.raises(LocalregError, match=r"no configuration file .*yours\.toml"):
        find_config(str(tmp_path / "yours.toml"))


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(LocalregError, match=r"named 'is90'; did you mean is900\?"):
        find_config("is90")
    with pytest.raises(LocalregError, match="there are demo, is900"):
        find_config("kinect")


def test_the_folder_inside_an_installed_package_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "stage.toml").write_text(GOOD)
    monkeypatch.setattr(config_files, "_FOLDERS", (tmp_path, *config_files._FOLDERS))
    assert find_config("stage") == tmp_path / "stage.toml"


def test_every_table_is_read(tmp_path: Path):
    config = read(tmp_path, GOOD + "\n[performance]\ncoast = 0.2\n")
    assert config.synthesis.method == "paper"
    assert config.outputs[0].model_dump() == {
        "protocol": "vmc",
        "host": "127.0.0.1",
        "port": 40000,
    }
    assert config.performance.coast == 0.2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('method = "paper"', 'metod = "paper"'), "metod; did you mean method"),
        (("[synthesis]", "[sinthesis]"), "sinthesis.*did you mean synthesis"),
        (('protocol = "vmc"', 'protocol = "vcm"'), "did you mean vmc"),
        (("port = 40000", "prot = 40000"), "prot.*did you mean port"),
        (("port = 40000", "port = 400000"), "port.*65535"),
        (('driver = "is900"', 'driver = "is90"'), "did you mean is900"),
        (("head = 1", "head = 2"), "station of its own"),
        (("[synthesis]", "[emulator]\n[synthesis]"), 'port = "emulator"; give both'),
        (("/dev/ttyUSB0", "emulator"), 'port = "emulator"; give both'),
        (("torso = 2 }", "torso = 2"), "no TOML"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(change: tuple[str, str], words: str, tmp_path: Path):
    with pytest.raises(ConfigurationError, match=words) as caught:
        read(tmp_path, GOOD.replace(*change))
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_emulator_gives_its_device_a_port():
    config = read_run_config(find_config("demo")).with_port("/dev/pts/7")
    assert [getattr(device, "port", "") for device in config.devices] == ["/dev/pts/7"]
    assert config.emulator is None


def test_the_rate_is_the_databases_unless_the_file_says_another(tmp_path: Path):
    plain = read(tmp_path, GOOD + "\n[assembler]\ndelay = 0.02\n")
    assert (plain.at_rate(60.0).assembler.rate, plain.at_rate(60.0).assembler.delay) == (60.0, 0.02)
    fixed = read(tmp_path, GOOD + "\n[assembler]\nrate = 50.0\n")
    assert fixed.at_rate(60.0).assembler.rate == 50.0
