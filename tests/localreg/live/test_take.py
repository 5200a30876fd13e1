"""What a recording says of how poses were made, and doing it again."""

import math
from pathlib import Path

import numpy as np
import pytest

from localreg.body.subject import Subject
from localreg.database.store import PoseDatabase
from localreg.errors import LocalregError, SubjectError
from localreg.live.database_choice import ChosenDatabase, choose_database, identity
from localreg.live.performance_config import PerformanceConfig
from localreg.live.recenter import Recentering
from localreg.live.retake import Retake, largest_difference, solve_again
from localreg.live.session import Session
from localreg.live.sinks import Sink
from localreg.live.take import PASSED_OVER, NoTakeError, Take, TakeRecorder
from localreg.motion.motion import Motion
from localreg.synthesis.settings import METHODS
from sensors.assembler import AssembledFrame
from sensors.devices.is900 import Is900Config
from sensors.placement import Placement
from sensors.recording import Recorder
from tests.localreg.live.poses import random_qpos
from tests.localreg.live.scripted import (
    SUBJECT,
    Clock,
    Inline,
    Listener,
    ScriptedEstimator,
    ScriptedStream,
    arrived,
    instant,
)


@pytest.fixture(scope="module")
def chosen() -> ChosenDatabase:
    rng = np.random.default_rng(0)
    qpos = np.tile(random_qpos(0), (60, 1))
    qpos[:, 7:] += 0.1 * rng.normal(size=(60, 56)).cumsum(axis=0)
    poses = PoseDatabase.build([Motion(qpos, 40.0, SUBJECT)])
    return ChosenDatabase(poses, identity(poses), "made up", SUBJECT)


def perform(
    path: Path,
    frames: list[AssembledFrame],
    chosen: ChosenDatabase,
    executor: Inline,
    sinks: list[Sink],
    subject: Subject = SUBJECT,
    recentered_at: int = -1,
    costs: dict[int, float] | None = None,
) -> None:
    """A live session that records itself."""
    clock = Clock()
    with Recorder(path) as recorder:
        log = TakeRecorder(recorder)
        performance = PerformanceConfig()
        log.begin("localreg", METHODS["localreg"], performance, subject, chosen)
        recentering = Recentering()
        recentering.on_change = log.placed

        def finish(live):
            if live.instant == recentered_at:
                recentering.request()

        class Noticing(ScriptedStream):
            def next(self, timeout: float) -> AssembledFrame | None:
                assembled = super().next(timeout)
                if assembled is not None:
                    recorder.frame(assembled, 0)
                    if assembled.index == 2:
                        executor.finish()
                return assembled

        estimator = ScriptedEstimator(clock, costs=costs)
        session = Session(
            Noticing(clock, frames),
            lambda _: estimator,
            [*sinks, Listener(finish)],
            now=clock,
            executor=executor,
            place=recentering,
            log=log,
        )
        session.run(end=frames[-1].frame.time + 1e-3)


def again(take: Take, frames: list[AssembledFrame], exactly: bool = True) -> Retake:
    searches = take.searches if exactly else None
    return solve_again(frames, ScriptedEstimator(), take.performance, searches, take.frames)


FRAMES = [arrived(n) for n in range(20)]


def test_a_take_says_how_its_poses_were_made(tmp_path: Path, chosen: ChosenDatabase):
    path = tmp_path / "take.mcap"
    perform(path, FRAMES, chosen, Inline(), [])
    take = Take.read(path)
    assert (take.method, take.settings) == ("localreg", METHODS["localreg"])
    assert take.performance == PerformanceConfig()
    assert take.database["identity"] == chosen.identity
    assert take.database["rate"] == 40.0
    np.testing.assert_array_equal(take.subject.offsets, SUBJECT.offsets)
    np.testing.assert_array_equal(take.subject.axis_frames, SUBJECT.axis_frames)
    assert take.subject.mounts == SUBJECT.mounts
    assert take.frames == len(take.indices) == 20


@pytest.mark.parametrize("patient", [False, True], ids=["found at once", "found late"])
def test_a_body_that_was_found_late_is_found_late_again(
    patient: bool, tmp_path: Path, chosen: ChosenDatabase
):
    path = tmp_path / "take.mcap"
    listener = Listener()
    frames = [arrived(n) for n in range(20)]
    perform(path, frames, chosen, Inline(patient=patient), [listener])
    take = Take.read(path)
    assert take.indices[0] == (2 if patient else 0)
    assert take.searches == ({0: "waiting", 1: "waiting", 2: "found"} if patient else {0: "found"})
    assert largest_difference(take, again(take, frames)) == 0.0
    if patient:
        # Without what the recording says, the body is there from the first frame on.
        assert again(take, frames, exactly=False).collected.indices[0] == 0
        assert largest_difference(take, again(take, frames, exactly=False)) == math.inf


def test_frames_that_a_slow_machine_passed_over_are_left_out_again(
    tmp_path: Path, chosen: ChosenDatabase
):
    path = tmp_path / "take.mcap"
    frames = [arrived(n) for n in range(40)]
    perform(path, frames, chosen, Inline(), [], costs={5: 0.6})
    take = Take.read(path)
    passed = [index for index, search in take.searches.items() if search == PASSED_OVER]
    assert passed == list(range(6, 6 + len(passed)))
    assert len(passed) > 10
    assert set(take.indices) == set(range(40)) - set(passed)
    assert largest_difference(take, again(take, frames)) == 0.0
    # With time to spare all of them are solved.
    assert len(again(take, frames, exactly=False).collected) == 40


def test_a_repetition_that_differs_says_how_far(tmp_path: Path, chosen: ChosenDatabase):
    path = tmp_path / "take.mcap"
    perform(path, FRAMES, chosen, Inline(), [])
    take = Take.read(path)
    other = solve_again(
        FRAMES, ScriptedEstimator(bad=frozenset({7})), take.performance, take.searches, 20
    )
    assert largest_difference(take, other) == 1.0
    assert largest_difference(take, again(take, FRAMES[:10])) == math.inf


def test_the_motion_is_placed_as_it_was_published(tmp_path: Path, chosen: ChosenDatabase):
    path = tmp_path / "take.mcap"
    listener = Listener()
    perform(path, FRAMES, chosen, Inline(), [listener], recentered_at=9)
    take = Take.read(path)
    assert list(take.placements) == [10]
    assert (take.placement(9), take.placement(15)) == (None, take.placements[10])
    motion = again(take, FRAMES).motion(take, SUBJECT, path, None)
    published = np.array([live.pose.qpos for live in listener.heard])
    np.testing.assert_array_equal(motion.qpos, published)
    # Before placing, root x is the frame's number: from frame 10 on it counts from there.
    np.testing.assert_allclose(np.hypot(*motion.qpos[10:, :2].T), np.arange(10), atol=1e-9)
    assert (motion.rate, motion.provenance.name) == (40.0, "take")


def test_the_motion_is_smoothed_on_the_way(tmp_path: Path, chosen: ChosenDatabase):
    path = tmp_path / "take.mcap"
    perform(path, FRAMES, chosen, Inline(), [])
    take = Take.read(path)
    smooth = again(take, FRAMES).motion(take, SUBJECT, path, 5.0)
    # A steady walk is as smooth as can be.
    np.testing.assert_allclose(smooth.qpos[:, 0], np.arange(20), atol=1e-6)
    with pytest.raises(LocalregError, match="between 0 and 20 Hz"):
        again(take, FRAMES).motion(take, SUBJECT, path, 20.0)


def test_a_recording_of_trackers_alone_is_solved_for_the_first_time(tmp_path: Path):
    path = tmp_path / "trackers.mcap"
    names = ("torso", "head", "lhand")
    device = Is900Config(
        name="is900", port="nowhere", stations=dict(zip(names, (1, 2, 3), strict=True))
    )
    with Recorder(path) as recorder:
        room = Placement().model_dump(mode="json")
        recorder.configuration(names, [device.model_dump(mode="json")], {"rate": 50.0}, room)
        for n in range(5):
            recorder.frame(arrived(n), 0)
    with pytest.raises(NoTakeError, match=r"no take of localreg run.*localreg synthesize"):
        Take.read(path)
    take = Take.of_trackers(path, SUBJECT)
    assert take.subject.trackers == names
    assert (take.frames, take.indices, take.database["rate"]) == (5, (), 50.0)
    assert take.settings == METHODS["localreg"]
    with pytest.raises(SubjectError, match="no tracker named torso"):
        Take.of_trackers(path, SUBJECT.with_trackers(("head", "lhand")))


@pytest.mark.parametrize(
    ("change", "words"),
    [({"version": 99}, "version 99"), ({"settings": {"magic": 1}}, "--method localreg")],
)
def test_a_take_of_another_version_is_refused(
    change: dict, words: str, tmp_path: Path, chosen: ChosenDatabase, monkeypatch
):
    path = tmp_path / "take.mcap"
    with Recorder(path) as recorder:
        log = TakeRecorder(recorder)
        write = type(log._take).write
        monkeypatch.setattr(
            type(log._take), "write", lambda self, m, t: write(self, {**m, **change}, t)
        )
        log.begin("localreg", METHODS["localreg"], PerformanceConfig(), SUBJECT, chosen)
    with pytest.raises(LocalregError, match=words):
        Take.read(path)


def test_a_database_has_the_same_name_in_memory_and_on_disk(tmp_path: Path, chosen: ChosenDatabase):
    folder = tmp_path / "made.db"
    chosen.poses.save(folder)
    assert choose_database(folder).identity == chosen.identity
    other = PoseDatabase.build([Motion(np.tile(random_qpos(1), (60, 1)), 40.0, SUBJECT)])
    assert identity(other) != chosen.identity


def test_frames_that_never_came_are_filled(tmp_path: Path, chosen: ChosenDatabase):
    path = tmp_path / "take.mcap"
    frames = [arrived(n) for n in (0, 1, 2, 6, 7)]
    perform(path, frames, chosen, Inline(), [])
    take = Take.read(path)
    motion = again(take, frames).motion(take, SUBJECT, path, None)
    np.testing.assert_array_equal(motion.qpos[:, 0], [0, 1, 2, 2, 2, 2, 6, 7])
    assert instant(7) == frames[-1].frame.time
