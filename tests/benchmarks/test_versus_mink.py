"""mink behind the estimator interface: it reaches what can be reached, and no further."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mink")

from benchmarks.mink_estimator import MinkEstimator
from benchmarks.tuning import tuning_clips
from benchmarks.versus_mink import (
    TUNED,
    activity_grid,
    activity_lines,
    mink_estimator,
    mink_results,
    run_clips,
    time_lines,
)
from localreg.body.skeleton import joint_limits
from localreg.database import PoseDatabase
from localreg.evaluation import worker
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.playback import play
from localreg.evaluation.protocol import Protocol, Trial
from localreg.evaluation.summaries import to_json
from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
from localreg.motion.formats.sample import read_sample
from localreg.motion.motion import Motion
from tests.localreg.evaluation.standing import Builder

EXACT = TrackerQuality(noise_position=0.0, noise_orientation=0.0)


@pytest.fixture(scope="module")
def walk() -> Motion:
    pytest.importorskip("envpool_assets")
    return read_sample()[0].resampled(40.0).first(24)


@pytest.fixture(scope="module")
def estimator(walk: Motion) -> MinkEstimator:
    return mink_estimator(walk, TUNED)


@pytest.mark.parametrize("signals", ["both", "position", "orientation"])
def test_it_reaches_exact_trackers_from_the_truth(
    walk: Motion, estimator: MinkEstimator, signals: str
) -> None:
    trackers = simulate_trackers(walk, replace(EXACT, signals=signals))
    qpos = play(estimator, trackers, true_start=walk.qpos[0]).qpos
    body = BodyPoints(walk.subject)
    found, true = body.tracker_poses(qpos), body.tracker_poses(walk.qpos)
    if signals != "orientation":
        assert np.linalg.norm(found.positions - true.positions, axis=-1)[1:].max() < 0.01
    if signals != "position":
        alike = np.abs(np.sum(found.quaternions * true.quaternions, axis=-1))[1:]
        assert np.degrees(2 * np.arccos(np.minimum(alike, 1.0))).max() < 2.0


def test_it_keeps_to_the_joint_limits(walk: Motion, estimator: MinkEstimator) -> None:
    qpos = play(estimator, simulate_trackers(walk)).qpos
    low, high = joint_limits().T
    assert (qpos[:, 7:] > low - 1e-3).all()
    assert (qpos[:, 7:] < high + 1e-3).all()


def test_it_finds_the_body_wherever_it_stands(walk: Motion, estimator: MinkEstimator) -> None:
    moved = replace(walk, qpos=walk.qpos.copy())
    moved.qpos[:, :3] += [3.0, -5.0, 0.4]
    for motion in (walk, moved):
        trackers = simulate_trackers(motion, EXACT)
        qpos = estimator.init(trackers.frame(0)).qpos
        positions = BodyPoints(walk.subject).tracker_poses(qpos[None]).positions[0]
        assert np.linalg.norm(positions - trackers.positions[0], axis=1).max() < 0.02


def test_masked_trackers_do_not_pull(walk: Motion, estimator: MinkEstimator) -> None:
    trackers = simulate_trackers(walk, EXACT)
    frame = trackers.frame(5)
    kept = np.array([True, True, True, False, True, True])
    nonsense = frame._replace(
        positions=np.where(kept[:, None], frame.positions, 50.0),
        position_mask=kept,
        orientation_mask=kept,
    )
    _, pose = estimator.step(estimator.init_at(walk.qpos[5]), nonsense)
    assert np.nanmax(pose.position_residuals) < 0.01
    assert np.isnan(pose.position_residuals[3])


def test_the_same_frames_for_all_and_the_contract(
    walk: Motion, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    other = read_sample()[3]
    motions = [walk, other]
    database = PoseDatabase.build(motions)
    monkeypatch.setattr(worker, "build_estimator", Builder())
    protocol = Protocol(methods=("ik",), signals=("both",), max_frames=12)
    evaluation = run_clips(motions, database, protocol)
    assert [(clip.method, clip.name) for clip in evaluation.clips] == [
        (method, motion.provenance.name)
        for method in ("ik", "mink", "mink-truth")
        for motion in motions
    ]
    document = json.loads(json.dumps(to_json(evaluation), allow_nan=False))
    assert document["timing"]["mink"]["p50_ms"] > 0.0
    assert document["mean"]["mink-truth"]["both"]["tracker_error_cm"] < 1.0
    assert document["per_activity"]["mink"]["both"]["walk"]["clips"] == 2
    ratios = dict(line.split(": half of the frames within ") for line in time_lines(evaluation))
    assert list(ratios) == ["ik", "mink", "mink-truth"]
    assert ratios["mink"].endswith("ms, 1.00 of mink's")
    (row,) = activity_grid(evaluation, "both").rows
    assert row[:2] == ("walk", "2")
    means = evaluation.means()
    shown = [means[m]["both"].mpjpe_cm for m in ("ik", "mink", "mink-truth")]
    assert list(row[5:]) == [f"{value:.2f}" for value in shown]
    assert activity_lines(evaluation, "both")[0].startswith(
        "ik, both: less of both errors than mink on 0 of 1 activities (not on walk) and 0 of 2 "
    ), "who stands is no match for it"
    again = mink_results(Trial(walk.first(12), ()), protocol, TUNED)
    assert again[0].figures == evaluation.of("mink")[0].figures


def test_tuning_clips_are_those_that_are_said() -> None:
    motions = [replace(m, provenance=replace(m.provenance, subject="")) for m in read_sample()]
    assert tuning_clips(motions) == [motions[i] for i in range(1, 36, 6)]
    some = replace(motions[5], provenance=replace(motions[5].provenance, subject="02"))
    assert tuning_clips([*motions[:5], some]) == [some]
