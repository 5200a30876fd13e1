"""Files read by several processes make the same database as by one."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from localreg.database import PoseDatabase
from localreg.database.store import prepare
from localreg.errors import MotionError
from localreg.motion.formats import write_motion
from localreg.motion.sources import iterate_sources
from tests.localreg.database.made_motion import make_motion


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("motions")
    for number in range(7):
        write_motion(make_motion(number, 60 + 20 * number), folder / f"{number}.bvh")
    (folder / "bad.bvh").write_text("HIERARCHY\nnothing more")
    return folder


def test_the_same_whatever_the_number_of_processes(folder: Path) -> None:
    plain = list(iterate_sources([folder]))
    told: list[tuple[int, int]] = []
    prepared = list(
        iterate_sources(
            [folder], jobs=2, prepare=partial(prepare, rate=40.0),
            progress=lambda done, total, what: told.append((done, total)),
        )
    )  # fmt: skip
    assert [entry for _, entry in prepared] == [entry for _, entry in plain]
    assert [motion.rate for motion, _ in prepared if motion is not None] == [40.0] * 7
    assert told[-1] == (8, 8)
    one = PoseDatabase.build([motion for motion, _ in plain if motion is not None])
    other = PoseDatabase.build(
        [motion for motion, _ in prepared if motion is not None], prepared=True
    )
    assert one.clips == other.clips
    np.testing.assert_array_equal(one.angles, other.angles)
    np.testing.assert_array_equal(one.roots, other.roots)


def test_a_bad_file_that_was_asked_for_is_an_error(folder: Path) -> None:
    files = [folder / "0.bvh", folder / "bad.bvh"]
    with pytest.raises(MotionError, match=r"bad\.bvh"):
        list(iterate_sources(files, jobs=2))
