"""What the buttons of the view write."""

import csv
from pathlib import Path

import numpy as np
import pytest

from localreg.body.subject import canonical_subject
from localreg.database.store import PoseDatabase
from localreg.live.nearest_clips import Example, NearestClips
from localreg.live.takes import MARKS, Takes
from localreg.motion.formats.registry import read_motion
from sensors.recording import Recorder, read_recording
from tests.localreg.database.made_motion import make_motion
from tests.localreg.live.poses import live_pose

SUBJECT = canonical_subject()
RATE = 40.0


def poses(count: int, begin: int = 0):
    qpos = make_motion(7, frames=400, rate=RATE).qpos
    return [live_pose(SUBJECT, qpos[n], n) for n in range(begin, begin + count)]


def test_a_take_is_what_came_between_two_presses(tmp_path: Path):
    told: list[str] = []
    takes = Takes(tmp_path / "takes", SUBJECT, RATE, told.append, capacity=100)
    for live in poses(5):
        takes.publish(live)
    assert not takes.is_recording
    takes.record()
    assert takes.is_recording
    assert takes.note.startswith("recording take-")
    for live in poses(7, begin=5):
        takes.publish(live)
    takes.record()
    assert not takes.is_recording
    (file,) = (tmp_path / "takes").iterdir()
    (motion,) = read_motion(file)
    assert len(motion) == 7
    assert told == [f"recorded: {file}"]
    assert takes.note == f"recorded {file.name}"


def test_what_is_being_recorded_is_finished_at_the_end(tmp_path: Path):
    takes = Takes(tmp_path, SUBJECT, RATE, lambda words: None, capacity=10)
    takes.record()
    for live in poses(3):
        takes.publish(live)
    takes.close()
    takes.close()
    (file,) = tmp_path.iterdir()
    assert len(read_motion(file)[0]) == 3


def test_takes_of_one_second_have_names_of_their_own(tmp_path: Path):
    takes = Takes(tmp_path, SUBJECT, RATE, lambda words: None, capacity=10)
    for _ in range(3):
        takes.record()
        takes.publish(poses(1)[0])
        takes.record()
    assert len(list(tmp_path.iterdir())) == 3


def test_marks_go_to_a_table_and_into_the_recording(tmp_path: Path):
    with Recorder(tmp_path / "run.mcap") as recorder:
        takes = Takes(tmp_path, SUBJECT, RATE, print, recorder=recorder, capacity=10)
        takes.mark()
        assert takes.note == "there is no frame to mark yet"
        for live in poses(5):
            takes.publish(live)
            if live.instant in (1, 4):
                takes.mark()
        takes.close()
    assert takes.note == "marked frame 4 in marks.csv"
    with (tmp_path / "marks.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert rows == [{"frame": "1", "seconds": "0.025"}, {"frame": "4", "seconds": "0.100"}]
    marked = [message.data["index"] for message in read_recording(tmp_path / "run.mcap", (MARKS,))]
    assert marked == [1, 4]


def test_the_whole_run_is_exported_by_a_process_of_its_own(tmp_path: Path):
    told: list[str] = []
    takes = Takes(tmp_path, SUBJECT, RATE, told.append, capacity=100)
    takes.export()
    assert takes.note == "there is no frame to export yet"
    published = poses(12)
    for live in published:
        takes.publish(live)
    takes.export()
    takes.close()
    (file,) = tmp_path.iterdir()
    assert told == [f"exported: {file}"]
    (motion,) = read_motion(file)
    assert len(motion) == 12
    np.testing.assert_allclose(motion.qpos[3, :3], published[3].pose.qpos[:3], atol=1e-4)


@pytest.fixture(scope="module")
def database() -> PoseDatabase:
    motions = [make_motion(seed, name=f"clip-{seed}", activity="walk") for seed in range(4)]
    return PoseDatabase.build(motions, rate=RATE, mirror=False)


def test_the_clip_of_a_pose_is_nearest_to_it(database: PoseDatabase):
    nearest = NearestClips(database)
    for clip in database.clips:
        row = clip.start + clip.length // 2
        qpos = np.concatenate([np.zeros(7), database.angles[row].astype(float)])
        allowed = np.arange(len(database)) == row
        (found,), nearest_row = nearest.find(qpos, allowed)
        assert nearest_row == row
        assert (found.name, found.activity, found.share) == (clip.name, "walk", 1.0)
        anywhere, nearest_row = nearest.find(qpos)
        assert nearest_row == row
        assert sum(clip.share for clip in anywhere) <= 1.0 + 1e-9
        assert anywhere[0].share == max(clip.share for clip in anywhere)


def test_where_nothing_is_allowed_nothing_is_near(database: PoseDatabase):
    nothing = np.zeros(len(database), dtype=bool)
    assert NearestClips(database).find(np.zeros(63), nothing) == ((), -1)


def test_an_example_goes_on_as_its_clip_does_until_it_is_over(database: PoseDatabase):
    example, clip = Example(database), database.clips[1]
    qpos = np.arange(63.0)
    assert example.at(qpos, 5.0) is None
    example.begin(clip.stop - 4, 5.0)
    for frames in range(4):
        shown = example.at(qpos, 5.0 + frames / RATE)
        assert shown is not None
        np.testing.assert_array_equal(shown[:7], qpos[:7])
        np.testing.assert_allclose(shown[7:], database.angles[clip.stop - 4 + frames])
    assert example.at(qpos, 5.0 + 4 / RATE) is None
    assert example.at(qpos, 4.9) is None
    example.begin(-1, 6.0)
    assert example.at(qpos, 6.0) is None
