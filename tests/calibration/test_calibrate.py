"""Whole calibrations of simulated people, well done and badly."""

from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from calibration.calibrate import calibrate
from calibration.eigen_skeleton import find_skeletons, learn
from calibration.holds import Hold
from calibration.knowledge import known_file, read_knowledge
from calibration.panel import WizardPanel
from calibration.poses import EIGHT_POSES, with_swapped
from calibration.report import findings_lines, lengths_table, mounts_table, summary_lines
from calibration.result import QUANTILE_90, REPORTED, nine_deviations, nine_lengths
from calibration.screening import Kind
from calibration.setup import true_lengths
from calibration.simulated import held, perform, random_person
from calibration.wizard_state import State
from localreg.body.skeleton import DOF_NAMES
from localreg.body.subject import Mount, read_subject, write_subject
from localreg.errors import LocalregError
from localreg.view.panels import Desk
from tests.calibration.before_the_view import PATIENCE, SETTINGS, Person, hold
from tests.calibration.people import PERFECT, PRIOR, TRACKERS, USUAL, lengths, somebody

MUST_BE_OBSERVABLE = ("thigh", "shank", "upper arm", "forearm")


@pytest.fixture(scope="module")
def clean():
    """Three people and what comes of them."""
    return {seed: calibrate(somebody(seed)[2], TRACKERS, PRIOR) for seed in (0, 1, 2)}


def mean_error(outcome, seed):
    return np.abs(nine_lengths(outcome.result.groups) / nine_lengths(lengths(seed)) - 1.0).mean()


def turned(mount, true):
    a = Rotation.from_quat(mount.quaternion, scalar_first=True)
    return (a.inv() * Rotation.from_quat(true.quaternion, scalar_first=True)).magnitude()


@pytest.mark.parametrize("seed", [0, 3])
def test_perfect_poses_give_what_the_report_calls_observable(seed):
    person, _, holds = somebody(seed, PERFECT)
    outcome = calibrate(holds, TRACKERS, PRIOR)
    result, truth = outcome.result, true_lengths(person)
    assert not outcome.findings
    observable = [length for length in result.lengths if length.is_observable]
    assert set(MUST_BE_OBSERVABLE) <= {length.name for length in observable}
    for length in observable:
        assert length.value == pytest.approx(truth[length.name], rel=0.005), length.name
    for found, true, estimate in zip(
        result.subject.mounts, person.mounts, result.mounts, strict=True
    ):
        away = np.abs(np.array(found.position) - np.array(true.position))
        assert np.all(away[list(estimate.is_observable)] < 0.002), found.tracker
        assert np.degrees(turned(found, true)) < 0.3


def test_usual_poses_give_small_errors_and_honest_intervals(clean):
    errors, inside = [], []
    for seed, outcome in clean.items():
        result = outcome.result
        assert not outcome.findings
        error = nine_lengths(result.groups) / nine_lengths(lengths(seed)) - 1.0
        errors.append(error)
        deviations = nine_deviations(result.groups, result.log_covariance)
        inside.append(np.abs(error) < QUANTILE_90 * deviations)
        assert np.degrees(result.pose_sigma) == pytest.approx(5.0 / np.sqrt(3.0), rel=0.25)
        assert 0.6 < result.chi_square < 1.4
        assert result.next_pose in {pose.name for pose in EIGHT_POSES}
    assert np.abs(errors).mean() < 0.02
    assert np.mean(inside) > 0.7


def test_a_pose_with_the_arms_swapped_is_named_and_left_out(clean):
    wrong = list(EIGHT_POSES)
    wrong[1] = replace(wrong[1], other_angles=with_swapped(wrong[1].angles, "arms"))
    errors = []
    for seed in clean:
        rng = np.random.default_rng((seed, 9))
        person = somebody(seed)[0]
        holds = held(person, EIGHT_POSES, perform(person, wrong, USUAL, rng), USUAL, rng)
        outcome = calibrate(holds, TRACKERS, PRIOR)
        (finding,) = outcome.findings
        assert finding.kind is Kind.WRONG_POSE
        assert "the arms exchanged" in finding.text
        assert outcome.repeat == ("twist",)
        expected = nine_deviations(outcome.result.groups, outcome.result.log_covariance)
        least = nine_deviations(clean[seed].result.groups, clean[seed].result.log_covariance)
        assert expected.mean() < 1.2 * least.mean()
        errors.append(mean_error(outcome, seed))
    assert np.mean(errors) < 0.03


def exchanged(holds, order):
    return [replace(h, positions=h.positions[order], quaternions=h.quaternions[order])
            for h in holds]  # fmt: skip


@pytest.mark.parametrize(
    ("order", "named"),
    [
        ([0, 1, 3, 2, 4, 5], {"lhand", "rhand"}),
        ([0, 1, 3, 2, 5, 4], {"lhand", "rhand", "lankle", "rankle"}),
        ([0, 1, 4, 3, 2, 5], {"lhand", "lankle"}),
        ([1, 0, 2, 3, 4, 5], {"head", "torso"}),
    ],
)
def test_exchanged_trackers_are_named_and_put_right(clean, order, named):
    outcome = calibrate(exchanged(somebody(1)[2], order), TRACKERS, PRIOR)
    (finding,) = outcome.findings
    assert finding.kind is Kind.EXCHANGED
    assert set(finding.trackers) == named
    assert mean_error(outcome, 1) == pytest.approx(mean_error(clean[1], 1), abs=2e-3)
    bones = {m.tracker: m.bone for m in outcome.result.subject.mounts}
    usual = [m.bone for m in TRACKERS]
    assert [bones[m.tracker] for m in TRACKERS] == [usual[k] for k in np.argsort(order)]


@pytest.mark.parametrize(
    ("factor", "unit"),
    [(100.0, "centimeters"), (1000.0, "millimeters"), (39.37, "inches"), (3.281, "feet")],
)
def test_other_units_are_named(factor, unit):
    holds = [replace(h, positions=factor * h.positions) for h in somebody(0)[2]]
    outcome = calibrate(holds, TRACKERS, PRIOR)
    assert outcome.calibration is None
    (finding,) = outcome.findings
    assert finding.kind is Kind.UNITS
    assert unit in finding.text
    with pytest.raises(LocalregError, match=unit):
        _ = outcome.result


@pytest.mark.parametrize("factor", [0.0, 11.0])
def test_places_that_are_no_person_are_refused(factor):
    holds = [replace(h, positions=factor * h.positions) for h in somebody(0)[2]]
    outcome = calibrate(holds, TRACKERS, PRIOR)
    assert outcome.calibration is None
    assert outcome.findings[0].is_fatal


def test_a_tracker_that_slips_between_poses_is_named(clean):
    person, qpos, before = somebody(2)
    mounts = list(person.mounts)
    old = mounts[4]
    turn = Rotation.from_quat(old.quaternion, scalar_first=True) * Rotation.from_rotvec(
        [0.3, 0.1, 0.1]
    )
    x, y, z = old.position
    place = (x + 0.04, y + 0.03, z + 0.02)
    mounts[4] = Mount(old.tracker, old.bone, place, tuple(turn.as_quat(scalar_first=True).tolist()))
    rng = np.random.default_rng(0)
    after = held(replace(person, mounts=tuple(mounts)), EIGHT_POSES, qpos, USUAL, rng)
    outcome = calibrate([*before[:4], *after[4:]], TRACKERS, PRIOR)
    (finding,) = outcome.findings
    assert finding.kind is Kind.SLIPPED
    assert finding.trackers == ("lankle",)
    assert "between poses ski low and ski wide" in finding.text
    found = outcome.result.subject.mounts[4]
    assert turned(found, mounts[4]) < np.radians(8.0)
    assert mean_error(outcome, 2) < 1.5 * mean_error(clean[2], 2) + 0.005


def test_a_tracker_on_another_bone_is_named(clean):
    person, qpos, _ = somebody(1)
    mounts = list(person.mounts)
    mounts[0] = Mount("head", "lradius", (0.05, 0.02, 0.0), mounts[0].quaternion)
    rng = np.random.default_rng(0)
    holds = held(replace(person, mounts=tuple(mounts)), EIGHT_POSES, qpos, USUAL, rng)
    outcome = calibrate(holds, TRACKERS, PRIOR)
    finding = outcome.findings[0]
    assert finding.kind is Kind.MISPLACED
    assert finding.trackers == ("head",)
    assert "lhumerus" in finding.text or "lradius" in finding.text
    arms = [length for length in outcome.result.lengths if "arm" in length.name]
    truth = true_lengths(person)
    for arm in arms:
        assert arm.value == pytest.approx(truth[arm.name], rel=0.05)


def test_one_joint_far_off_gives_the_pose_away():
    person, qpos, _ = somebody(0)
    qpos = qpos.copy()
    qpos[4, 7 + DOF_NAMES.index("lhumerusrz")] += np.radians(45.0)
    rng = np.random.default_rng(0)
    outcome = calibrate(held(person, EIGHT_POSES, qpos, USUAL, rng), TRACKERS, PRIOR)
    assert outcome.repeat == ("ski wide",)


def test_fewer_poses_and_known_height_show_in_the_deviations(clean):
    holds = somebody(1)[2]
    quick = calibrate(holds[:1], TRACKERS, PRIOR, method="T-pose").result
    whole = clean[1].result
    for few, many in zip(quick.lengths, whole.lengths, strict=True):
        assert few.deviation > 0.95 * many.deviation, few.name
    assert np.mean(nine_deviations(quick.groups, quick.log_covariance)) > 2.0 * np.mean(
        nine_deviations(whole.groups, whole.log_covariance)
    )


def test_an_unseen_tracker_is_named_and_the_rest_goes_on():
    holds = list(somebody(0)[2])
    mask = holds[3].position_mask.copy()
    mask[2] = False
    holds[3] = replace(holds[3], position_mask=mask, orientation_mask=mask)
    outcome = calibrate(holds, TRACKERS, PRIOR)
    finding = outcome.findings[0]
    assert finding.kind is Kind.UNSEEN
    assert finding.trackers == ("lhand",)
    assert "ski low" in finding.text
    assert mean_error(outcome, 0) < 0.03


def test_what_cannot_be_calibrated_is_said():
    holds = somebody(0)[2]
    with pytest.raises(LocalregError, match="no pose at all"):
        calibrate([], TRACKERS, PRIOR)
    with pytest.raises(LocalregError, match="juggling"):
        calibrate([replace(holds[0], pose="juggling")], TRACKERS, PRIOR)
    blind = np.array([True, True, False, False, False, False])
    with pytest.raises(LocalregError, match="three at least"):
        calibrate([replace(holds[0], position_mask=blind)], TRACKERS, PRIOR)


def test_the_subject_file_keeps_what_is_known(clean, tmp_path):
    result = clean[0].result
    path = tmp_path / "me.toml"
    write_subject(result.subject, path)
    record = read_subject(path).calibration
    assert record is not None
    assert record.poses == tuple(pose.name for pose in EIGHT_POSES)
    assert set(record.position_sd) == {m.tracker for m in TRACKERS}
    assert "lfemur" in record.observable
    assert "head" not in record.observable
    assert record.pose_error == pytest.approx(result.pose_sigma)


def test_the_report_names_every_length(clean):
    console = Console(record=True, width=120, file=StringIO())
    console.print(lengths_table(clean[0].result, true_lengths(somebody(0)[0])))
    console.print(mounts_table(clean[0].result))
    text = console.export_text()
    assert all(name in text for name in (*REPORTED, *(m.tracker for m in TRACKERS)))
    assert any("would sharpen" in line for line in summary_lines(clean[0].result))
    assert findings_lines([]) == []


def test_means_of_holds_are_as_well_known_as_noise_allows():
    holds = somebody(0)[2]
    sigma = np.sqrt([np.trace(c) / 3 for c in holds[0].position_covariances])
    np.testing.assert_allclose(sigma, np.hypot(5e-4, 0.003 / np.sqrt(80)), rtol=0.15)
    with pytest.raises(LocalregError, match="hold it for longer"):
        Hold.of_frames("T", [])


def test_people_from_real_files_are_found(motions_dir):
    people = find_skeletons(motions_dir)
    prior = learn({name: row for name, row in people.items() if name != "03"})
    rng = np.random.default_rng(5)
    person = random_person(people["03"], TRACKERS, 0.03, rng)
    holds = held(person, EIGHT_POSES, perform(person, EIGHT_POSES, USUAL, rng), USUAL, rng)
    result = calibrate(holds, TRACKERS, prior).result
    assert np.abs(nine_lengths(result.groups) / nine_lengths(people["03"]) - 1).mean() < 0.025


def test_somebody_is_calibrated_before_the_view(tmp_path: Path):
    seed = 1
    worn, qpos, _ = somebody(seed)
    person = Person(tmp_path / "takes", worn)
    desk, panel = Desk(person), WizardPanel(settings=SETTINGS, motion=0.0)
    panel.begin(desk)
    assert panel.wizard is not None
    before = qpos[0]
    for number, pose in enumerate(qpos):
        assert panel.wizard.snapshot().number == number + 1
        hold(panel, desk, person, before, pose)
        before = pose
    assert panel.wizard.state is State.DONE
    assert desk.target is None
    panel.join(PATIENCE)
    hold(panel, desk, person, before, before)
    assert "begin the next run with it" in panel.words
    (file,) = (tmp_path / "takes").glob("*.toml")
    assert file.name in panel.words
    assert str(tmp_path) not in panel.words
    found = read_subject(file)
    assert found.trackers == worn.trackers
    assert read_knowledge(found, known_file(file)) is not None
    truth = np.linalg.norm(worn.offsets, axis=1)
    long = truth > 0.1
    errors = np.abs(np.linalg.norm(found.offsets, axis=1)[long] / truth[long] - 1.0)
    assert errors.mean() < 0.05
