"""The wizard as a machine, stillness, and the progress file: no clock, no view, no fit."""

import ast
import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import calibration.wizard
from calibration.poses import EIGHT_POSES
from calibration.progress import read_progress, write_progress
from calibration.run_command import leave_progress
from calibration.screening import PoseJudge
from calibration.stillness import StillnessDetector, StillnessSettings
from calibration.terminal import TerminalView
from calibration.wizard import Wizard
from calibration.wizard_state import Event, State, WizardSettings
from localreg.errors import LocalregError
from sensors.pose import TrackerFrame
from tests.calibration.people import PRIOR, TRACKERS, somebody

NAMES = tuple(m.tracker for m in TRACKERS)
RATE = 40.0


class Body:
    """Trackers that move where they are told, with noise, on a clock of their own."""

    def __init__(self, wizard, seed=0):
        self.wizard = wizard
        self.time = 0.0
        self.rng = np.random.default_rng(seed)
        self.at = np.zeros((6, 3))
        self.events = []

    def frame(self, positions, unseen=()):
        self.time += 1.0 / RATE
        mask = np.array([name not in unseen for name in NAMES])
        noisy = positions + self.rng.normal(0.0, 0.003, (6, 3))
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (6, 1))
        return TrackerFrame(self.time, noisy, quaternions, mask, mask)

    def stay(self, seconds, unseen=()):
        return self._play([self.at] * round(seconds * RATE), unseen)

    def go(self, place, seconds=1.0):
        goal = np.zeros((6, 3)) + place
        steps = np.linspace(0.0, 1.0, round(seconds * RATE))
        start, self.at = self.at, goal
        return self._play([(1 - s) * start + s * goal for s in steps])

    def _play(self, rows, unseen=()):
        events = [self.wizard.push(self.frame(row, unseen)) for row in rows]
        heard = [event for event in events if event is not Event.NOTHING]
        self.events += heard
        return heard


def make(**more):
    wizard = Wizard(EIGHT_POSES[:3], NAMES, **more)
    return wizard, Body(wizard)


def test_the_machine_imports_no_view():
    tree = ast.parse(Path(calibration.wizard.__file__).read_text())
    modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert not [m for m in modules if m and ("terminal" in m or "rich" in m or "typer" in m)]


def test_poses_are_recorded_one_after_another():
    wizard, body = make()
    assert body.stay(3.0) == []
    assert wizard.snapshot().state is State.READY
    wizard.go()
    for place in (0.0, 1.0, 2.0):
        assert wizard.pose is not None
        body.go(place)
        body.stay(4.0)
    assert wizard.state is State.DONE
    assert wizard.pose is None
    assert [hold.pose for hold in wizard.holds] == ["T", "twist", "side bend"]
    assert body.events.count(Event.STILL) == 3
    assert body.events[-1] is Event.FINISHED
    assert all(hold.frames == pytest.approx(81, abs=2) for hold in wizard.holds)
    np.testing.assert_allclose(wizard.holds[1].positions, 1.0, atol=0.003)
    assert wizard.snapshot().message == "All is recorded."


def test_nobody_is_recorded_twice_in_one_pose():
    wizard, body = make()
    wizard.go()
    body.go(0.0)
    body.stay(20.0)
    assert [hold.pose for hold in wizard.holds] == ["T"]


def test_who_moves_too_early_begins_again():
    wizard, body = make()
    wizard.go()
    assert body.stay(1.5)[0] is Event.STILL
    assert Event.MOVED in body.go(0.3, seconds=0.5)
    assert wizard.holds == ()
    assert "too short" in wizard.snapshot().message
    assert Event.RECORDED in body.stay(5.0)


def test_a_long_wait_is_reminded_of_again_and_again():
    wizard, body = make(settings=WizardSettings(timeout=2.0))
    wizard.go()
    body.go(5.0, seconds=9.0)
    assert body.events.count(Event.TIMED_OUT) == 4
    assert "waiting" in wizard.snapshot().message


def test_trackers_that_are_not_seen_end_a_hold():
    wizard, body = make()
    wizard.go()
    body.stay(1.5)
    assert body.stay(0.2, unseen=NAMES[:3]) == []
    body.stay(0.1)
    assert body.stay(0.5, unseen=NAMES[:3]) == [Event.BLIND]
    assert wizard.snapshot().unseen == NAMES[:3]
    assert "head" in wizard.snapshot().message
    assert Event.RECORDED in body.stay(4.0, unseen=NAMES[:1])
    assert not wizard.holds[0].position_mask[0]


def test_wrong_poses_are_refused_but_not_for_ever():
    wizard, body = make(judge=lambda hold: "pose T was done with the arms exchanged")
    wizard.go()
    for place in (0.0, 1.0):
        body.go(place)
        assert Event.REFUSED in body.stay(4.0)
        assert wizard.snapshot().message.startswith("Pose T was done")
        assert wizard.holds == ()
    body.go(2.0)
    assert Event.RECORDED in body.stay(4.0)
    assert wizard.snapshot().recorded == ("T",)


def test_back_skip_pause_and_repeat():
    wizard, body = make()
    wizard.go()
    body.go(0.0)
    body.stay(4.0)
    wizard.back()
    assert wizard.holds == ()
    assert wizard.pose is EIGHT_POSES[0]
    wizard.back()
    assert wizard.pose is EIGHT_POSES[0]
    wizard.skip()
    assert wizard.pose is EIGHT_POSES[1]
    wizard.pause()
    body.go(1.0)
    assert body.stay(6.0) == []
    wizard.go()
    assert Event.RECORDED in body.stay(4.0)
    body.go(2.0)
    body.stay(4.0)
    assert wizard.state is State.DONE
    wizard.repeat(["T"])
    assert wizard.pose is EIGHT_POSES[0]
    body.go(3.0)
    assert Event.FINISHED in body.stay(4.0)
    assert len(wizard.holds) == 3
    with pytest.raises(LocalregError, match="juggling"):
        wizard.repeat(["juggling"])


def test_what_was_recorded_before_is_not_asked_for_again():
    holds = {hold.pose: hold for hold in somebody(0)[2][:2]}
    wizard, body = make(holds=holds)
    assert wizard.pose is EIGHT_POSES[2]
    assert wizard.snapshot().number == 3
    wizard.go()
    body.go(0.0)
    body.stay(4.0)
    assert wizard.state is State.DONE
    everything = {hold.pose: hold for hold in somebody(0)[2][:3]}
    assert Wizard(EIGHT_POSES[:3], NAMES, holds=everything).state is State.DONE
    with pytest.raises(LocalregError, match="juggling"):
        Wizard(EIGHT_POSES, NAMES, only=["juggling"])


@pytest.mark.parametrize(
    ("speed", "still"), [(0.0, True), (0.02, True), (0.12, False), (1.0, False)]
)
def test_stillness_is_told_through_noise(speed, still):
    detector = StillnessDetector()
    rng = np.random.default_rng(1)
    answers = []
    for k in range(80):
        t = k / RATE
        positions = np.zeros((6, 3)) + rng.normal(0.0, 0.003, (6, 3))
        positions[3, 0] += speed * t
        mask = np.ones(6, bool)
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (6, 1))
        quaternions[2] *= -1.0 if k % 2 else 1.0  # the same rotation
        answers.append(detector.push(TrackerFrame(t, positions, quaternions, mask, mask)))
    assert not any(answers[:20])
    assert np.mean(answers[30:]) == pytest.approx(1.0 if still else 0.0, abs=0.05)


def test_turning_on_the_spot_and_gaps_are_not_still():
    detector = StillnessDetector(StillnessSettings(window=0.5))
    mask = np.ones(1, bool)
    answers = []
    for k in range(60):
        angle = 0.5 * k / RATE
        q = np.array([[np.cos(angle), np.sin(angle), 0.0, 0.0]])
        answers.append(detector.push(TrackerFrame(k / RATE, np.zeros((1, 3)), q, mask, mask)))
    assert not any(answers)
    detector.reset()
    still = np.array([[1.0, 0.0, 0.0, 0.0]])
    times = [0.0, 0.1, 0.2, 2.0, 2.1]
    assert not any(
        detector.push(TrackerFrame(t, np.zeros((1, 3)), still, mask, mask)) for t in times
    )


def test_progress_survives_and_is_replaced_whole(tmp_path):
    file = tmp_path / "deep" / "me.progress.json"
    holds = somebody(0)[2]
    assert read_progress(file, NAMES) == {}
    write_progress(file, holds[:2], NAMES)
    write_progress(file, holds[:3], NAMES)
    back = read_progress(file, NAMES)
    assert list(back) == ["T", "twist", "side bend"]
    for hold in holds[:3]:
        for name in ("positions", "quaternions", "position_covariances", "position_mask"):
            np.testing.assert_array_equal(getattr(back[hold.pose], name), getattr(hold, name))
    assert [path.name for path in file.parent.iterdir()] == [file.name]


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"version": 9, "trackers": [], "holds": []}', "\x00",
     '{"version": 1, "trackers": TRACKERS, "holds": [{"pose": "T"}]}'],
)  # fmt: skip
def test_a_damaged_progress_file_is_named(tmp_path, text):
    file = tmp_path / "p.json"
    file.write_text(text.replace("TRACKERS", json.dumps(NAMES)))
    with pytest.raises(LocalregError, match="delete it"):
        read_progress(file, NAMES)


def test_progress_of_other_trackers_or_places_is_refused(tmp_path):
    file = tmp_path / "p.json"
    write_progress(file, somebody(0)[2][:1], NAMES)
    with pytest.raises(LocalregError, match="not of a, b"):
        read_progress(file, ("a", "b"))
    with pytest.raises(LocalregError, match="cannot write"):
        write_progress(file / "below", (), NAMES)


def test_poses_to_repeat_are_all_that_is_asked_for_again(tmp_path):
    file = tmp_path / "p.json"
    holds = {hold.pose: hold for hold in somebody(0)[2]}
    wizard = Wizard(EIGHT_POSES, NAMES, holds=holds)
    leave_progress(file, wizard, ("twist", "bow"))
    again = Wizard(EIGHT_POSES, NAMES, holds=read_progress(file, NAMES))
    assert set(holds) - {hold.pose for hold in again.holds} == {"twist", "bow"}
    leave_progress(file, wizard, ())
    assert not file.exists()


def test_lines_name_the_pose_that_was_recorded():
    console = Console(file=io.StringIO())
    view = TerminalView(console)
    wizard, body = make()
    wizard.go()
    told = wizard.push

    def push(frame):
        event = told(frame)
        view.show(wizard.snapshot(), event, frame)
        return event

    wizard.push = push
    for place in (0.0, 0.5, 1.0):
        body.go(place)
        body.stay(4.0)
    wizard.repeat(["T"])
    body.go(0.0)
    body.stay(4.0)
    lines = console.file.getvalue().splitlines()
    recorded = [line for line in lines if line.startswith("recorded")]
    assert recorded == [
        "recorded 1: T", "recorded 2: twist", "recorded 3: side bend", "recorded 3: T",
    ]  # fmt: skip
    assert sum(line.startswith("pose 1 of 3, T:") for line in lines) == 2


def test_single_holds_are_judged_while_the_person_is_there():
    judge = PoseJudge(EIGHT_POSES, TRACKERS, PRIOR)
    _, _, holds = somebody(1)
    assert [judge.judge(hold) for hold in holds] == [""] * 8
    assert "pose heel" in judge.judge(replace(holds[7], pose="bow"))
    assert judge.judge(replace(holds[0], positions=100 * holds[0].positions)) == ""
