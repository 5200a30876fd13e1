import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from localreg.live.performance import Performance, tracker_residual
from localreg.live.performance_config import PerformanceConfig
from localreg.synthesis.estimator import Result
from tests.localreg.live.scripted import PERIOD, Inline, ScriptedEstimator, frame, number


def play(estimator, seen, **settings):
    """Outcomes for frames with so many trackers each."""
    config = PerformanceConfig(**settings)
    performance = Performance(lambda _: estimator, Inline(), config=config)
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
        inits = [0, 7, 11]
    else:
        # A body whose first pose is not finite is not begun with: it is tried again at once.
        estimator = ScriptedEstimator(bad=frozenset(failing))
        inits = [0, 7, 8, 9, 10, 11, 12]
    performance, outcomes = play(estimator, [6] * 14, patience=4)
    assert shown(outcomes) == [0, 1, 2] + [2] * 9 + [12, 13]
    assert estimator.inits == inits
    assert performance.counters.failed_frames == 9
    assert all(np.isfinite(o.pose.qpos).all() for o in outcomes)


def test_another_estimator_begins_anew_and_holds_till_it_sees():
    first, second = ScriptedEstimator(), ScriptedEstimator()
    performance = Performance(lambda t: first if number(t) < 3 else second, Inline())
    outcomes = [performance.take(frame(n, s)) for n, s in enumerate([6, 6, 6, 0, 2, 6, 6])]
    assert shown(outcomes) == [0, 1, 2, 2, 2, 5, 6]
    assert [o.is_held for o in outcomes] == [False, False, False, True, True, False, False]
    assert (first.inits, second.inits) == ([0], [5])
    assert performance.counters.starts == 2


def test_frames_that_come_while_a_body_is_found_are_caught_up_with():
    first, second = ScriptedEstimator(), ScriptedEstimator()
    executor = Inline(patient=True)
    performance = Performance(lambda t: first if number(t) < 2 else second, executor)
    outcomes = []
    for n, (seen, found) in enumerate(
        [(6, True), (6, False), (6, False), (6, False), (0, False), (6, True), (6, True)]
    ):
        if found and n:
            executor.finish()
        outcome = performance.take(frame(n, seen))
        if n == 0:
            assert outcome is None
            executor.finish()
        outcomes.append(outcome)
    assert shown(outcomes) == [None, 1, 1, 1, 1, 5, 6]
    assert [o.is_held for o in outcomes[1:]] == [False, True, True, True, False, False]
    assert (first.inits, second.inits) == ([0], [2])
    # Blind frame 4 tells nothing; the state has seen 3, 5 and 6 after the one it began with.
    assert second.steps == [2, 3, 5, 6]
    assert performance._state == 3


def test_a_search_for_somebody_who_left_is_forgotten():
    estimators = [ScriptedEstimator() for _ in range(3)]
    executor = Inline(patient=True)
    performance = Performance(lambda t: estimators[min(number(t), 2)], executor)
    assert performance.take(frame(0)) is None
    assert performance.take(frame(1)) is None
    assert performance.take(frame(2)) is None
    executor.finish()
    outcome = performance.take(frame(3))
    assert shown([outcome]) == [3]
    assert [e.steps for e in estimators] == [[], [], [2, 3]]


def test_the_loop_waits_in_the_end():
    estimator = ScriptedEstimator()
    with ThreadPoolExecutor(1) as executor:
        release = threading.Event()
        executor.submit(release.wait, 30.0)
        config = PerformanceConfig(max_waiting=2)
        performance = Performance(lambda _: estimator, executor, config=config)
        assert performance.take(frame(0)) is None
        assert performance.take(frame(1), budget=0.01) is None
        threading.Timer(0.1, release.set).start()
        outcome = performance.take(frame(2))
    assert shown([outcome]) == [2]
    assert estimator.steps == [0, 1, 2]


def test_a_search_that_breaks_is_not_silent():
    class Broken(ScriptedEstimator):
        def init(self, frame):
            raise ZeroDivisionError

    estimator = Broken()
    with ThreadPoolExecutor(1) as executor:
        performance = Performance(lambda _: estimator, executor)
        with pytest.raises(ZeroDivisionError):
            performance.take(frame(0), budget=30.0)


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
