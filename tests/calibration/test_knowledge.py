"""What is known of a subject: joined, kept beside its file, and made up from its record."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.anthropometry import GROUP_COUNT, GROUPS
from calibration.calibrate import calibrate
from calibration.eigen_skeleton import average_subject, lengths_of
from calibration.knowledge import (
    UNKNOWN_MOUNT,
    Knowledge,
    known_file,
    read_knowledge,
    write_knowledge,
)
from localreg.body.subject import CalibrationRecord, canonical_subject
from localreg.errors import LocalregError
from tests.calibration.people import PRIOR, TRACKERS, somebody


@pytest.fixture(scope="module")
def result():
    """Somebody's calibration."""
    return calibrate(somebody(1)[2], TRACKERS, PRIOR).result


def test_a_calibration_knows_what_it_reports(result):
    known = result.knowledge
    np.testing.assert_allclose(known.log_lengths, result.log_covariance, rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(known.position_sd, [m.position_sd for m in result.mounts], rtol=1e-5)
    np.testing.assert_allclose(known.turn_sd, [m.orientation_sd for m in result.mounts], rtol=1e-5)
    # A longer shank takes the tracker at its end along, down the bone's own axis.
    shank = GROUPS.index("tibia")
    ankle = known.covariance[shank, GROUP_COUNT + 3 * 4 : GROUP_COUNT + 3 * 5]
    along = canonical_subject().directions[2]
    assert float(ankle @ along) > 0.0


def test_it_is_kept_beside_the_subject(result, tmp_path):
    path = known_file(tmp_path / "me.toml")
    assert path.name == "me.known.json"
    assert read_knowledge(result.subject, path) is None
    write_knowledge(result.knowledge, result.subject, path)
    again = read_knowledge(result.subject, path)
    assert again is not None
    np.testing.assert_array_equal(again.covariance, result.knowledge.covariance)
    other = replace(result.subject, lengths=1.01 * result.subject.lengths)
    assert read_knowledge(other, path) is None
    assert read_knowledge(result.subject.with_trackers(("head",)), path) is None
    for damage in ("", "[]", '{"version": 2}', path.read_text().replace("covariance", "x")):
        path.write_text(damage)
        with pytest.raises(LocalregError, match="delete it"):
            read_knowledge(result.subject, path)
    with pytest.raises(LocalregError, match="cannot write"):
        write_knowledge(result.knowledge, result.subject, tmp_path / "nowhere" / "x.json")


def test_a_record_alone_gives_its_deviations_and_usual_proportions():
    person = replace(average_subject(PRIOR), mounts=TRACKERS)
    nothing = Knowledge.of_record(person, PRIOR)
    np.testing.assert_allclose(nothing.log_lengths, PRIOR.covariance, rtol=1e-6, atol=1e-12)
    assert np.all(nothing.position_sd == UNKNOWN_MOUNT[0])
    sure = CalibrationRecord(
        date="2026-01-01",
        length_sd={"lfemur": 0.004, "rfemur": 0.004},
        position_sd={"head": (0.001, 0.002, 0.003)},
        orientation_sd={"head": (0.01, 0.02, 0.03)},
    )
    known = Knowledge.of_record(replace(person, calibration=sure), PRIOR)
    thigh = GROUPS.index("femur")
    relative = float(np.sqrt(known.log_lengths[thigh, thigh]))
    assert relative == pytest.approx(0.004 / lengths_of(person)[thigh], rel=0.02)
    assert known.position_sd[0].tolist() == pytest.approx([0.001, 0.002, 0.003])
    assert known.turn_sd[0].tolist() == pytest.approx([0.01, 0.02, 0.03])
    # Who has known thighs has likelier shanks.
    shank = GROUPS.index("tibia")
    assert known.log_lengths[shank, shank] < PRIOR.covariance[shank, shank]


def test_a_slipped_tracker_takes_what_was_known_of_it_along(result):
    left = result.knowledge.without_mounts({"lhand"})
    j = list(left.trackers).index("lhand")
    assert np.all(left.position_sd[j] == UNKNOWN_MOUNT[0])
    assert np.all(left.turn_sd[j] == pytest.approx(UNKNOWN_MOUNT[1]))
    others = np.arange(6) != j
    np.testing.assert_array_equal(left.position_sd[others], result.knowledge.position_sd[others])
    np.testing.assert_array_equal(left.log_lengths, result.knowledge.log_lengths)
    assert np.linalg.eigvalsh(left.covariance)[0] > 0.0
