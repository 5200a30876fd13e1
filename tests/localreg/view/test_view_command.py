"""`localreg view` at work: a minute of AMC played, scrubbed and filmed; takes; side by side."""

import os
import re
import signal
import subprocess
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from localreg.cli import app
from localreg.commands.view_files import read_footage, read_take
from localreg.database.store import PoseDatabase
from localreg.drawing.offscreen import ADVICE, working_backend
from localreg.errors import LocalregError
from localreg.live.database_choice import ChosenDatabase
from localreg.live.performance_config import PerformanceConfig
from localreg.live.sinks import LivePose
from localreg.live.take import TakeRecorder
from localreg.motion.formats import read_motion, write_motion
from localreg.synthesis.estimator import Pose, Result
from localreg.synthesis.settings import METHODS
from localreg.view.file_source import FileSource
from localreg.view.footage import Footage
from localreg.view.moment import Observer
from sensors.assembler import AssembledFrame
from sensors.recording import Recorder
from tests.localreg.view.walking import walking

run = CliRunner().invoke
RATE, SECONDS = 120.0, 60


@pytest.fixture(scope="module")
def minute(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A minute of AMC: real motion where it is at hand, one after another of one person."""
    motion = walking(SECONDS, RATE)
    if folder := os.environ.get("LOCALREG_MOTIONS"):
        trials = [Path(folder) / f"cmu/subjects/01/01_{trial}.amc" for trial in ("06", "07")]
        real = [read_motion(trial)[0] for trial in trials]
        qpos = np.concatenate([one.qpos for one in real])[: len(motion)]
        motion = replace(real[0], qpos=qpos)
    assert len(motion) == SECONDS * RATE
    path = tmp_path_factory.mktemp("minute") / "minute.amc"
    write_motion(motion, path)
    return path


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walk") / "walk.bvh"
    write_motion(walking(0.5), path)
    return path


@pytest.fixture
def _graphics() -> None:
    if not working_backend():
        pytest.skip(ADVICE)


def test_a_minute_of_amc_plays_to_the_end_and_scrubs(minute: Path) -> None:
    now = 0.0
    footage = read_footage(str(minute))
    source = FileSource(footage, now=lambda: now)
    assert source.transport is not None
    assert source.transport.seconds == pytest.approx(SECONDS - 1 / RATE)
    seen, elapsed = [], 0
    while source.transport.is_playing:
        seen.append(source.newest().index)
        now += 0.2
        elapsed += 1
    assert elapsed == pytest.approx(SECONDS / 0.2, abs=2)
    assert seen[0] == 0
    assert np.all(np.diff(seen) > 0)
    assert source.newest().index == SECONDS * RATE - 1
    for time in (31.7, 2.0, 59.0, 0.0):
        source.transport.time = time
        moment = source.newest()
        assert moment.time == pytest.approx(time, abs=1 / RATE)
        np.testing.assert_array_equal(moment.qpos, footage.motion.qpos[moment.index])


@pytest.mark.usefixtures("_graphics")
def test_a_minute_of_amc_becomes_a_video_of_a_minute(minute: Path, tmp_path: Path) -> None:
    out = tmp_path / "minute.mp4"
    arguments = ["--video", str(out), "--size", "96x72", "--fps", "0.5", "--no-trails"]
    result = run(app, ["view", str(minute), *arguments])
    assert result.exit_code == 0, result.output
    assert "30 pictures at 0.5 Hz, 60.0 s of minute" in result.stdout
    with av.open(str(out)) as container:
        pictures = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
        assert container.duration == pytest.approx(60e6, rel=0.02)
    assert len(pictures) == 30
    body = [float((p[..., 2].astype(int) - p[..., 0] > 25).mean()) for p in pictures]
    assert min(body) > 0.01, "the body is on every picture"


@pytest.mark.usefixtures("_graphics")
def test_two_motions_side_by_side_as_a_picture(walk: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "both.png"
    arguments = ["--beside", str(walk), "--png", str(out), "--size", "240x120", "--frame", "3"]
    result = run(app, ["view", str(walk), *arguments, "--look", "diamonds", "--labels"])
    assert result.exit_code == 0, result.output
    assert "frame 3 of walk" in result.stdout
    picture = np.asarray(Image.open(out)).astype(int)
    assert picture.shape == (120, 240, 3)
    green, blue = picture[..., 1] - picture[..., 0], picture[..., 2] - picture[..., 0]
    assert (green[:, :118] > 20).sum() > 50
    assert (blue[:, 122:] > 40).sum() > 50


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--size", "wide", "--png", "a.png"], "write it as 1280x720"),
        (["--size", "63x63", "--png", "a.png"], "give even numbers from 64 on"),
        (["--video", "a.avi"], "a.avi must end in .mp4"),
        (["--png", "a.mp4"], "a.mp4 must end in .png"),
        (["--beside", "b.bvh"], "add --png or --video"),
        (["--frame", "99", "--png", "a.png", "--size", "64x64"], "the last is 19"),
        (["--clip", "other", "--png", "a.png"], "holds no clip other; it has walk"),
        (["--look", "ghostly"], "'capsules', 'sticks', 'diamonds'"),
    ],
)
def test_wrong_use_is_one_sentence(walk: Path, arguments: list[str], words: str) -> None:
    result = run(app, ["view", str(walk), *arguments])
    assert result.exit_code in (1, 2)
    assert words in " ".join(result.output.split()).replace("│ ", "")


def test_a_take_shows_what_the_trackers_said_and_how_sure_the_poses_are(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    motion = walking(0.5)
    observer = Observer(motion.subject)
    with Recorder(path) as recorder:
        log = TakeRecorder(recorder)
        poses = PoseDatabase.build([motion])
        chosen = ChosenDatabase(poses, "identity", "made up", motion.subject)
        log.begin("localreg", METHODS["localreg"], PerformanceConfig(), motion.subject, chosen)
        for index, qpos in enumerate(motion.qpos):
            when = 10.0 + index / 40.0
            frame = observer.worn(when, qpos)
            frame = frame._replace(positions=frame.positions + np.array([0.02, 0.0, 0.0]))
            if index == 5:
                frame.position_mask[2] = frame.orientation_mask[2] = False
            assembled = AssembledFrame(frame, when, when, index)
            recorder.frame(assembled, 0)
            if index == 8:
                log.passed_over(assembled)
                continue
            pose = Pose(when, qpos, np.zeros(6), np.zeros(6), 0.75, np.zeros(56), 3, Result.SOLVED)
            is_start = index == 0
            log.taken(assembled, "none", LivePose(index, frame, pose, index == 6, is_start))
    footage = read_take(path)
    np.testing.assert_array_equal(footage.motion.qpos[:8], motion.qpos[:8])
    np.testing.assert_array_equal(footage.motion.qpos[8], motion.qpos[7])
    assert len(footage.motion) == 20
    assert footage.motion.rate == 40.0
    assert footage.held is not None
    assert np.flatnonzero(footage.held).tolist() == [6, 8]
    source = FileSource(footage, now=lambda: 0.0)
    assert source.transport is not None
    source.transport.is_playing = False
    source.transport.time = 5 / 40
    moment = source.newest()
    assert moment.confidence == 0.75
    assert [t.name for t in moment.trackers if t.is_masked] == [motion.subject.trackers[2]]
    others = [t.distance for t in moment.trackers if not t.is_masked]
    np.testing.assert_allclose(others, 0.02, atol=1e-9)


def test_a_recording_without_a_body_says_how_to_make_one(tmp_path: Path) -> None:
    path = tmp_path / "trackers.mcap"
    with Recorder(path):
        pass
    with pytest.raises(LocalregError, match="localreg synthesize can make some"):
        read_footage(str(path))


def test_a_file_in_a_browser_is_served_where_it_says_and_ends_by_interrupt(walk: Path) -> None:
    command = [sys.executable, "-m", "localreg", "view", str(walk), "--web", "--port", "0"]
    process = subprocess.Popen(
        [*command, "--look", "sticks", "--camera", "left"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        while line and "http://" not in line:
            line = process.stdout.readline()
        found = re.search(r"look at walk .*on (http://127\.0\.0\.1:\d+/)", line)
        assert found, line
        with urllib.request.urlopen(found[1], timeout=60) as answer:  # noqa: S310
            assert answer.status == 200
            assert b"<html" in answer.read().lower()
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def test_ghosts_are_read_from_their_own_files(walk: Path, minute: Path) -> None:
    from localreg.commands.view import _footage  # pyright: ignore[reportPrivateUsage]

    footage: Footage = _footage(str(walk), str(minute), None, 60.0)
    assert footage.ghost is not None
    assert footage.ghost.rate == 60.0
    assert footage.ghost_name.startswith("minute")
