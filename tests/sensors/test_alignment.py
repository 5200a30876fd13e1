"""Room alignment, exchanged trackers, and the file that keeps the room."""

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from sensors import rotation
from sensors.alignment import AlignmentConfig, AlignmentError, align, default_pairs
from sensors.assembler import AssemblerConfig, FrameAssembler
from sensors.cli import app
from sensors.emulators.faults import FaultMaker, Swap
from sensors.emulators.is900 import Is900Emulator
from sensors.errors import ConfigurationError
from sensors.placement import Placement
from sensors.pose import PoseSample, TrackerFrame
from sensors.toml_table import replace_table

NAMES = ("head", "torso", "lhand", "rhand", "lankle", "rankle")
# Facing +x, the left hand at +y.
STANDING = np.array(
    [
        [0.02, 0.0, 1.7],
        [0.0, 0.0, 1.35],
        [0.02, 0.3, 0.8],
        [0.02, -0.3, 0.82],
        [0.0, 0.12, 0.09],
        [0.0, -0.12, 0.07],
    ]
)


def standing(
    placement: Placement, rng: np.random.Generator, noise: float = 0.003, count: int = 40
) -> list[TrackerFrame]:
    """Frames, in the trackers' world, of the person who stands in the room as above."""
    q = np.tile(rotation.IDENTITY, (6, 1))
    p, q = placement.transform.invert(STANDING, q)
    mask = np.ones(6, dtype=bool)
    return [
        TrackerFrame(0.025 * k, p + rng.normal(0.0, noise, p.shape), q, mask, mask)
        for k in range(count)
    ]


@settings(deadline=None, max_examples=8)
@given(
    yaw=st.floats(-180.0, 180.0),
    x=st.floats(-5.0, 5.0),
    y=st.floats(-5.0, 5.0),
    z=st.floats(-2.0, 2.0),
)
def test_the_room_is_found_from_standing(yaw, x, y, z):
    truth = Placement(yaw=yaw, translation=(x, y, z))
    found = align(standing(truth, np.random.default_rng(0)), NAMES).placement
    off = math.remainder(found.yaw - yaw, 360.0)
    assert abs(off) < 0.5
    np.testing.assert_allclose(found.translation, truth.translation, atol=0.15)
    placed, _ = found.transform.apply(*truth.transform.invert(STANDING, np.eye(6, 4)))
    np.testing.assert_allclose(placed, STANDING, atol=0.02)


def test_forward_may_be_another_direction():
    frames = standing(Placement(), np.random.default_rng(0), 0.0)
    found = align(frames, NAMES, AlignmentConfig(heading=-90.0))
    placed, _ = found.placement.transform.apply(STANDING, np.eye(6, 4))
    # Facing -y, the left hand is at +x.
    assert placed[2, 0] == pytest.approx(0.3, abs=0.02)
    assert found.heights["lankle"] == pytest.approx(0.09, abs=1e-6)


def test_the_floor_may_be_kept():
    truth = Placement(yaw=20.0, translation=(1.0, 0.0, 0.5))
    frames = standing(truth, np.random.default_rng(0))
    before = Placement(translation=(0.0, 0.0, 0.25))
    found = align(frames, NAMES, AlignmentConfig(floor="keep"), before)
    assert found.placement.translation[2] == 0.25
    assert found.placement.yaw == pytest.approx(20.0, abs=1.0)


def test_who_moves_is_named():
    frames = standing(Placement(), np.random.default_rng(0))
    for k, frame in enumerate(frames):
        frame.positions[3, 0] += 0.01 * k
    with pytest.raises(AlignmentError, match="rhand moved"):
        align(frames, NAMES)


def test_a_few_outliers_are_no_motion():
    frames = standing(Placement(), np.random.default_rng(0))
    frames[7].positions[0] += 3.0
    assert abs(align(frames, NAMES).placement.yaw) < 1.0


def test_exchanged_hands_are_suspected():
    frames = standing(Placement(), np.random.default_rng(0))
    for frame in frames:
        frame.positions[[4, 5]] = frame.positions[[5, 4]]
    found = align(frames, NAMES)
    assert any("lankle and rankle" in w for w in found.warnings)


def test_without_pairs_the_direction_stays():
    frames = standing(Placement(), np.random.default_rng(0))
    few = [
        TrackerFrame(f.time, f.positions[:2], f.quaternions[:2], *(m[:2] for m in f[3:]))
        for f in frames
    ]
    found = align(few, ("head", "torso"), before=Placement(yaw=12.0))
    assert found.placement.yaw == pytest.approx(12.0)
    assert any("forward direction" in w for w in found.warnings)


def test_nobody_seen_or_unknown_names():
    frames = [f._replace(position_mask=np.zeros(6, bool)) for f in standing_still()]
    with pytest.raises(AlignmentError, match="no tracker was seen"):
        align(frames, NAMES)
    with pytest.raises(ConfigurationError, match="no tracker 'hips'"):
        align(standing_still(), NAMES, AlignmentConfig(origin="hips"))


def standing_still() -> list[TrackerFrame]:
    return standing(Placement(), np.random.default_rng(1), 0.0)


def test_pairs_are_found_by_name():
    assert default_pairs(NAMES) == (("lhand", "rhand"), ("lankle", "rankle"))
    assert default_pairs(("left_foot", "right_foot", "leg")) == (("left_foot", "right_foot"),)


def test_the_height_of_the_room_before_is_kept_on_request():
    before = Placement(yaw=5.0, translation=(0.0, 0.0, 0.4))
    frames = standing(Placement(yaw=70.0, translation=(3.0, 1.0, 0.0)), np.random.default_rng(2))
    with pytest.raises(AlignmentError):
        align([], NAMES, AlignmentConfig(floor="keep"), before)
    found = align(frames, NAMES, AlignmentConfig(floor="keep"), before).placement
    assert found.translation[2] == 0.4
    assert math.remainder(found.yaw - 70.0, 360.0) == pytest.approx(0.0, abs=1.0)


def assemble(swap: Swap, rate: float = 40.0) -> list[tuple[float, tuple[tuple[str, str], ...]]]:
    """Frames of walking trackers, two of which are exchanged for a while."""
    maker = FaultMaker([swap])
    assembler = FrameAssembler(NAMES, AssemblerConfig(rate=40.0))
    found = []
    for k in range(round(4.0 * rate)):
        t = k / rate
        sway = np.array([1.2 * t, 0.1 * math.sin(9.0 * t), 0.05 * math.sin(18.0 * t)])
        poses = [(p + sway, rotation.IDENTITY) for p in STANDING]
        for name, pose in zip(NAMES, maker.bend_all(poses, t), strict=True):
            assert pose is not None
            assembler.push(PoseSample(name, t, *pose), t + 0.002)
        found += [(a.frame.time, a.swaps) for a in assembler.poll(t + 0.004)]
    return found


@pytest.mark.parametrize("rate", [40.0, 52.0, 120.0])
def test_exchanged_trackers_are_reported_when_it_happens(rate):
    found = assemble(Swap(station=3, other=4, start=1.5, duration=1.0), rate)
    reports = [(t, s) for t, swaps in found for s in swaps]
    assert [s for _, s in reports] == [("lhand", "rhand")] * 2
    assert reports[0][0] == pytest.approx(1.5, abs=0.08)
    assert reports[1][0] == pytest.approx(2.5, abs=0.08)


def test_walking_is_no_exchange():
    found = assemble(Swap(start=100.0))
    assert len(found) > 100
    assert not any(swaps for _, swaps in found)


TOML = """# The stage on the left.
[room]  # measured in May
yaw = 1.0
# old
translation = [1.0, 2.0, 3.0]

# Two ports of one unit.
[[devices]]
driver = "is900"
port = "/dev/ttyUSB0"
stations = { head = 1 }
"""


def test_one_table_of_a_file_is_replaced_and_nothing_else(tmp_path):
    path = tmp_path / "stage.toml"
    path.write_text(TOML)
    path.chmod(0o640)
    replace_table(path, "room", {"yaw": 2.5, "translation": [0.0, 0.5, 1.0]})
    text = path.read_text()
    assert text.startswith("# The stage on the left.\n[room]\nyaw = 2.5\n")
    assert text.endswith(TOML[TOML.index("# Two ports") :])
    assert tomllib.loads(text)["room"] == {"yaw": 2.5, "translation": [0.0, 0.5, 1.0]}
    assert path.stat().st_mode & 0o777 == 0o640
    assert [p.name for p in tmp_path.iterdir()] == ["stage.toml"]


@pytest.mark.parametrize("text", ["", "[assembler]\nrate = 40.0\n", "[assembler]\nrate = 40.0"])
def test_a_missing_table_is_added(tmp_path, text):
    path = tmp_path / "stage.toml"
    path.write_text(text)
    replace_table(path, "room", {"yaw": 2.5})
    assert tomllib.loads(path.read_text()) == tomllib.loads(text) | {"room": {"yaw": 2.5}}


def test_a_table_written_otherwise_is_not_guessed_at(tmp_path):
    path = tmp_path / "stage.toml"
    path.write_text("room = { yaw = 1.0 }\n")
    with pytest.raises(ConfigurationError, match="cannot"):
        replace_table(path, "room", {"yaw": 2.5})
    assert path.read_text() == "room = { yaw = 1.0 }\n"


def test_the_command_writes_the_room(tmp_path):
    truth = Placement(yaw=35.0, translation=(0.5, -1.0, 0.2))
    p, q = truth.transform.invert(STANDING, np.tile(rotation.IDENTITY, (6, 1)))
    path = tmp_path / "stage.toml"
    with Is900Emulator(lambda t: list(zip(p, q, strict=True))) as emulator:
        stations = ", ".join(f"{name} = {n}" for n, name in enumerate(NAMES, start=1))
        path.write_text(
            f'[[devices]]\ndriver = "is900"\nport = "{emulator.address}"\n'
            f"stations = {{ {stations} }}\n"
        )
        arguments = ["align", "--config", str(path), "--seconds", "0.5", "--countdown", "0"]
        result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    room = Placement.parse(tomllib.loads(path.read_text())["room"])
    assert room.yaw == pytest.approx(35.0, abs=1.0)
    np.testing.assert_allclose(room.translation, truth.translation, atol=0.02)
