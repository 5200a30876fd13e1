import numpy as np
import pytest

from localreg.live.performance import Performance, PerformanceConfig, tracker_residual
from localreg.synthesis.estimator import Result
from tests.localreg.live.scripted import PERIOD, ScriptedEstimator, frame, number


def play(estimator, seen, **settings):
    """Outcomes for frames with so many trackers each."""
    performance = Performance(lambda _: estimator, config=PerformanceConfig(**settings))
    return performance, [performance.take(frame(n, s)) for n, s in enumerate(seen)]


def shown(outcomes):
    return [None if o is None else round(o.pose.qpos[0]) for o in outcomes]


def test_it_waits_for_enough_trackers_to_begin():
    estimator = ScriptedEstimator()
    _, outcomes = play(estimator, [0, 1, 2, 3, 6], min_trackers=3)
    assert shown(outcomes) == [None, None, None, 3, 4]
    assert estimator.inits == [3]
    assert [o.is_start for o in outcomes if o] == [True, False]


def test_the_first_pose_does_not_count_as_two_steps():
    estimator = ScriptedEstimator()
    performance, _ = play(estimator, [6, 6, 6])
    assert estimator.steps == [0, 1, 2]
    assert performance._state == 2


def test_a_short_blindness_is_left_to_the_estimator():
    estimator = ScriptedEstimator()
    performance, outcomes = play(estimator, [6, 6, 0, 0, 0, 6], coast=4.5 * PERIOD)
    assert shown(outcomes) == [0, 1, 2, 3, 4, 5]
    assert not any(o.is_held for o in outcomes)
    assert estimator.inits == [0]
    assert performance.counters.blind_frames == 3
    assert performance.counters.held_frames == 0


def test_a_long_blindness_holds_the_pose_and_ends_with_a_new_start():
    estimator = ScriptedEstimator()
    performance, outcomes = play(
        estimator, [6, 6, 0, 0, 0, 0, 1, 6, 6], coast=2.5 * PERIOD, min_trackers=3
    )
    assert shown(outcomes) == [0, 1, 2, 3, 3, 3, 3, 7, 8]
    assert [o.is_held for o in outcomes] == [False] * 4 + [True] * 3 + [False] * 2
    assert estimator.inits == [0, 7]
    assert performance.counters.held_frames == 3


@pytest.mark.parametrize("kind", ["failed", "not finite"])
def test_after_many_failures_in_a_row_the_body_is_found_anew(kind):
    failing = range(3, 12)
    if kind == "failed":
        estimator = ScriptedEstimator(results=dict.fromkeys(failing, Result.FAILED))
    else:
        estimator = ScriptedEstimator(bad=frozenset(failing))
    performance, outcomes = play(estimator, [6] * 14, patience=4)
    assert shown(outcomes) == [0, 1, 2] + [2] * 9 + [12, 13]
    assert estimator.inits == [0, 7, 11]
    assert performance.counters.failed_frames == 9
    assert all(np.isfinite(o.pose.qpos).all() for o in outcomes)


def test_another_estimator_begins_anew_and_holds_till_it_sees():
    first, second = ScriptedEstimator(), ScriptedEstimator()
    performance = Performance(lambda t: first if number(t) < 3 else second)
    outcomes = [performance.take(frame(n, s)) for n, s in enumerate([6, 6, 6, 0, 2, 6, 6])]
    assert shown(outcomes) == [0, 1, 2, 2, 2, 5, 6]
    assert [o.is_held for o in outcomes] == [False, False, False, True, True, False, False]
    assert (first.inits, second.inits) == ([0], [5])
    assert performance.counters.starts == 2


def test_a_reacquired_body_is_marked_as_a_start():
    estimator = ScriptedEstimator(results={2: Result.REACQUIRED})
    performance, outcomes = play(estimator, [6] * 4)
    assert [o.is_start for o in outcomes] == [True, False, True, False]
    assert performance.counters.reacquired_frames == 1


def test_the_residual_is_over_what_was_measured():
    _, (outcome,) = play(ScriptedEstimator(), [4])
    assert tracker_residual(outcome.pose) == pytest.approx(0.001)
    blind = outcome.pose._replace(position_residuals=np.full(6, np.nan))
    assert np.isnan(tracker_residual(blind))
