"""What is worked out from the figures of clips, on results that were made up."""

import json

import numpy as np
import pytest

from localreg.evaluation.metrics import Comparison, Figures
from localreg.evaluation.results import ClipResult, Evaluation, Settings
from localreg.evaluation.summaries import (
    by_activity,
    by_joint,
    difference,
    extras,
    to_json,
    worse_than,
)


def result(
    name: str, method: str, error: float, activity: str = "walk", **more: float | None
) -> ClipResult:
    figures = Figures(
        joint_angle_error_deg=error, mpjpe_cm=2.0 * error, jitter_m_s3=error, foot_skate_cm_s=error
    )
    comparison = Comparison(
        figures=figures,
        true_jitter_m_s3=0.5,
        true_foot_skate_cm_s=0.25,
        joint_angle_error_deg=np.full(9, error),
        mpjpe_cm=np.full(9, error),
        joint_angle_error_by_dof_deg=np.arange(56) * error,
        geodesic_error_by_bone_deg=np.arange(28) * error,
        position_error_by_end_cm=np.arange(31) * error,
        standardized_error=error,
    )
    return ClipResult(name, 9, method, "both", comparison, np.ones(8), "01", activity, **more)


@pytest.fixture(scope="module")
def evaluation() -> Evaluation:
    errors = {
        "localreg": (1.0, 2.0, 3.0, 9.0),
        "ik": (2.0, 4.0, 6.0, 8.0),
        "ik-truth": (1.5, 1.0, 3.0, float("nan")),
    }
    clips = [
        result(f"clip{i}", method, error, "walk" if i < 3 else "", recovery_s=0.1 * i)
        for method, row in errors.items()
        for i, error in enumerate(row)
    ]
    return Evaluation(Settings(40.0, 0, "cold", 0.003, 0.5, "leave-out clip", "0"), tuple(clips))


def test_extras_are_means_and_ratios_to_the_truth(evaluation: Evaluation) -> None:
    found = extras(evaluation.of("ik"))
    assert found.standardized_error == pytest.approx(5.0)
    assert found.jitter_ratio == pytest.approx(10.0)
    assert found.foot_skate_excess_cm_s == pytest.approx(4.75)
    assert found.recovery_s == pytest.approx(0.15)


def test_clips_are_grouped_by_activity(evaluation: Evaluation) -> None:
    groups = by_activity(evaluation, "localreg", "both")
    assert {k: [c.name for c in v] for k, v in groups.items()} == {
        "unknown": ["clip3"],
        "walk": ["clip0", "clip1", "clip2"],
    }


def test_errors_by_joint_are_named(evaluation: Evaluation) -> None:
    found = by_joint(evaluation.of("ik"))
    assert [len(part) for part in found.values()] == [56, 28, 31]
    assert found["position_error_cm"]["root"] == 0.0
    assert list(found["position_error_cm"].values())[2] == pytest.approx(10.0)


def test_clips_worse_than_a_rival_are_listed(evaluation: Evaluation) -> None:
    assert worse_than(evaluation, "localreg", "ik", "both") == [("clip3", 9.0, 8.0)]
    # As good is not worse, and a rival that broke down is not better.
    assert [n for n, _, _ in worse_than(evaluation, "localreg", "ik-truth", "both")] == ["clip1"]


def test_differences_are_paired_by_clip(evaluation: Evaluation) -> None:
    found = difference(evaluation, "localreg", "ik", "both", "mpjpe_cm")
    assert (found.mean, found.clips) == (pytest.approx(-2.5), 4)


def test_the_document_has_the_contract_and_more_without_nan(evaluation: Evaluation) -> None:
    document = json.loads(json.dumps(to_json(evaluation), allow_nan=False))
    contract = evaluation.to_json()
    assert {key: document[key] for key in contract} == json.loads(json.dumps(contract))
    assert document["worse_than"]["ik"] == {"localreg": {"both": ["clip3"]}}
    assert document["worse_than"]["ik-truth"] == {"localreg": {"both": ["clip1"]}}
    assert document["differences"]["method"] == "localreg"
    assert set(document["differences"]["minus"]) == {"ik", "ik-truth"}
    assert document["per_activity"]["ik"]["both"]["walk"]["clips"] == 3
    assert document["per_activity"]["ik"]["both"]["walk"]["mpjpe_cm"] == pytest.approx(8.0)
    assert document["more"]["ik-truth"]["both"]["standardized_error"] is None
    assert document["per_joint"]["localreg"]["both"]["geodesic_error_deg"]["lfemur"] is not None
