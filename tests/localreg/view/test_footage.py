"""Files as they are played: any order, any rate of the ghost, the floor under the feet."""

from dataclasses import replace

import numpy as np
import pytest

from localreg.drawing.ground import end_heights, floor_under
from localreg.errors import LocalregError
from localreg.motion.motion import Motion
from localreg.view.file_source import FileSource
from localreg.view.footage import Footage, Reel
from localreg.view.moment import Moment
from tests.localreg.view.walking import walking

MOTION = walking(3.0)


class Clock:
    """Stands still unless it is moved."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def same(first: Moment, second: Moment) -> bool:
    """Whether both show the same, trails included."""
    return (
        first.index == second.index
        and np.array_equal(first.qpos, second.qpos)
        and len(first.trails) == len(second.trails)
        and all(map(np.array_equal, first.trails, second.trails))
    )


def test_a_scrubbed_moment_is_the_one_that_playing_arrives_at() -> None:
    played = Reel(Footage(MOTION))
    moments = [played.moment(index) for index in range(len(MOTION))]
    scrubbed = Reel(Footage(MOTION))
    for index in (70, 3, 119, 118, 40, 41, 0):
        assert same(scrubbed.moment(index), moments[index]), index
    assert len(moments[70].trails) == len(MOTION.subject.trackers)


def test_worn_trackers_are_where_the_body_has_them() -> None:
    moment = Reel(Footage(MOTION)).moment(17)
    for tracker in moment.trackers:
        assert tracker.distance == pytest.approx(0.0, abs=1e-12)
        assert tracker.angle == pytest.approx(0.0, abs=1e-6)


def test_a_ghost_of_another_rate_keeps_the_time() -> None:
    ghost = replace(MOTION.resampled(100.0), qpos=MOTION.resampled(100.0).qpos[:200])
    reel = Reel(Footage(MOTION, ghost=ghost, ghost_name="faster"))
    moment = reel.moment(20)  # at half a second
    assert moment.ghost is not None
    np.testing.assert_allclose(moment.ghost, MOTION.qpos[20], atol=1e-9)
    late = reel.moment(119).ghost
    assert late is not None
    np.testing.assert_array_equal(late, ghost.qpos[-1])
    assert moment.ghost_name == "faster"


def test_the_floor_is_put_under_the_feet_with_everything_on_it() -> None:
    raised = replace(MOTION, qpos=MOTION.qpos + np.array([0, 0, 0.7] + 60 * [0]))
    observer = Reel(Footage(raised))
    frames = [
        observer._observer.worn(i / 40, qpos)  # pyright: ignore[reportPrivateUsage]
        for i, qpos in enumerate(raised.qpos)
    ]
    footage = Footage(raised, frames=frames, ghost=raised).on_floor()
    assert floor_under(end_heights(footage.motion)) == pytest.approx(0.0, abs=1e-9)
    moment = Reel(footage).moment(30)
    assert max(tracker.distance for tracker in moment.trackers) < 1e-9
    assert moment.ghost is not None
    np.testing.assert_allclose(moment.ghost, moment.qpos)


def test_what_does_not_fit_is_refused() -> None:
    empty = Motion(np.zeros((0, 63)), 40.0, MOTION.subject)
    with pytest.raises(LocalregError, match="no frames; there is nothing to see"):
        Footage(empty)
    with pytest.raises(LocalregError, match="no frames to compare with"):
        Footage(MOTION, ghost=empty)
    with pytest.raises(LocalregError, match="120 poses and 0 frames of trackers"):
        Footage(MOTION, frames=[])


def test_a_source_plays_in_real_time_and_is_asked_for_nothing_twice() -> None:
    clock = Clock()
    source = FileSource(Footage(MOTION), now=clock)
    first = source.newest()
    assert first.index == 0
    assert source.newest() is first, "nothing happened since"
    clock.now += 1.0
    assert source.newest().index == 40
    assert source.transport is not None
    source.transport.time = 2.5
    source.transport.is_playing = False
    clock.now += 5.0
    assert source.newest().index == 100
    assert source.newest().title == "stroll  walk"
