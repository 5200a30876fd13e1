"""Damaged files of every kind: either they still read, or the error is one of ours."""

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localreg.errors import MotionError
from localreg.motion.formats import read_motion, write_motion
from tests.localreg.motion.strategies import make_calm_motion

WORDS = [
    b"",
    b"nan",
    b"-",
    b"1e999",
    b"{",
    b"}",
    b"\n",
    b"\r",
    b"#",
    b":",
    b"\xff\x00",
    b"1 2",
    b"-inf",
]
WORDS += [
    b"root",
    b"MOTION",
    b"JOINT x",
    b"begin",
    b"end",
    b"0",
    b"9" * 400,
    b"9" * 5000,
    b"1e200",
    b"-1e308",
    b"\xc2\xb2",
]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("damage")
    motion = make_calm_motion(3, count=3)
    for suffix in (".amc", ".bvh"):
        write_motion(motion, folder / f"x{suffix}")
    return folder


@pytest.mark.parametrize("suffix", [".amc", ".asf", ".bvh"])
@settings(max_examples=60, deadline=None)
@given(
    places=st.lists(
        st.tuples(st.floats(0, 1), st.integers(0, 40), st.sampled_from(WORDS)), max_size=3
    ),
    cut=st.one_of(st.none(), st.floats(0, 1)),
)
def test_damage_ends_in_a_motion_or_in_words(tmp_path_factory, sound, suffix, places, cut):
    data = (sound / f"x{suffix}").read_bytes()
    for place, length, word in places:
        start = int(place * len(data))
        data = data[:start] + word + data[start + length :]
    if cut is not None:
        data = data[: int(cut * len(data))]
    folder = tmp_path_factory.mktemp("x")
    for other in (".amc", ".asf"):
        shutil.copy(sound / f"x{other}", folder)
    (folder / f"x{suffix}").write_bytes(data)
    path = folder / ("x.bvh" if suffix == ".bvh" else "x.amc")
    motions, words = [], ""
    try:
        motions = read_motion(path)
    except MotionError as error:
        words = str(error)
    assert bool(words) != bool(motions)
    assert not words or (str(folder) in words and "\n" not in words)
    assert all(len(motion) > 0 and np.all(np.isfinite(motion.qpos)) for motion in motions)


@settings(max_examples=60, deadline=None)
@given(data=st.binary(max_size=300), suffix=st.sampled_from([".amc", ".asf", ".bvh"]))
def test_any_bytes_end_in_words(tmp_path_factory, sound, data, suffix):
    folder = tmp_path_factory.mktemp("x")
    shutil.copy(sound / "x.asf", folder)
    shutil.copy(sound / "x.amc", folder)
    (folder / f"x{suffix}").write_bytes(data)
    with pytest.raises(MotionError):
        read_motion(folder / ("x.bvh" if suffix == ".bvh" else "x.amc"))
