"""A thousand damaged files of every kind: a motion or one clear sentence, in bounded time."""

import resource
import time
import zipfile

import numpy as np
import pytest

from localreg.errors import MotionError
from localreg.motion.formats import read_motion
from localreg.motion.formats.text import LARGEST_FILE
from localreg.motion.sources import read_sources
from sensors.recording import Recorder
from tests.localreg.motion.foreign_files import write_bvh
from tests.localreg.motion.strategies import make_calm_motion
from tests.localreg.motion.test_foreign_formats import smpl_arrays, write_markers, write_mvnx

KINDS = (
    "cut", "bytes", "binary", "shuffled", "huge", "words", "repeated", "empty numbers",
)  # fmt: skip
HUGE = (b"1e308", b"-9" + b"9" * 300, b"nan", b"1e-320", b"99999999999", b"-1e9", b"2147483648")
WORDS = (b"{", b"}", b"JOINT a {", b"End Site", b"MOTION", b"<frame>", b"\x00", b"CHANNELS 6")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """One sound small file of every kind that is read."""
    from localreg.body.subject import write_subject
    from localreg.motion.formats import write_motion

    folder = tmp_path_factory.mktemp("sound")
    motion = make_calm_motion(3, count=4)
    for suffix in (".amc", ".bvh", ".trc", ".mot"):
        write_motion(motion, folder / f"x{suffix}")
    write_bvh(folder / "y.bvh", motion, "Mixamo")
    write_markers(folder / "x.c3d", motion)
    write_mvnx(folder / "x.mvnx", motion)
    poses, trans = smpl_arrays(motion)
    np.savez(folder / "x.npz", poses=poses, trans=trans, mocap_framerate=40.0)
    write_subject(motion.subject, folder / "s.toml")
    with Recorder(folder / "x.mcap") as recorder:
        schema = {"type": "object"}
        take = recorder.channel("/take", "localreg.Take", schema)
        poses = recorder.channel("/poses", "localreg.Pose", schema)
        take.write({"version": 1, "subject": (folder / "s.toml").read_text()}, 0.0)
        for index, qpos in enumerate(motion.qpos):
            poses.write({"index": index, "time": index / 40, "qpos": qpos.tolist()}, index / 40)
    (folder / "s.toml").unlink()
    return folder


def mutate(data, kind, rng):
    """The data damaged in one of several ways."""
    size = len(data)
    if kind == "cut":
        return data[: rng.integers(0, size)]
    if kind == "bytes":
        out = bytearray(data)
        reach = size if rng.random() < 0.5 else min(size, 2000)
        for _ in range(rng.integers(1, 30)):
            out[rng.integers(0, reach)] = rng.integers(0, 256)
        return bytes(out)
    if kind == "binary":
        start = int(rng.integers(0, size))
        return data[:start] + rng.bytes(int(rng.integers(1, 3000))) + data[start:]
    if kind in ("huge", "words", "empty numbers"):
        words = data.split(b" ")
        for _ in range(rng.integers(1, 6)):
            place = int(rng.integers(0, len(words)))
            choice = HUGE if kind == "huge" else WORDS if kind == "words" else (b"", b"-", b".")
            words[place] = choice[rng.integers(0, len(choice))]
        return b" ".join(words)
    lines = data.split(b"\n")
    if kind == "repeated":
        start, count = int(rng.integers(0, len(lines))), int(rng.integers(1, 40))
        return b"\n".join(lines[:start] + lines[start : start + count] * 3 + lines[start:])
    order = rng.permutation(len(lines))
    keep = rng.random(len(lines)) < 0.5
    mixed = [lines[o] if k else line for line, o, k in zip(lines, order, keep, strict=True)]
    return b"\n".join(mixed)


@pytest.mark.parametrize("name", ["x.amc", "x.asf", "x.bvh", "y.bvh", "x.c3d", "x.trc", "x.mot",
                                  "x.npz", "x.mvnx", "x.mcap"])  # fmt: skip
def test_a_hundred_damaged_files_of_a_kind(sound, tmp_path, name):
    data = (sound / name).read_bytes()
    for other in ("x.amc", "x.asf"):
        (tmp_path / other).write_bytes((sound / other).read_bytes())
    target = tmp_path / ("x.amc" if name == "x.asf" else name)
    assert len(read_motion(sound / target.name)) == 1
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    told = 0
    for seed in range(104):
        rng = np.random.default_rng([seed, *name.encode()])
        (tmp_path / name).write_bytes(mutate(data, KINDS[seed % len(KINDS)], rng))
        started = time.process_time()
        try:
            motions = read_motion(target)
        except MotionError as error:
            told += 1
            message = str(error)
            assert str(tmp_path) in message, message
            assert "\n" not in message, message
            assert len(message) < 400 + len(str(tmp_path)), message
        else:
            assert all(np.all(np.isfinite(motion.qpos)) for motion in motions)
        assert time.process_time() - started < 20.0, (name, seed)
    assert told >= 20  # the rest still reads: numbers and names may change unseen
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 600_000, f"{name} took {grown} KiB more"


def check_quick(path, match):
    started = time.process_time()
    with pytest.raises(MotionError, match=match) as caught:
        read_motion(path)
    assert time.process_time() - started < 20.0
    assert "\n" not in str(caught.value)


def test_ten_thousand_nested_joints(tmp_path):
    joints = "".join(f"JOINT j{i}\n{{\nOFFSET 0 1 0\nCHANNELS 1 Xrotation\n" for i in range(10_000))
    head = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
    row = " ".join(["0"] * 10_001)
    text = f"{head}{joints}{'}' * 10_001}\nMOTION\nFrames: 1\nFrame Time: 0.1\n{row}\n"
    (tmp_path / "x.bvh").write_text(text)
    check_quick(tmp_path / "x.bvh", "line 8002: more than 2000 joints")
    (tmp_path / "y.bvh").write_text(" ".join(text.split()))
    check_quick(tmp_path / "y.bvh", "more than 2000 joints")
    (tmp_path / "z.bvh").write_text("HIERARCHY ROOT r " + "{ " * 500_000)
    check_quick(tmp_path / "z.bvh", "not known in a hierarchy")


def test_heads_that_promise_too_much(tmp_path):
    bvh = "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 999999999999 Xrotation\n}\nMOTION\n"
    (tmp_path / "x.bvh").write_text(bvh)
    check_quick(tmp_path / "x.bvh", "is unknown or given twice")
    with (tmp_path / "y.bvh").open("wb") as file:
        file.truncate(LARGEST_FILE + 1)  # a sparse file: nothing is written
    check_quick(tmp_path / "y.bvh", "more than 1; cut it into takes")
    head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000, 156), }"
    array = b"\x93NUMPY\x01\x00" + len(head.ljust(117) + b"\n").to_bytes(2, "little")
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        archive.writestr("poses.npy", array + head.ljust(117) + b"\n" + bytes(1000))
    check_quick(tmp_path / "x.npz", "no archive of NumPy arrays that can be read")


def test_a_folder_of_damage_says_of_every_file_why(sound, tmp_path):
    rng = np.random.default_rng(0)
    for name in ("y.bvh", "x.trc", "x.mot", "x.mvnx", "x.npz", "x.c3d"):
        (tmp_path / f"bad_{name}").write_bytes((sound / name).read_bytes()[:700])
    (tmp_path / "noise.bvh").write_bytes(rng.bytes(5000))
    (tmp_path / "good.bvh").write_bytes((sound / "y.bvh").read_bytes())
    (tmp_path / "alone.asf").write_bytes((sound / "x.asf").read_bytes())
    (tmp_path / "notes.txt").write_text("no motion")
    motions, report = read_sources([tmp_path])
    assert [motion.provenance.name for motion in motions] == ["good"]
    assert len(report.skipped) == 7
    assert all(str(tmp_path) in entry.skipped for entry in report.skipped)
    assert {(entry.source.rpartition("/")[2], entry.skipped) for entry in report.others} == {
        ("alone.asf", "a skeleton that no motion uses"),
        ("notes.txt", ".txt: not a motion file"),
    }
