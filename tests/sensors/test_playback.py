import json
import pickle
import zipfile

import numpy as np
import pytest
from typer.testing import CliRunner

from sensors import rotation
from sensors.cli import app
from sensors.emulators.source import Playback, looped, wandering
from sensors.errors import PlaybackError


def motion(T: int = 5, J: int = 2) -> Playback:
    times = 0.1 * np.arange(T) + 3.0
    positions = np.zeros((T, J, 3))
    positions[:, :, 0] = np.arange(T)[:, None]
    angles = 0.2 * np.arange(T)[:, None] * np.array([0.0, 0.0, 1.0])
    q = rotation.from_rotation_vector(angles)
    return Playback(times, positions, np.repeat(q[:, None], J, axis=1), ("head", "pelvis")[:J])


def test_file_round_trip(tmp_path):
    motion().save(tmp_path / "walk.npz")
    again = Playback.load(tmp_path / "walk.npz")
    assert again.names == ("head", "pelvis")
    np.testing.assert_array_equal(again.positions, motion().positions)
    assert again.duration == pytest.approx(0.4)


def test_poses_are_interpolated_and_held_at_the_ends():
    m = motion()
    for t, x in ((-1.0, 0.0), (0.0, 0.0), (0.15, 1.5), (0.4, 4.0), (9.0, 4.0)):
        p, q = m.pose_at(t)[1]
        assert p[0] == pytest.approx(x)
        assert rotation.to_euler(q)[0] == pytest.approx(0.2 * x)


def test_one_row_is_a_still_motion():
    p, _ = motion(T=1).pose_at(1.0)[0]
    np.testing.assert_array_equal(p, [0, 0, 0])


def test_loop_starts_again():
    again = looped(motion().pose_at, 0.4)
    np.testing.assert_allclose(again(0.55)[0][0], motion().pose_at(0.15)[0][0])


def test_wandering_moves_smoothly():
    source = wandering(6)
    a, b = source(1.0), source(1.025)
    assert len(a) == 6
    for (p, q), (p2, q2) in zip(a, b, strict=True):
        assert 0.001 < np.linalg.norm(p2 - p) < 0.05
        assert float(rotation.angle_between(q, q2)) < 0.1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"times": np.array([0.0, 0.0, 1.0, 2.0, 3.0])}, "increasing"),
        ({"times": np.zeros(3)}, "shape"),
        ({"positions": np.full((5, 2, 3), np.nan)}, "finite"),
        ({"quaternions": np.zeros((5, 2, 4))}, "unit length"),
        ({"quaternions": np.zeros((5, 2, 3))}, "shape"),
        ({"names": np.array([1, 2])}, "text"),
        ({"names": np.array(["n"] * 13)}, "1 to 12"),
        ({"positions": None}, "lacks positions"),
        ({"names": np.array([{"a": 1}, 2], dtype=object)}, "cannot be played"),
    ],
)
def test_files_that_are_no_motion_are_refused_in_words(tmp_path, change, words):
    m = motion()
    arrays = {
        "times": m.times,
        "positions": m.positions,
        "quaternions": m.quaternions,
        "names": np.array(m.names),
    }
    arrays.update(change)
    path = tmp_path / "bad.npz"
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    with pytest.raises(PlaybackError, match=words):
        Playback.load(path)


class Explosive:
    def __reduce__(self):
        return (pytest.fail, ("a playback file was unpickled",))


def test_nothing_is_unpickled(tmp_path):
    for name, data in (
        ("a.npz", pickle.dumps(Explosive())),
        ("b.npz", b"not an archive"),
        ("c.npz", b""),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(PlaybackError, match="cannot be played"):
            Playback.load(tmp_path / name)
    with zipfile.ZipFile(tmp_path / "d.npz", "w") as archive:
        for key in ("times", "positions", "quaternions", "names"):
            archive.writestr(f"{key}.npy", b"garbage")
    with pytest.raises(PlaybackError):
        Playback.load(tmp_path / "d.npz")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["emulate", "/nowhere/walk.npz"], "cannot be played"),
        (["emulate", "--start", "soon"], "continuous, now, later"),
        (["emulate", "--at-end", "explode"], "hold, loop, exit"),
        (["emulate", "--rate", "0"], "rate is 0"),
        (["emulate", "--stations", "13"], "1 to 12"),
        (["emulate", "--fault", "fire"], "no fault is called"),
        (["emulate", "--tcp", "here"], "host:port"),
        (["emulate", "--protocol", "morse"], "is900, is900-udp, vrpn, vmc, vrchat"),
        (["monitor", "/dev/nope"], "cannot open /dev/nope: there is no such port"),
        (["monitor"], "name either a device"),
        (["monitor", "socket://127.0.0.1:9", "--station", "head"], "write tracker=station"),
        (["monitor", "vmc://127.0.0.1:tea"], "has no port"),
        (["record", "/nowhere/walk.mcap", "/dev/nope"], "no such port"),
        (["replay", "/nowhere/walk.mcap"], "cannot read /nowhere/walk.mcap"),
        (["replay", "/dev/null", "--check"], "holds no tracker data"),
        (["align", "--config", "/nowhere/walk.toml"], "cannot read /nowhere/walk.toml"),
    ],
)
def test_wrong_use_is_one_sentence_and_exit_code_one(arguments, words):
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 1
    assert words in result.stderr
    assert result.stderr.startswith("error: ")
    assert "Traceback" not in result.output


def test_ports_are_listed():
    result = CliRunner().invoke(app, ["list"])
    assert result.exit_code == 0
    assert result.stdout.strip()


def test_help_names_the_events():
    result = CliRunner().invoke(app, ["emulate", "--help"])
    assert result.exit_code == 0
    assert json.dumps("start").strip('"') in result.stdout
