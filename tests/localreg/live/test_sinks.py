import numpy as np
import pytest

from localreg.errors import LocalregError
from localreg.live.sinks import Collector, LivePose, MotionFile
from localreg.motion.formats.registry import read_motion
from tests.localreg.live.scripted import RATE, SUBJECT, ScriptedEstimator, frame, instant


def live(n: int, held: bool = False) -> LivePose:
    _, pose = ScriptedEstimator().step(0, frame(n))
    return LivePose(n, frame(n), pose, held, n == 0)


def test_the_collector_keeps_what_it_is_handed():
    collector = Collector()
    for n in (4, 5, 6):
        collector.publish(live(n, held=n == 5))
    assert collector.indices.tolist() == [4, 5, 6]
    np.testing.assert_allclose(collector.times, [instant(n) for n in (4, 5, 6)])
    assert collector.qpos[:, 0].tolist() == [4.0, 5.0, 6.0]
    assert collector.held.tolist() == [False, True, False]


def test_the_collector_is_bounded_and_says_what_it_refused():
    collector = Collector(capacity=3)
    for n in range(5):
        collector.publish(live(n))
    assert len(collector) == 3
    assert collector.refused == 2
    assert collector.qpos[:, 0].tolist() == [0.0, 1.0, 2.0]


def test_missing_instants_repeat_the_pose_before():
    collector = Collector()
    for n in (2, 3, 6):
        collector.publish(live(n))
    motion = collector.motion(SUBJECT, RATE, "run")
    assert motion.qpos[:, 0].tolist() == [2.0, 3.0, 3.0, 3.0, 6.0]
    assert motion.rate == RATE


def test_nothing_collected_makes_no_motion():
    with pytest.raises(LocalregError, match="not one pose came"):
        Collector().motion(SUBJECT, RATE, "run")


def test_the_motion_file_is_read_again(tmp_path):
    sink = MotionFile(tmp_path / "run.bvh", SUBJECT, RATE)
    for n in (0, 1, 2, 5):
        sink.publish(live(n))
    sink.close()
    sink.close()
    (motion,) = read_motion(tmp_path / "run.bvh")
    assert len(motion) == 6
    assert motion.rate == pytest.approx(RATE, rel=1e-6)
    np.testing.assert_allclose(motion.qpos[:, 0], [0, 1, 2, 2, 2, 5], atol=1e-5)


def test_no_file_is_written_of_nothing(tmp_path):
    MotionFile(tmp_path / "run.bvh", SUBJECT, RATE).close()
    assert not list(tmp_path.iterdir())
