"""The wizard in the live view, but for the fit, which test_calibrate.py has compiled."""

from pathlib import Path

import numpy as np
import pytest

from calibration.panel import WizardPanel, beside, frame_of
from calibration.poses import EIGHT_POSES
from calibration.wizard_state import State
from localreg.body.subject import canonical_subject
from localreg.view.cameras import heading
from localreg.view.panels import Desk, panels_for
from tests.calibration.before_the_view import PATIENCE, RATE, SETTINGS, Person, hold


def test_the_pose_to_be_taken_is_shown_where_the_person_stands():
    target = EIGHT_POSES[0].qpos()
    body = EIGHT_POSES[1].qpos()
    body[:2] = 3.0, -1.0
    body[3:7] = [0.5, 0.5, 0.5, 0.5]
    shown = beside(target, body)
    assert shown[:2].tolist() == [3.0, -1.0]
    assert shown[2] == target[2]
    ours, theirs = heading(shown), heading(body)
    assert ours is not None
    assert ours == pytest.approx(theirs)
    np.testing.assert_array_equal(shown[7:], target[7:])


def test_the_panel_is_there_where_somebody_stands_live(tmp_path: Path):
    live = [panel.title for panel in panels_for(Desk(Person(tmp_path)))]
    assert "Calibration" in live
    assert "Calibration" not in [panel.title for panel in panels_for(Desk(Person(None)))]
    few = canonical_subject().with_trackers(("head", "torso", "lhand"))
    assert "Calibration" not in [panel.title for panel in panels_for(Desk(Person(tmp_path, few)))]


def test_leaving_forgets_everything(tmp_path: Path):
    person = Person(tmp_path)
    desk, panel = Desk(person), WizardPanel(settings=SETTINGS)
    panel.watch(desk)
    panel.begin(desk)
    person.take(EIGHT_POSES[0].qpos())
    desk.look()
    panel.watch(desk)
    assert desk.target is not None
    panel.leave(desk)
    assert panel.wizard is None
    assert desk.target is None


def test_a_fit_that_fails_says_so_without_naming_files(tmp_path: Path):
    def fails(holds, mounts, motion):
        raise PermissionError(13, "Permission denied", str(tmp_path / "secret"))

    person = Person(tmp_path)
    desk = Desk(person)
    panel = WizardPanel(EIGHT_POSES[:1], SETTINGS, fails, motion=0.0)
    panel.begin(desk)
    pose = EIGHT_POSES[0].qpos()
    hold(panel, desk, person, EIGHT_POSES[1].qpos(), pose)
    panel.join(PATIENCE)
    assert panel.words == "no result: Permission denied"
    assert not list(tmp_path.iterdir())


def test_after_the_poses_the_panel_collects_motion(tmp_path: Path):
    given = []

    def fitted(holds, mounts, motion):
        given.append((len(holds), len(mounts), sum(len(stretch) for stretch in motion)))
        return None, ("nobody",), ()

    person = Person(tmp_path)
    desk = Desk(person)
    panel = WizardPanel(EIGHT_POSES[:1], SETTINGS, fitted, motion=3.0)
    panel.begin(desk)
    pose = EIGHT_POSES[0].qpos()
    hold(panel, desk, person, EIGHT_POSES[1].qpos(), pose)
    assert panel.wizard is not None
    assert panel.wizard.state is State.WALKING
    assert desk.target is None
    hold(panel, desk, person, pose, EIGHT_POSES[1].qpos())
    panel.join(PATIENCE)
    ((holds, mounts, frames),) = given
    assert (holds, mounts) == (1, 6)
    assert frames == pytest.approx(3.0 * RATE, abs=3)
    assert panel.words == "nobody"


def test_frames_come_back_as_they_were(tmp_path: Path):
    person = Person(tmp_path)
    person.take(EIGHT_POSES[0].qpos())
    moment = person.newest()
    assert moment is not None
    frame = frame_of(moment)
    assert frame.time == moment.time
    assert frame.position_mask.all()
    np.testing.assert_array_equal(frame.positions[2], moment.trackers[2].position)
