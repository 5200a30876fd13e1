"""The step after the poses: what is collected, what is missing, what survives a crash."""

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from calibration.motion_step import MotionStep, at_rate, told
from calibration.poses import EIGHT_POSES
from calibration.progress import forget, motion_file, read_motion, write_motion
from calibration.terminal import TerminalView
from calibration.walk import Walk, between
from calibration.wizard import Wizard
from calibration.wizard_state import Event, State, WizardSettings
from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.motion.motion import Motion
from sensors import rotation
from sensors.pose import TrackerFrame
from tests.calibration.people import TRACKERS, somebody

NAMES = tuple(mount.tracker for mount in TRACKERS)
RATE = 40.0
HOLDS = {hold.pose: hold for hold in somebody(0)[2]}


def frames(seconds, begin=0.0, swing=0.5, unseen=()):
    """Trackers that swing about two axes, the torso's but little."""
    mask = np.array([name not in unseen for name in NAMES])
    far = np.where([name == "torso" for name in NAMES], 0.0, swing)
    rows = []
    for k in range(round(seconds * RATE) + 1):
        t = begin + k / RATE
        turns = far[:, None] * np.array([np.sin(3.0 * t), 0.5 * np.sin(4.0 * t + 1.0), 0.0])
        quaternions = Rotation.from_rotvec(turns).as_quat(scalar_first=True)
        rows.append(TrackerFrame(t, np.full((6, 3), t), quaternions, mask, mask))
    return rows


def step(seconds=10.0, **more):
    return MotionStep.of(TRACKERS, seconds, **more)


def test_motion_is_collected_until_it_is_enough():
    motion = step(5.0)
    for frame in frames(3.0):
        assert motion.push(frame)
    assert motion.collected == pytest.approx(3.0)
    assert not motion.is_over
    for frame in frames(4.0, begin=9.0):
        motion.push(frame)
    assert [len(stretch) for stretch in motion.stretches] == [121, 161]
    assert motion.is_over
    early = step(5.0)
    early.finish()
    assert early.is_over
    assert step(0.0).is_over


def test_a_frame_that_lacks_too_many_trackers_is_a_gap():
    motion = step()
    for frame in [*frames(1.0), *frames(1.0, begin=1.025, unseen=NAMES[:3]), *frames(1.0, 2.05)]:
        motion.push(frame)
    assert [len(stretch) for stretch in motion.stretches] == [41, 41]


def test_trackers_that_hardly_turn_are_named():
    motion = step()
    assert motion.stiff == NAMES
    for frame in frames(5.0):
        motion.push(frame)
    assert motion.stiff == ("torso",)
    # All turn with the torso: only the torso has turned in the room.
    stiff = step()
    for frame in frames(5.0):
        quaternions = np.tile(frame.quaternions[:1], (6, 1)) * np.where(frame.time < 2, 1.0, -1.0)
        stiff.push(frame._replace(quaternions=quaternions))
    assert set(stiff.stiff) == set(NAMES) - {"torso"}
    assert told(12.4, ("head", "torso")) == "12 s to go. Hardly turned yet: head, torso."
    assert told(0.0, ()) == "0 s to go."


def test_one_axis_alone_is_not_enough():
    motion = step()
    for frame in frames(5.0):
        turns = Rotation.from_quat(frame.quaternions, scalar_first=True).as_rotvec()
        turns[:, 1] = 0.0
        flat = Rotation.from_rotvec(turns).as_quat(scalar_first=True)
        motion.push(frame._replace(quaternions=flat))
    assert motion.stiff == NAMES
    np.testing.assert_allclose(motion.turns()[0], [0.5 / np.sqrt(2.0), 0.0], atol=0.03)


def test_other_rates_are_brought_to_the_databases():
    slow = frames(2.0)[::2]
    found = at_rate(slow, RATE)
    wanted = frames(2.0)[: len(found)]
    assert len(found) == 80
    for a, b in zip(found, wanted, strict=True):
        assert a.time == pytest.approx(b.time)
        np.testing.assert_allclose(a.positions, b.positions, atol=1e-9)
        assert np.degrees(rotation.angle_between(a.quaternions, b.quaternions)).max() < 0.2
    half = [*slow[:10], slow[10]._replace(position_mask=np.zeros(6, bool)), *slow[11:]]
    assert sum(not frame.position_mask.any() for frame in at_rate(half, RATE)) in (3, 4)
    assert at_rate(wanted, RATE) == wanted


def walker(**more):
    """Somebody who holds one pose more, and then walks."""
    holds = {name: hold for name, hold in HOLDS.items() if name != "heel"}
    motion = step(3.0)
    settings = WizardSettings(hold=0.6, get_ready=0.1, portion=1.0)
    return Wizard(EIGHT_POSES, NAMES, holds=holds, motion=motion, settings=settings, **more)


def still(seconds, begin=0.0):
    return [frame._replace(positions=np.zeros((6, 3))) for frame in frames(seconds, begin, 0.0)]


def hold(wizard, begin=0.0):
    """Stand still until a pose is recorded."""
    for frame in still(5.0, begin):
        if wizard.push(frame) in (Event.RECORDED, Event.FINISHED):
            return
    pytest.fail("no pose was recorded")


def test_after_the_poses_the_person_walks():
    wizard = walker()
    wizard.go()
    hold(wizard)
    assert wizard.state is State.WALKING
    assert wizard.pose is None
    events = [wizard.push(frame) for frame in frames(1.5, 5.0)]
    assert events.count(Event.COLLECTED) == 1
    seen = wizard.snapshot()
    assert seen.left == pytest.approx(1.5)
    assert seen.held == pytest.approx(1.0 - seen.left / 3.0)
    assert "torso" in seen.stiff
    events = [wizard.push(frame) for frame in frames(3.0, 6.525)]
    assert events.count(Event.FINISHED) == 1
    assert wizard.state is State.DONE
    wizard.repeat(["heel"])
    assert wizard.state is State.MOVING
    hold(wizard, 20.0)
    assert wizard.state is State.DONE  # what was walked is enough


def test_walking_can_be_paused_skipped_and_left_for_a_pose():
    wizard = walker()
    wizard.go()
    hold(wizard)
    for frame in frames(1.0, 5.0):
        wizard.push(frame)
    wizard.pause()
    assert wizard.state is State.READY
    assert wizard.push(frames(0.0, 7.0)[0]) is Event.NOTHING
    wizard.go()
    assert wizard.state is State.WALKING
    for frame in frames(0.5, 6.1):
        wizard.push(frame)
    assert len(wizard.motion.stretches) == 2
    for frame in frames(1.0, 6.7, unseen=NAMES[:4]):
        assert wizard.push(frame) is Event.NOTHING
    assert "lhand" in wizard.snapshot().message
    wizard.back()
    assert wizard.state is State.MOVING
    assert wizard.pose is EIGHT_POSES[-1]
    hold(wizard, 8.0)
    assert wizard.state is State.WALKING
    wizard.skip()
    assert wizard.state is State.DONE
    assert wizard.motion.collected > 1.0


def test_motion_survives_a_crash(tmp_path):
    file = tmp_path / "me.progress.json"
    assert read_motion(file, NAMES) == ()
    written = (tuple(frames(1.0)), tuple(frames(0.5, 5.0)))
    write_motion(file, written, NAMES)
    back = read_motion(file, NAMES)
    for old, new in zip(written, back, strict=True):
        for a, b in zip(old, new, strict=True):
            assert a.time == b.time
            np.testing.assert_array_equal(a.quaternions, b.quaternions)
            np.testing.assert_array_equal(a.position_mask, b.position_mask)
    resumed = step(2.0, stretches=back)
    assert resumed.collected == pytest.approx(1.5)
    assert len(resumed.stretches) == 2
    wizard = Wizard(EIGHT_POSES, NAMES, holds=HOLDS, motion=resumed)
    assert wizard.state is State.READY
    wizard.go()
    assert wizard.state is State.WALKING
    forget(file)
    assert not list(tmp_path.iterdir())


def test_damaged_motion_is_named(tmp_path):
    file = tmp_path / "me.progress.json"
    write_motion(file, (tuple(frames(0.5)),), NAMES)
    whole = motion_file(file).read_bytes()
    with pytest.raises(LocalregError, match="delete it"):
        read_motion(file, (*NAMES[:5], "tail"))
    for damage in (b"", b"PK", whole[:200], b"\x80\x04."):
        motion_file(file).write_bytes(damage)
        with pytest.raises(LocalregError, match="delete it"):
            read_motion(file, NAMES)


def test_lines_say_how_much_longer_to_walk():
    console = Console(file=io.StringIO(), width=200)
    view = TerminalView(console)
    wizard = walker()
    wizard.go()
    for frame in [*still(2.0), *frames(4.0, 5.0)]:
        event = wizard.push(frame)
        view.show(wizard.snapshot(), event, frame)
    output = console.file
    assert isinstance(output, io.StringIO)
    text = output.getvalue()
    assert "recorded 8: heel" in text
    assert "Walk about as you like" in text
    assert "s to go." in text
    assert "recorded motion" in text


def test_a_walk_goes_on_where_the_one_before_ended():
    rng = np.random.default_rng(0)
    motions = []
    for turn in (0.0, 1.0, -2.0):
        qpos = np.array([pose.qpos() for pose in EIGHT_POSES[:2]])
        qpos = np.linspace(qpos[0], qpos[1], 60)
        about = Rotation.from_euler("z", turn) * Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
        qpos[:, 3:7] = about.as_quat(scalar_first=True)
        qpos[:, :2] += rng.normal(0.0, 2.0, 2)
        motions.append(Motion(qpos, 40.0, canonical_subject()))
    walk = Walk.of(motions)
    here = replace(walk, qpos=walk.qpos + 0.0).at(0.0)
    here[:2] = 3.0, 4.0
    moved = walk.from_pose(here)
    assert moved.at(0.0)[:2].tolist() == [3.0, 4.0]
    seconds = (len(walk.qpos) - 1) / 40.0
    qpos = np.array([moved.at(t) for t in np.arange(0.0, seconds, 1.0 / 40.0)])
    positions = BodyPoints(canonical_subject()).bone_ends(qpos)
    speeds = 40.0 * np.linalg.norm(np.diff(positions, axis=0), axis=2)
    assert speeds.max() < 6.0
    np.testing.assert_allclose(moved.at(seconds), moved.at(0.0), atol=1e-9)
    ends = motions[0].qpos[0], motions[0].qpos[-1]
    np.testing.assert_allclose(between(*ends, -1.0), ends[0], atol=1e-9)
    np.testing.assert_allclose(between(*ends, 2.0), ends[1], atol=1e-9)
