"""What disturbances cost, with an estimator whose errors are known."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from localreg.database import PoseDatabase
from localreg.errors import MotionError
from localreg.evaluation import worker
from localreg.evaluation.execution import processes
from localreg.evaluation.leave_one_out import evaluate
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.results import ClipResult
from localreg.evaluation.robustness import (
    RecoveryFrames,
    growth_of,
    loss_growth,
    outlier_growth,
)
from localreg.evaluation.trackers import TrackerQuality
from localreg.motion.motion import Motion
from tests.localreg.database.made_motion import make_motion
from tests.localreg.evaluation.standing import Builder


@pytest.fixture(scope="module")
def motions() -> list[Motion]:
    return [make_motion(i, 120, rate=40.0, name=f"clip{i}") for i in range(2)] + [
        make_motion(7, 60, rate=40.0, name="short")
    ]


@pytest.fixture(scope="module")
def database(motions: Sequence[Motion]) -> PoseDatabase:
    return PoseDatabase.build(motions)


@pytest.fixture(autouse=True)
def builder(monkeypatch: pytest.MonkeyPatch) -> Builder:
    """Stands where the trackers are on average, so every tracker that goes moves it."""
    builder = Builder()
    monkeypatch.setattr(worker, "build_estimator", builder)
    return builder


def test_outliers_cost_what_they_move(motions: list[Motion], database: PoseDatabase) -> None:
    quality = TrackerQuality(outliers=0.5, outlier_position=60.0)
    protocol = Protocol(methods=("ik",), signals=("both",), quality=quality)
    told = []
    with processes(database) as run:
        (growth,) = outlier_growth(
            motions, database, protocol, run, progress=lambda *state: told.append(state)
        )
    assert growth.clips == 3
    assert growth.disturbed_mpjpe_cm > growth.undisturbed_mpjpe_cm + 300.0
    assert growth.mpjpe_growth == pytest.approx(
        growth.disturbed_mpjpe_cm / growth.undisturbed_mpjpe_cm - 1.0
    )
    assert growth.angle_growth == pytest.approx(0.0), "its joint angles are always the same"
    assert growth.recovery is None
    assert growth.worst_frame_cm > growth.disturbed_mpjpe_cm
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert told[-1][0] == told[-1][1]


def test_every_tracker_is_lost_in_turn_for_a_second(
    motions: list[Motion], database: PoseDatabase
) -> None:
    protocol = Protocol(methods=("ik",), signals=("both",))
    with processes(database) as run:
        growths = loss_growth(motions, database, protocol, run)
    names = motions[0].subject.trackers
    assert [g.disturbance for g in growths] == [f"{name} lost for 1 s" for name in names]
    for growth in growths:
        assert growth.clips == 2, "a clip of 1.5 s cannot show a tracker come back"
        assert growth.mpjpe_growth > 0.1
        assert growth.recovery == RecoveryFrames(0, 0, 0, 0), "it forgets at once"
        assert growth.worst_frame_cm > growth.disturbed_mpjpe_cm


def test_recovery_is_that_of_the_mean_of_half_of_most_and_of_the_slowest(
    motions: list[Motion], database: PoseDatabase
) -> None:
    with processes(database) as run:
        protocol = Protocol(methods=("ik",), signals=("both",))
        (one,) = evaluate(motions[:1], database, protocol, run=run).clips
    usual = np.full(120, 1.0)

    def clip(error: np.ndarray) -> ClipResult:
        return replace(one, comparison=replace(one.comparison, mpjpe_cm=error))

    disturbed = []
    for frames in (0, 1, 1, 1, 2, 2, 2, 3, 4, 11):
        error = usual.copy()
        error[20 : 20 + frames] = 1.4
        disturbed.append(clip(error))
    growth = growth_of("made up", [clip(usual)] * 10, disturbed, 10, 20)
    # In the fourth frame two clips of ten have 1.4 times their error: 1.08 times in the mean.
    assert growth.recovery == RecoveryFrames(of_means=3, half=2, most=4, slowest=11)
    assert growth.worst_frame_cm == 1.0, "while it lasted"


def test_clips_too_short_to_lose_a_tracker_are_refused(
    motions: list[Motion], database: PoseDatabase
) -> None:
    with processes(database) as run:
        with pytest.raises(MotionError, match=r"no clip lasts 2\.5 s"):
            loss_growth(motions[2:], database, Protocol(methods=("ik",)), run)
        with pytest.raises(MotionError, match=r"40 frames are too few .* give 100 or more"):
            loss_growth(motions, database, Protocol(methods=("ik",), max_frames=40), run)


def test_a_share_of_the_database_is_whole_recordings_and_part_of_a_larger_share(
    database: PoseDatabase, builder: Builder
) -> None:
    many = [make_motion(i, 60, rate=40.0, name=f"m{i}") for i in range(12)]
    database = PoseDatabase.build(many)
    seen: list[set[str]] = []
    for share in (0.25, 0.5, 1.0):
        builder.asked.clear()
        protocol = Protocol(methods=("paper",), signals=("both",), database_share=share)
        with processes(database) as run:
            evaluate(many[:1], database, protocol, run=run)
        allowed = builder.asked[0][2]
        assert allowed is not None
        index = np.unique(database.clip_index[allowed])
        names = {database.clips[i].name for i in index}
        assert allowed.sum() == sum(database.clips[i].length for i in index)
        assert {f"{name.removesuffix('-mirrored')}-mirrored" for name in names} <= names
        seen.append(names)
    assert seen[0] < seen[1] < seen[2]
    assert len(seen[0]) == 6, "a quarter of eleven, rounded up, each with its image"
    assert len(seen[2]) == 22
