"""Files that grow: what is in them when the program dies, and when the disk is full."""

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.live.sinks.motion_stream import EulerTrail, MotionStream
from localreg.motion.formats.registry import read_motion, write_motion
from localreg.motion.joint_angles import axis_rotations
from localreg.motion.motion import Motion
from tests.localreg.live.poses import live_pose, random_qpos

SUBJECT = canonical_subject()
RATE = 50.0


def wandering(frames: int) -> np.ndarray:
    """Smoothly from one pose to another, the root turning over."""
    start, end = random_qpos(1), random_qpos(2)
    f = np.linspace(0.0, 1.0, frames)[:, None]
    qpos = (1.0 - f) * start + f * end
    turns = Rotation.from_rotvec(f * [2.0, 4.0, 1.0]) * Rotation.from_quat(
        start[3:7], scalar_first=True
    )
    qpos[:, 3:7] = turns.as_quat(scalar_first=True)
    return qpos


def record(path: Path, qpos: np.ndarray, instants: list[int] | None = None) -> MotionStream:
    stream = MotionStream(path, SUBJECT, RATE)
    for n, pose in zip(instants or range(len(qpos)), qpos, strict=False):
        stream.publish(live_pose(SUBJECT, pose, n))
    return stream


def bone_ends(motion: Motion) -> np.ndarray:
    return BodyPoints(motion.subject).bone_ends(motion.qpos)


@pytest.mark.parametrize("suffix", [".bvh", ".amc"])
def test_a_file_holds_the_motion_at_every_moment(suffix: str, tmp_path: Path):
    qpos = wandering(40)
    path = tmp_path / f"take{suffix}"
    stream = record(path, qpos[:25])
    (early,) = read_motion(path)
    assert len(early) == 25
    for n in range(25, 40):
        stream.publish(live_pose(SUBJECT, qpos[n], n))
    stream.close()
    stream.close()
    (motion,) = read_motion(path)
    assert len(motion) == 40
    if suffix == ".bvh":
        assert motion.rate == RATE
    assert not [note for note in motion.provenance.notes if "claims" in note]
    truth = BodyPoints(SUBJECT).bone_ends(qpos)
    np.testing.assert_allclose(bone_ends(motion), truth, atol=2e-4)


@pytest.mark.parametrize("suffix", [".bvh", ".amc"])
def test_a_growing_file_is_the_one_that_is_written_at_once(suffix: str, tmp_path: Path):
    motion = Motion(wandering(30), RATE, SUBJECT)
    once = tmp_path / f"once{suffix}"
    write_motion(motion, once)
    grown = tmp_path / f"grown{suffix}"
    record(grown, motion.qpos).close()
    a, b = (read_motion(path)[0] for path in (once, grown))
    np.testing.assert_allclose(bone_ends(a), bone_ends(b), atol=1e-6)
    texts = [path.read_text().replace(" " * 10, "") for path in (once, grown)]
    assert len(texts[0]) == pytest.approx(len(texts[1]), rel=0.01)


def test_frames_that_never_came_repeat_the_pose_before(tmp_path: Path):
    qpos = wandering(3)
    record(tmp_path / "gap.bvh", qpos, [5, 6, 10]).close()
    (motion,) = read_motion(tmp_path / "gap.bvh")
    assert len(motion) == 6
    root = motion.qpos[:, :3]
    np.testing.assert_allclose(root[1], qpos[1, :3], atol=1e-6)
    np.testing.assert_allclose(root[2:], np.tile(qpos[2, :3], (4, 1)), atol=1e-6)


@pytest.mark.parametrize("cut", [1, 7, 100, 400])
def test_a_torn_last_frame_costs_that_frame_only(cut: int, tmp_path: Path):
    path = tmp_path / "torn.bvh"
    record(path, wandering(8)).close()
    data = path.read_bytes()
    path.write_bytes(data[:-cut])
    (motion,) = read_motion(path)
    assert len(motion) in (7, 8)


def test_euler_angles_do_not_jump():
    t = np.linspace(0.0, 4.0 * np.pi, 200)
    turns = axis_rotations("z", t) @ axis_rotations("y", 1.2 * np.sin(t)) @ axis_rotations("x", -t)
    trail = EulerTrail()
    angles = np.array([trail.follow(turn[None])[0] for turn in turns])
    assert np.abs(np.diff(angles, axis=0)).max() < 0.2
    np.testing.assert_allclose(angles[-1, [0, 2]], [t[-1], -t[-1]], atol=1e-9)


def test_files_are_never_overwritten(tmp_path: Path):
    path = tmp_path / "take.bvh"
    path.write_text("precious")
    with pytest.raises(LocalregError, match="exists; give another name"):
        MotionStream(path, SUBJECT, RATE)
    assert path.read_text() == "precious"


def test_kinds_that_cannot_grow_are_refused(tmp_path: Path):
    with pytest.raises(LocalregError, match=r"\.bvh or \.amc"):
        MotionStream(tmp_path / "take.c3d", SUBJECT, RATE)


def test_a_killed_writer_leaves_every_frame_it_wrote(tmp_path: Path):
    path = tmp_path / "killed.bvh"
    program = (
        "import sys\n"
        "from pathlib import Path\n"
        "from tests.localreg.live.test_motion_stream import record, wandering\n"
        f"record(Path({str(path)!r}), wandering(20))\n"
        "print('written', flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"written\n"
        writer.send_signal(signal.SIGKILL)
    (motion,) = read_motion(path)
    assert len(motion) == 20
    again = replace(motion, qpos=wandering(20), subject=SUBJECT)
    np.testing.assert_allclose(bone_ends(motion), bone_ends(again), atol=2e-4)
