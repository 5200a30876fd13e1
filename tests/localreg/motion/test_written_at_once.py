"""Every kind of file: written whole or not at all, or a sentence that says why."""

import resource
from contextlib import contextmanager

import numpy as np
import pytest

from localreg.errors import MotionError
from localreg.motion.formats import writable_suffixes, write_motion
from localreg.motion.formats.atomic import written_at_once
from tests.localreg.motion.strategies import make_calm_motion

SUFFIXES = writable_suffixes()


@contextmanager
def no_file_larger_than(size):
    """What a full disk does, done to this process: writing fails beyond a size."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_costs_one_sentence_and_leaves_what_was_there(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    write_motion(make_calm_motion(0, count=1), path)
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    motion = make_calm_motion(0, count=400)
    with no_file_larger_than(100_000), pytest.raises(MotionError, match="cannot write"):
        write_motion(motion, path)
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before
    write_motion(motion, path)
    assert path.read_bytes() != before[path] or suffix == ".osim"


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_one_frame_is_enough_and_none_is_too_few(tmp_path, suffix):
    motion = make_calm_motion(1, count=1)
    write_motion(motion, tmp_path / f"x{suffix}")
    assert (tmp_path / f"x{suffix}").stat().st_size > 100
    with pytest.raises(MotionError, match="no frames"):
        write_motion(motion.first(0), tmp_path / f"y{suffix}")
    assert not list(tmp_path.glob("y*"))


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_number_that_is_none_is_refused(tmp_path, suffix):
    motion = make_calm_motion(2, count=5)
    motion.qpos[3, 20] = np.nan  # arrays can be written to, whatever was checked before
    with pytest.raises(MotionError, match="frame 3 has a number that is not finite"):
        write_motion(motion, tmp_path / f"x{suffix}")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_folder_in_the_way_is_said(tmp_path, suffix):
    path = tmp_path / f"x{suffix}"
    path.mkdir()
    with pytest.raises(MotionError, match="cannot write"):
        write_motion(make_calm_motion(3, count=2), path)
    assert list(tmp_path.glob(".*")) == []


def test_files_replace_older_ones_with_usual_rights(tmp_path):
    path = tmp_path / "x.bvh"
    for seed in (4, 5):
        write_motion(make_calm_motion(seed, count=2), path)
    other = tmp_path / "plain"
    other.write_text("")
    assert path.stat().st_mode == other.stat().st_mode
    assert sorted(file.name for file in tmp_path.iterdir()) == ["plain", "x.bvh"]


def test_nothing_takes_its_place_when_a_writer_fails(tmp_path):
    (tmp_path / "x").write_text("old")

    def fail():
        with written_at_once(tmp_path / "x") as temporary:
            temporary.write_text("new")
            temporary.with_name("y").write_text("new")
            raise ValueError

    with pytest.raises(ValueError):  # noqa: PT011
        fail()
    assert [file.name for file in tmp_path.iterdir()] == ["x"]
    assert (tmp_path / "x").read_text() == "old"
