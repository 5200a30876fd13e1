"""Which evaluations a report runs besides, and what becomes of them."""

import numpy as np
import pytest

from localreg.database import PoseDatabase
from localreg.evaluation import worker
from localreg.evaluation.execution import processes
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.sweeps import plan_series, run_series, some_clips
from localreg.motion.motion import Motion
from tests.localreg.database.made_motion import make_motion
from tests.localreg.evaluation.standing import Builder

TRACKERS = ("head", "torso", "lhand", "rhand", "lankle", "rankle")


@pytest.fixture(scope="module")
def motions() -> list[Motion]:
    return [make_motion(i, 40, rate=40.0, name=f"clip{i}") for i in range(9)]


@pytest.fixture(scope="module")
def database(motions: list[Motion]) -> PoseDatabase:
    return PoseDatabase.build(motions)


def test_series_change_one_thing_each(database: PoseDatabase) -> None:
    methods = ("localreg", "paper", "lpca", "ik", "ik-truth")
    protocol = Protocol(methods=methods, signals=("position", "both"), seed=3)
    series = {one.name: one for one in plan_series(protocol, TRACKERS, database)}
    assert list(series) == [
        "Noise", "Outliers", "Dropouts", "Trackers removed", "Database size",
    ]  # fmt: skip
    for one in series.values():
        values = [point.value for point in one.points]
        assert values == sorted(set(values))
        for point in one.points:
            assert point.protocol.signals == ("position",)
            assert point.protocol.seed == 3
            assert point.protocol.max_frames == 120
    qualities = [point.protocol.quality for point in series["Noise"].points]
    assert [q.noise_position for q in qualities] == pytest.approx([0.0, 0.003, 0.01, 0.02, 0.04])
    assert qualities[1] == protocol.quality, "the usual noise is one of the points"
    assert series["Noise"].points[0].protocol.methods == ("localreg", "paper", "ik")
    outliers = series["Outliers"].points
    assert outliers[0].protocol.methods == ("localreg", "localreg-squares", "paper", "ik")
    assert outliers[0].protocol.quality == protocol.quality
    worn = [point.protocol.trackers for point in series["Trackers removed"].points]
    assert worn[0] == TRACKERS
    assert {len(names) for names in worn[1:7]} == {5}
    assert [len(names) for names in worn[7:]] == [4, 3, 2, 1]
    sizes = series["Database size"].points
    assert sizes[-1].protocol.database_share == 1.0
    assert sizes[0].protocol.methods == ("localreg", "paper")


def test_without_a_method_that_learns_there_is_no_series_of_sizes(database: PoseDatabase) -> None:
    series = plan_series(Protocol(methods=("ik", "ik-truth")), TRACKERS[:1], database)
    assert [one.name for one in series][-1] == "Trackers removed"
    assert len(series[-1].points) == 1
    assert series[0].points[0].protocol.methods == ("ik",)


def test_curves_have_a_value_for_every_point_and_method(
    motions: list[Motion], database: PoseDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "build_estimator", Builder())
    protocol = Protocol(methods=("ik", "paper"), signals=("both",))
    series = [
        one
        for one in plan_series(protocol, TRACKERS, database)
        if one.name in ("Dropouts", "Database size")
    ]
    told: list[tuple[int, int]] = []
    with processes(database) as run:
        found = run_series(
            series, some_clips(motions, 2), database, run,
            progress=lambda done, total, _: told.append((done, total)),
        )  # fmt: skip
    assert [[curve.method for curve in curves] for curves in found] == [["ik", "paper"], ["paper"]]
    for one, curves in zip(series, found, strict=True):
        for curve in curves:
            assert curve.mpjpe_cm.shape == curve.angle_deg.shape == (len(one.points),)
            assert np.isfinite(curve.mpjpe_cm).all()
    assert found[0][0].mpjpe_cm[-1] > found[0][0].mpjpe_cm[0], "who stands on average misses some"
    shares = [done / total for done, total in told]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_some_clips_are_spread_and_none_twice(motions: list[Motion]) -> None:
    assert [m.provenance.name for m in some_clips(motions, 3)] == ["clip1", "clip4", "clip7"]
    assert some_clips(motions, 50) == motions
