import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.live.demo.faults import SHORTEST, bad_day
from localreg.live.demo.playlist import Playlist
from localreg.motion.motion import Motion, Provenance
from sensors.emulators.faults import parse_fault

RATE = 40.0


def turning(name: str, frames: int = 20, rate: float = RATE, x: float = 0.0) -> Motion:
    """Walks along y from x, turns about z through half a turn, bends all joints across pi."""
    t = np.arange(frames) / rate
    qpos = np.zeros((frames, 63))
    qpos[:, 0], qpos[:, 1], qpos[:, 2] = x, 1.2 * t, 1.0
    upright = Rotation.from_quat([0.5**0.5, 0.5**0.5, 0.0, 0.0], scalar_first=True)
    turned = Rotation.from_euler("z", (170.0 + 100.0 * t)[:, None], degrees=True) * upright
    qpos[:, 3:7] = turned.as_quat(canonical=True, scalar_first=True)
    qpos[:, 7:] = (np.pi - 0.05 + 2.0 * t[:, None] + np.pi) % (2 * np.pi) - np.pi
    return Motion(qpos, rate, canonical_subject(), Provenance(name))


def test_rows_follow_one_another():
    playlist = Playlist.of([turning("a", 20), turning("b", 10), turning("c", 30)], RATE)
    assert playlist.starts.tolist() == [0, 20, 30, 60]
    assert playlist.seconds == pytest.approx(1.5)
    clips = [playlist.clip_at(t) for t in (-1.0, 0.0, 19.4 / 40, 19.6 / 40, 29.6 / 40, 9.0)]
    assert clips == [0, 0, 0, 1, 2, 2]


@pytest.mark.parametrize(
    ("seconds", "lengths"),
    [(None, [20, 10]), (0.6, [20, 4]), (0.5, [20]), (2.0, [20, 10, 20, 10, 20]), (0.51, [20])],
)
def test_the_list_is_cut_or_repeated(seconds, lengths):
    playlist = Playlist.of([turning("a", 20), turning("b", 10)], RATE, seconds)
    assert np.diff(playlist.starts).tolist() == lengths


def test_clips_at_another_rate_are_resampled_and_single_frames_left_out():
    playlist = Playlist.of([turning("a", 21, rate=20.0), turning("one", 1)], RATE)
    assert len(playlist.clips) == 1
    assert playlist.rows == 41
    assert playlist.rate == RATE


def test_truth_is_exact_on_the_rows_and_between_them():
    fine = turning("fine", 401, rate=400.0)
    playlist = Playlist.of([turning("first", 7), fine.resampled(RATE), turning("last", 5)], RATE)
    at = np.arange(0, 401)
    truth = playlist.truth(1, 7 / RATE + at / 400.0)
    angles = (truth[:, 7:] - fine.qpos[:, 7:] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(angles).max() < 1e-9
    assert np.abs(truth[:, :3] - fine.qpos[:, :3]).max() < 1e-9
    true_root = Rotation.from_quat(fine.qpos[:, 3:7], scalar_first=True)
    root = Rotation.from_quat(truth[:, 3:7], scalar_first=True)
    assert (root * true_root.inv()).magnitude().max() < 1e-9


def test_truth_stays_inside_its_clip():
    playlist = Playlist.of([turning("a", 20), turning("b", 10, x=5.0)], RATE)
    truth = playlist.truth(0, np.array([-0.1, 19.4 / RATE, 1.0]))
    np.testing.assert_allclose(truth[0], playlist.clips[0].qpos[0])
    np.testing.assert_allclose(truth[1:, :3], playlist.clips[0].qpos[[-1, -1], :3])


def test_the_playback_is_what_the_trackers_of_the_true_poses_report():
    playlist = Playlist.of([turning("a", 20), turning("b", 10, x=5.0)], RATE)
    playback = playlist.playback()
    assert playback.names == playlist.subject.trackers
    assert playback.duration == pytest.approx(29 / RATE)
    truth = BodyPoints(playlist.subject).tracker_poses(playlist.clips[1].qpos)
    np.testing.assert_allclose(playback.positions[20:], truth.positions, atol=1e-12)
    row = playback.pose_at(23 / RATE)
    for j, pose in enumerate(row):
        assert pose is not None
        np.testing.assert_allclose(pose[0], truth.positions[3, j], atol=1e-9)


def test_what_cannot_be_played():
    with pytest.raises(LocalregError, match="no clip to play"):
        Playlist.of([turning("one", 1)], RATE)
    other = turning("b")
    other = Motion(other.qpos, RATE, other.subject.mirrored(), other.provenance)
    object.__setattr__(other.subject, "lengths", 1.1 * other.subject.lengths)
    with pytest.raises(LocalregError, match="several bodies"):
        Playlist.of([turning("a"), other], RATE)


@pytest.mark.parametrize("seconds", [SHORTEST, 131.0])
def test_a_bad_day_fits_into_the_run(seconds):
    faults = [parse_fault(text) for text in bad_day(seconds)]
    assert {f.name for f in faults} == {"junk", "truncation", "jump", "silence"}
    assert all(f.start + f.duration < seconds for f in faults)
    jump = next(f for f in faults if f.name == "jump")
    silence = next(f for f in faults if f.name == "silence")
    assert jump.start + jump.duration < silence.start
    assert silence.duration == 3.0


def test_a_run_too_short_for_a_bad_day():
    with pytest.raises(LocalregError, match="give --seconds 10"):
        bad_day(9.0)
