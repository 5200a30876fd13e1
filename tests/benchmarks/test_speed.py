"""The speed benchmark: its clocks, its gate and its made-larger motion; never a speed itself."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.larger import made_larger
from benchmarks.latency import Stopwatch, played_clips
from benchmarks.measures import (
    CALIBRATION,
    MEASURES,
    STAGES,
    broken_bounds,
    calibration_ms,
    known,
    regressions,
    table,
)
from benchmarks.scaling import BASELINE, plot
from localreg.database import PoseDatabase
from localreg.errors import MotionError
from tests.localreg.database.made_motion import make_motion

MOTIONS = [make_motion(seed, 240, 120.0) for seed in range(3)]


def figures(**changes: float) -> dict[str, float]:
    """Figures that keep every promise."""
    good = {m.key: (m.bound if m.bound is not None else 1.0) for m in MEASURES}
    return {CALIBRATION: 4.0, **good, **changes}


@pytest.mark.parametrize("poses", [50, 161, 1000])
@pytest.mark.parametrize("mirror", [True, False])
def test_made_larger_to_the_pose(poses: int, mirror: bool) -> None:
    made = list(made_larger(MOTIONS, poses, 40.0, mirror=mirror))
    database = PoseDatabase.build(made, mirror=mirror)
    assert poses <= len(database) <= poses + 1
    names = [clip.name for clip in database.clips]
    assert len(set(names)) == len(names)
    for motion in made[len(MOTIONS) :]:
        assert "~" in motion.provenance.name
        assert motion.provenance.source == "made larger"


def test_real_motion_comes_first_and_variants_are_smooth_and_new() -> None:
    made = list(made_larger(MOTIONS, 1500, 40.0))
    real = [motion.resampled(40.0).nearest_to_rest() for motion in MOTIONS]
    for one, other in zip(made, real, strict=False):
        np.testing.assert_array_equal(one.qpos, other.qpos)
    fastest = max(np.abs(np.diff(motion.angles, axis=0)).max() for motion in real)
    for motion in made[3:]:
        assert np.abs(np.diff(motion.angles, axis=0)).max() < 1.6 * fastest
        near = [np.abs(motion.angles[0] - other.angles).max(axis=1).min() for other in real]
        assert min(near) > 0.01
    again = list(made_larger(MOTIONS, 1500, 40.0))
    for one, other in zip(made, again, strict=True):
        np.testing.assert_array_equal(one.qpos, other.qpos)


def test_stopwatch_times_what_it_is_put_on_and_leaves_no_trace() -> None:
    class Worker:
        def work(self) -> str:
            time.sleep(0.02)
            return "done"

    watch, worker, other = Stopwatch(), Worker(), Worker()
    original = Worker.work
    with watch.on("one", worker, "work"):
        assert worker.work() == "done"
        other.work()
    assert "work" not in vars(worker)
    spent = watch.read()
    assert set(spent) == {"one"}
    assert spent["one"] >= 0.02
    with watch.on("all", Worker, "work"):
        worker.work()
        other.work()
    assert Worker.work is original
    assert watch.read()["all"] >= 0.04
    assert watch.read() == {}


def test_played_clips_are_those_of_the_database(tmp_path: Path) -> None:
    PoseDatabase.build(MOTIONS, mirror=False).save(tmp_path / "played")
    clips = played_clips(tmp_path / "played")
    for clip, motion in zip(clips, MOTIONS, strict=True):
        expected = motion.resampled(40.0).nearest_to_rest().qpos
        np.testing.assert_allclose(clip.qpos, expected, atol=1e-6)


def test_promises() -> None:
    assert broken_bounds(figures()) == []
    (line,) = broken_bounds(figures(growth=2.6))
    assert "2.6" in line
    assert "promised 2.5" in line
    assert len(broken_bounds(figures(offline_frames_per_s=2999.0))) == 1
    assert broken_bounds({}) == []


def test_the_gate_passes_what_varies_and_stops_what_is_worse() -> None:
    before = figures()
    assert regressions(before, before) == []
    for measure in MEASURES:
        worse = -1.0 if measure.more_is_better else 1.0
        for share, count in ((0.9, 0), (1.1, 1)):
            value = before[measure.key] * (1.0 + worse * share * measure.tolerance)
            assert len(regressions(figures(**{measure.key: value}), before)) == count
        better = before[measure.key] * (1.0 - 0.5 * worse)
        assert regressions(figures(**{measure.key: better}), before) == []


def test_times_are_compared_in_units_of_the_calibration() -> None:
    key = "65609.frame_p50_ms"
    before = figures()
    slow = figures(**{CALIBRATION: 8.0, key: 2.0 * before[key], "memory_mb": 1.0})
    assert not [line for line in regressions(slow, before) if "half within" in line]
    fast = figures(**{CALIBRATION: 2.0})
    assert [line for line in regressions(fast, before) if "65609 poses, half within" in line]
    fewer = figures(offline_frames_per_s=2500.0)
    assert not [line for line in regressions(fewer, before) if "evaluated frames" in line]
    assert [
        line for line in regressions({**fewer, CALIBRATION: 2.0}, before) if "evaluated" in line
    ]
    assert not [line for line in regressions(fast, before) if "memory" in line]


def test_the_calibration_takes_time() -> None:
    assert 0.0 < calibration_ms(rounds=2) < 1e4


def test_keys_are_unique_and_the_committed_baseline_is_of_them() -> None:
    keys = [measure.key for measure in MEASURES]
    assert len(set(keys)) == len(keys)
    baseline = json.loads(BASELINE.read_text())
    assert known(baseline) == baseline
    assert baseline[CALIBRATION] > 0.0
    assert {"65609.frame_p50_ms", "1100000.frame_p50_ms"} <= set(baseline)


def test_table_and_plot(tmp_path: Path) -> None:
    text = table(figures())
    assert text.count("\n") == len(MEASURES) + 1
    assert "≤ 2.5 ms" in text
    assert all(f"1100000.{stage}_p50_ms" in figures() for stage in STAGES)
    plot(figures(), tmp_path / "speed.png")
    assert (tmp_path / "speed.png").stat().st_size > 5000


def test_no_motion_cannot_be_made_larger() -> None:
    with pytest.raises(MotionError, match="no motion"):
        list(made_larger([], 100, 40.0))
