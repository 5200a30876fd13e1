"""What panels are told and what they keep, without any window."""

import asyncio
import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.visitor import visit
from localreg.body.skeleton import BONES, DOF_NAMES
from localreg.body.subject import canonical_subject
from localreg.view.feed import About, Glimpse, glimpse_size, moment_of, pack, unpack
from localreg.view.history import History
from localreg.view.moment import Heard, Moment, NeighborClip, Observer, Timing
from localreg.view.panels import Desk, panels_for
from localreg.view.panels_joints import CHOSEN_FIRST, JointsPanel
from localreg.view.process import ViewProcess
from localreg.view.slot import Slot
from localreg.view.source import COMMANDS, Command, Source
from localreg.view.transport import Deck, Playhead
from sensors.pose import TrackerFrame

SUBJECT = canonical_subject()
TRACKERS = len(SUBJECT.trackers)


def glimpse(index: int = 3, *, has_ghost: bool = True) -> Glimpse:
    random = np.random.default_rng(index)
    quaternions = random.normal(size=(TRACKERS, 4))
    frame = TrackerFrame(
        time=12.5 + index,
        positions=random.normal(size=(TRACKERS, 3)),
        quaternions=quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
        position_mask=random.random(TRACKERS) < 0.5,
        orientation_mask=random.random(TRACKERS) < 0.5,
    )
    qpos = random.normal(size=63)
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    ghost = random.normal(size=63) if has_ghost else None
    return Glimpse(index, frame, qpos, 0.75, index % 2 == 0, index % 3 == 0, ghost)


class Given(Source):
    """Shows what it was given."""

    def __init__(self, moment: Moment | None = None, deck: Deck | None = None) -> None:
        self.subject = SUBJECT
        self.transport = deck
        self.moment = moment
        self.asked: list[Command] = []

    def newest(self) -> Moment | None:
        return self.moment

    def command(self, name: Command) -> None:
        self.asked.append(name)


def moment(time: float, **known: float) -> Moment:
    qpos = np.zeros(63)
    qpos[2], qpos[3:5], qpos[7] = 1.0, 0.5**0.5, time
    return replace(Observer(SUBJECT).observe(time, qpos), **known)


@pytest.mark.parametrize("has_ghost", [False, True])
@pytest.mark.parametrize("index", [0, 1, 6])
def test_a_frame_arrives_as_it_was(index: int, has_ghost: bool):
    sent = glimpse(index, has_ghost=has_ghost)
    data = pack(sent)
    assert len(data) == glimpse_size(TRACKERS)
    came = unpack(data, TRACKERS)
    assert (came.index, came.confidence) == (sent.index, sent.confidence)
    assert (came.is_held, came.is_start) == (sent.is_held, sent.is_start)
    np.testing.assert_array_equal(came.qpos, sent.qpos)
    for ours, theirs in zip(came.frame, sent.frame, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    if sent.ghost is None:
        assert came.ghost is None
    else:
        np.testing.assert_array_equal(came.ghost, sent.ghost)


def test_a_frame_of_other_trackers_is_refused():
    with pytest.raises(ValueError, match="no glimpse of 5 trackers"):
        unpack(pack(glimpse()), 5)


def test_what_changes_slowly_arrives_as_it_was():
    sent = About(
        timing=Timing(0.007, math.nan, 100, 3, 0.004, 0.006),
        heard={"head": Heard(40.0, 0.012), "torso": Heard()},
        neighbors=(NeighborClip("16_01", "walk", 0.4), NeighborClip("x")),
        title="walk",
        ghost_name="truth",
        note="marked",
        notice="compiling",
        is_recording=True,
    )
    came = About.of_bytes(sent.to_bytes())
    assert came.heard["head"] == sent.heard["head"]
    assert math.isnan(came.heard["torso"].age)
    assert math.isnan(came.timing.p99)
    assert (came.timing.p50, came.timing.frames, came.timing.late_frames) == (0.007, 100, 3)
    assert came.neighbors[0] == sent.neighbors[0]
    assert (came.title, came.ghost_name, came.note) == ("walk", "truth", "marked")
    assert came.notice == "compiling"
    assert came.is_recording


def test_a_moment_says_all_that_is_known():
    shown = moment_of(glimpse(6), About(title="walk", ghost_name="truth"), Observer(SUBJECT))
    assert (shown.index, shown.title, shown.ghost_name) == (6, "walk", "truth")
    assert shown.is_held
    assert shown.confidence == 0.75
    masked = [tracker.is_masked for tracker in shown.trackers]
    frame = glimpse(6).frame
    assert masked == (~(frame.position_mask | frame.orientation_mask)).tolist()


def test_a_slot_holds_the_newest_message_alone():
    writer, fd = Slot.create(100)
    reader = Slot(fd)
    os.close(fd)
    assert reader.read() is None
    for number in range(5):
        writer.write(b"message %d" % number)
    assert reader.read() == b"message 4"
    assert reader.read() is None
    writer.write(b"")
    assert reader.read() == b""
    with pytest.raises(ValueError, match="does not fit"):
        writer.write(bytes(101))
    reader.close()
    writer.close()


_READER = """
import sys
from localreg.view.slot import Slot
slot, last = Slot(int(sys.argv[1])), -1
print("begun", flush=True)
while last < int(sys.argv[2]):
    data = slot.read()
    if data is not None:
        number = int.from_bytes(data[:4], "little")
        assert data == number.to_bytes(4, "little") * 1000, "a message in pieces"
        assert number > last, "an old message"
        last = number
"""


def test_another_process_never_sees_half_a_message():
    writer, fd = Slot.create(4000)
    last = 20_000
    with subprocess.Popen(
        [sys.executable, "-c", _READER, str(fd), str(last)],
        pass_fds=[fd], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline() == "begun\n"
        for number in range(last + 1):
            writer.write(number.to_bytes(4, "little") * 1000)
        _, said = process.communicate(timeout=60)
    os.close(fd)
    writer.close()
    assert process.returncode == 0, said


def test_history_keeps_the_last_moments_in_order():
    history = History(TRACKERS, capacity=4)
    assert len(history) == 0
    assert history.ages.size == 0
    for time in range(6):
        history.add(moment(float(time), confidence=time / 10))
    assert len(history) == 4
    assert history.ages.tolist() == [-3.0, -2.0, -1.0, 0.0]
    np.testing.assert_allclose(history.confidence, [0.2, 0.3, 0.4, 0.5])
    assert history.angles[:, 0].tolist() == [2.0, 3.0, 4.0, 5.0]
    assert np.isnan(history.distances).all()
    assert np.isnan(history.latency).all()
    history.add(moment(1.0))
    assert history.ages.tolist() == [0.0]


def test_a_desk_takes_every_moment_once():
    source = Given()
    desk = Desk(source)
    assert desk.look() is None
    source.moment = moment(1.0)
    assert desk.look() is source.moment
    assert desk.is_new
    desk.look()
    assert not desk.is_new
    assert len(desk.history) == 1


def test_live_runs_and_files_have_different_panels():
    live, file = Given(), Given(deck=Deck(Playhead(10, 40.0)))
    live.commands = COMMANDS
    titles = [panel.title for panel in panels_for(Desk(live))]
    assert titles[:4] == ["Take", "Trackers", "Timing", "Prior"]
    assert "Playing" not in titles
    titles = [panel.title for panel in panels_for(Desk(file))]
    assert titles[0] == "Playing"
    assert not {"Take", "Timing", "Prior"} & set(titles)
    assert {"Joints", "Scene"} <= set(titles)


def test_joint_angles_can_be_chosen():
    panel = JointsPanel()
    assert panel.chosen == list(CHOSEN_FIRST)
    panel.toggle("lfemurrx")
    panel.toggle(DOF_NAMES[0])
    assert panel.chosen == [*CHOSEN_FIRST[1:], DOF_NAMES[0]]
    assert sum(len(bone.dofs) for bone in BONES) == len(DOF_NAMES)


def test_a_view_that_cannot_begin_says_why():
    with (
        ViewProcess(SUBJECT, host="203.0.113.9") as process,
        pytest.raises(Exception, match="give --host an address of this machine"),
    ):
        process.wait()


def test_a_view_that_is_killed_is_told_of_and_costs_nothing():
    told: list[int] = []
    with ViewProcess(SUBJECT, port=0, on_end=told.append) as process:
        process.wait()
        os.kill(process.pid, 9)
        process.join(30.0)
        process.show(glimpse())
        assert told == [-9]


@pytest.mark.parametrize("kind", [[], ["file"]])
def test_every_panel_can_be_drawn(kind: list[str], tmp_path: Path):
    pipe = subprocess.PIPE
    command = [sys.executable, "-m", "tests.localreg.view.all_panels", str(tmp_path), *kind]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        assert url, process.communicate()[1]
        states, pieces = asyncio.run(visit(url, seconds=60.0, enough=40))
        _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    assert states >= 40
    assert pieces >= 40
    assert not said
