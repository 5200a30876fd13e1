"""The figures against cases that can be computed by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.kinematics import Kinematics, bone_ends_batch
from localreg.body.skeleton import BODY_NAMES, DOF_NAMES
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.metrics import (
    FIGURES,
    JOINTED_BONES,
    SETTLING_FRAMES,
    Figures,
    compare,
    geodesic_errors_deg,
    jitter_m_s3,
    joint_angle_errors_deg,
    mean_figures,
)
from localreg.motion.contacts import FOOT_ENDS, foot_contacts
from localreg.motion.motion import Motion
from tests.localreg.database.made_motion import make_motion

RATE = 40.0


@pytest.fixture(scope="module")
def truth() -> Motion:
    return make_motion(5, 60, rate=RATE)


@pytest.fixture(scope="module")
def body(truth: Motion) -> BodyPoints:
    return BodyPoints(truth.subject)


def test_points_are_those_of_our_own_kinematics(truth: Motion, body: BodyPoints) -> None:
    own = bone_ends_batch(Kinematics.from_subject(truth.subject), truth.qpos)
    np.testing.assert_allclose(body.bone_ends(truth.qpos), own, atol=1e-9)


def test_the_truth_has_no_error(truth: Motion, body: BodyPoints) -> None:
    comparison = compare(truth, truth.qpos.copy(), body=body)
    figures = comparison.figures
    for name in FIGURES[:5]:
        assert getattr(figures, name) == pytest.approx(0.0, abs=1e-5), name
    assert figures.jitter_m_s3 == pytest.approx(comparison.true_jitter_m_s3)
    assert figures.foot_skate_cm_s == comparison.true_foot_skate_cm_s
    assert comparison.mpjpe_cm.shape == comparison.joint_angle_error_deg.shape == (60,)


def test_a_shift_moves_the_world_but_not_the_root_s_view(truth: Motion, body: BodyPoints) -> None:
    qpos = truth.qpos.copy()
    qpos[:, :3] += [0.03, 0.0, -0.04]
    figures = compare(truth, qpos, body=body).figures
    assert figures.mpjpe_cm == pytest.approx(5.0)
    assert figures.tracker_error_cm == pytest.approx(5.0)
    assert figures.mpjpe_root_aligned_cm == pytest.approx(0.0, abs=1e-9)
    assert figures.joint_angle_error_deg == figures.geodesic_error_deg == 0.0


def test_turning_everything_about_the_root_counts_for_all_ends_but_its_own(
    truth: Motion, body: BodyPoints
) -> None:
    turn = Rotation.from_rotvec([0.2, 0.1, -0.3])
    qpos = truth.qpos.copy()
    root = Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
    qpos[:, 3:7] = (turn * root).as_quat(scalar_first=True)
    figures = compare(truth, qpos, body=body).figures
    assert figures.mpjpe_cm is not None
    assert figures.mpjpe_cm > 5.0
    assert figures.mpjpe_root_aligned_cm == pytest.approx(figures.mpjpe_cm * 31 / 30)


def test_one_angle_wrong_counts_as_one_of_56_and_one_of_28(truth: Motion, body: BodyPoints) -> None:
    qpos = truth.qpos.copy()
    qpos[:, 7 + DOF_NAMES.index("lradiusrx")] += np.radians(30.0)
    figures = compare(truth, qpos, body=body).figures
    assert figures.joint_angle_error_deg == pytest.approx(30.0 / 56)
    # A bone with one hinge turns by just that angle.
    assert figures.geodesic_error_deg == pytest.approx(30.0 / 28)


def test_figures_by_joint_say_which_one_was_wrong(truth: Motion, body: BodyPoints) -> None:
    qpos = truth.qpos.copy()
    dof = DOF_NAMES.index("lradiusrx")
    qpos[:, 7 + dof] += np.radians(30.0)
    comparison = compare(truth, qpos, body=body)
    angles = comparison.joint_angle_error_by_dof_deg
    assert angles[dof] == pytest.approx(30.0)
    assert np.delete(angles, dof).max() < 1e-9
    turns = dict(zip(JOINTED_BONES, comparison.geodesic_error_by_bone_deg, strict=True))
    assert turns.pop("lradius") == pytest.approx(30.0)
    assert max(turns.values()) < 1e-5
    ends = dict(zip(BODY_NAMES, comparison.position_error_by_end_cm, strict=True))
    moved = {name for name, error in ends.items() if error > 1e-6}
    assert moved == {"lradius", "lwrist", "lhand", "lfingers", "lthumb"}
    assert np.mean(list(ends.values())) == pytest.approx(comparison.figures.mpjpe_cm)


def test_errors_as_large_as_predicted_have_a_standardized_error_of_one(
    truth: Motion, body: BodyPoints
) -> None:
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.01, 0.1, (60, 56))
    qpos = truth.qpos.copy()
    qpos[:, 7:] += sigma * rng.standard_normal(sigma.shape)
    sigma[10:20, 3] = np.nan  # nothing predicted
    known = compare(truth, qpos, body=body, predicted_sigma=sigma).standardized_error
    assert known == pytest.approx(1.0, abs=0.05)
    sure = compare(truth, qpos, body=body, predicted_sigma=0.5 * sigma).standardized_error
    assert sure == pytest.approx(2.0 * known)
    nothing = np.full((60, 56), np.nan)
    assert compare(truth, qpos, body=body, predicted_sigma=nothing).standardized_error is None
    assert compare(truth, qpos, body=body).standardized_error is None


def test_whole_turns_are_no_error() -> None:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, (4, 56))
    turned = angles + 2.0 * np.pi * rng.integers(-2, 3, angles.shape)
    np.testing.assert_allclose(joint_angle_errors_deg(turned, angles), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        joint_angle_errors_deg(angles + 3.0, angles - 3.0), 16.225, atol=0.01
    )


def test_the_geodesic_error_is_the_angle_between_rotations() -> None:
    rng = np.random.default_rng(1)
    true, made = np.zeros((1, 56)), np.zeros((1, 56))
    z, y, x = (DOF_NAMES.index("lfemurr" + axis) for axis in "zyx")
    true[0, [z, y, x]], made[0, [z, y, x]] = rng.uniform(-1, 1, (2, 3))
    a, b = (Rotation.from_euler("ZYX", angles[0, [z, y, x]]) for angles in (true, made))
    expected = np.degrees((a.inv() * b).magnitude())
    assert geodesic_errors_deg(made, true)[0].sum() == pytest.approx(expected)
    # (z + pi, pi - y, x + pi) is the same rotation, though every angle differs.
    same = true.copy()
    same[0, [z, y, x]] = true[0, z] + np.pi, np.pi - true[0, y], true[0, x] + np.pi
    assert geodesic_errors_deg(same, true)[0].max() == pytest.approx(0.0, abs=1e-4)
    assert joint_angle_errors_deg(same, true)[0].max() > 90.0
    half = true.copy()
    half[0, x] += np.pi
    assert geodesic_errors_deg(half, true)[0].sum() == pytest.approx(180.0, abs=1e-4)


def test_jitter_is_the_third_derivative() -> None:
    seconds = np.arange(50) / RATE
    cubic = np.zeros((50, 2, 3))
    cubic[:, 0, 1] = 0.5 * seconds**3 + seconds**2 - seconds
    cubic[:, 1, 2] = 2.0 * seconds**2
    assert jitter_m_s3(cubic, RATE) == pytest.approx(3.0 / 2, rel=1e-6)
    assert jitter_m_s3(cubic[:3], RATE) is None


def test_white_noise_jitters_as_computed() -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.003, (4000, 4, 3))
    # The third difference has variance 1 + 9 + 9 + 1; a 3-D normal's mean norm is 1.5958.
    expected = 1.5958 * np.sqrt(20.0) * 0.003 * RATE**3
    assert jitter_m_s3(noise, RATE) == pytest.approx(expected, rel=0.02)


def stepping(frames: int = 80) -> np.ndarray:
    """Ends of which the left foot stands and lifts by turns, and the right is in the air."""
    ends = np.zeros((frames, 31, 3))
    phase = 2.0 * np.pi * np.arange(frames) / 40.0
    lift = np.maximum(np.sin(phase), 0.0)
    for name in ("lfoot", "ltoes"):
        ends[:, BODY_NAMES.index(name), 2] = 0.02 + 0.3 * lift
    for name in ("rfoot", "rtoes"):
        ends[:, BODY_NAMES.index(name), 0] = np.arange(frames) / RATE * 2.0
        ends[:, BODY_NAMES.index(name), 2] = 0.4
    return ends


def test_feet_stand_where_they_are_low_and_slow() -> None:
    contacts = foot_contacts(stepping(), RATE)
    assert contacts.shape == (80, 4)
    assert contacts[22:38, :2].all()
    assert not contacts[3:17, :2].any()
    assert not contacts[:, 2:].any(), "a foot that slides at 2 m/s does not stand"
    assert not foot_contacts(stepping(1), RATE).any()


def test_skate_is_the_speed_of_standing_feet(body: BodyPoints) -> None:
    still = make_motion(1, 40, rate=RATE, amplitude=0.0)
    still = replace(still, qpos=np.repeat(still.qpos[:1], 40, axis=0))
    assert compare(still, still.qpos, body=body).figures.foot_skate_cm_s == pytest.approx(0.0)
    sliding = still.qpos.copy()
    sliding[:, 1] += 0.07 * np.arange(40) / RATE
    sliding[:, 2] += 0.50 * np.arange(40) / RATE  # up is not along the ground
    assert compare(still, sliding, body=body).figures.foot_skate_cm_s == pytest.approx(7.0)
    flying = make_motion(1, 40, rate=RATE, amplitude=0.0)
    flying.qpos[:, 0] *= 5.0
    comparison = compare(flying, flying.qpos, body=body)
    assert comparison.figures.foot_skate_cm_s is None
    assert comparison.true_foot_skate_cm_s is None
    assert len(FOOT_ENDS) == 4


def test_the_first_frames_do_not_count(truth: Motion, body: BodyPoints) -> None:
    qpos = truth.qpos.copy()
    qpos[:SETTLING_FRAMES, :3] += 1.0
    qpos[:SETTLING_FRAMES, 7:] += 0.5
    comparison = compare(truth, qpos, body=body)
    exact = compare(truth, truth.qpos, body=body)
    assert comparison.figures == exact.figures
    assert comparison.mpjpe_cm[SETTLING_FRAMES - 1] > 100.0
    assert comparison.mpjpe_cm[SETTLING_FRAMES] == 0.0
    first = compare(truth.first(SETTLING_FRAMES), qpos[:SETTLING_FRAMES], body=body)
    assert first.figures == Figures()
    with pytest.raises(ValueError, match="59 poses"):
        compare(truth, qpos[:59], body=body)


def test_a_pose_that_is_no_number_spoils_its_figures(truth: Motion, body: BodyPoints) -> None:
    qpos = truth.qpos.copy()
    qpos[30, 20] = np.nan
    comparison = compare(truth, qpos, body=body)
    for name in FIGURES[:6]:
        assert np.isnan(getattr(comparison.figures, name)), name
    assert np.isfinite(comparison.true_jitter_m_s3)
    assert np.isnan(comparison.mpjpe_cm[30])
    assert np.isfinite(np.delete(comparison.mpjpe_cm, 30)).all()


def test_means_are_unweighted_and_pass_over_what_is_not_there() -> None:
    mean = mean_figures(
        [Figures(mpjpe_cm=1.0, jitter_m_s3=3.0), Figures(mpjpe_cm=2.0), Figures(mpjpe_cm=6.0)]
    )
    assert mean == Figures(mpjpe_cm=3.0, jitter_m_s3=3.0)
    broken = mean_figures([Figures(mpjpe_cm=1.0), Figures(mpjpe_cm=float("nan"))])
    assert np.isnan(broken.mpjpe_cm), "breaking down must not improve a mean"
