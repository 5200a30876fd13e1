"""Playing: the pure state machine against what anybody expects of a player."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from localreg.view.controls import (
    DOWN,
    END,
    ENTER,
    HOME,
    LEFT,
    PAGE_DOWN,
    PAGE_UP,
    RIGHT,
    SPACE,
    UP,
    Controls,
    played,
    pressed,
)
from localreg.view.transport import SPEEDS, Deck, Playhead

FIVE = Playhead(frames=5, rate=10.0)


def test_it_plays_every_frame_in_order_and_stops_at_the_end() -> None:
    head, seen = FIVE, []
    while head.is_playing:
        seen.append(head.index)
        head = head.advanced(0.06)
    assert seen == sorted(seen)
    assert set(seen) == {0, 1, 2, 3}
    assert (head.index, head.time, head.is_playing) == (4, 0.4, False)
    assert head.toggled().index == 0, "from the end it starts anew"


def test_the_last_frame_of_a_loop_is_seen_as_long_as_the_others() -> None:
    head, seen = FIVE.looping(True), []
    for _ in range(500):
        head = head.advanced(0.01)
        seen.append(head.index)
    np.testing.assert_allclose(np.bincount(seen) / len(seen), 0.2, atol=0.01)
    assert head.is_playing


def test_single_steps_pause_and_stay_within_the_ends() -> None:
    head = FIVE.stepped(2)
    assert (head.index, head.is_playing) == (2, False)
    assert head.advanced(1.0) is head, "what is paused stays"
    assert head.stepped(99).index == 4
    assert head.stepped(-99).index == 0


@given(
    frames=st.integers(1, 10_000),
    rate=st.floats(1.0, 240.0),
    moves=st.lists(
        st.one_of(
            st.tuples(st.just("advanced"), st.floats(0.0, 100.0)),
            st.tuples(st.just("scrubbed"), st.floats(-10.0, 1e4)),
            st.tuples(st.just("stepped"), st.integers(-50, 50)),
            st.tuples(st.just("at_speed"), st.sampled_from(SPEEDS)),
            st.tuples(st.just("looping"), st.booleans()),
        ),
        max_size=30,
    ),
)
def test_no_control_leads_out_of_the_file(
    frames: int, rate: float, moves: list[tuple[str, float]]
) -> None:
    head = Playhead(frames, rate)
    for name, value in moves:
        head = getattr(head, name)(value)
        assert 0.0 <= head.time <= head.seconds + head.is_looping * head.period
        assert 0 <= head.index < frames
    for index in {0, frames // 2, frames - 1}:
        assert head.scrubbed(index / rate).index == index


def test_what_cannot_be_played_is_refused() -> None:
    for frames, rate in ((0, 40.0), (3, 0.0), (3, float("nan"))):
        with pytest.raises(ValueError, match="cannot be played"):
            Playhead(frames, rate)
    with pytest.raises(ValueError, match="times its speed"):
        FIVE.at_speed(0.0)


def test_a_deck_goes_by_the_clock_and_by_what_is_set() -> None:
    deck = Deck(Playhead(101, 10.0))
    assert deck.tick(5.0) == 0
    assert deck.tick(6.0) == 10
    deck.speed = 2.0
    assert deck.tick(7.0) == 30
    deck.is_playing = False
    assert deck.tick(8.0) == 30
    deck.time = 99.0
    assert (deck.tick(9.0), deck.time, deck.seconds) == (100, 10.0, 10.0)
    deck.is_playing, deck.is_looping = True, True
    assert deck.tick(9.5) == 10, "half a second at twice the speed, from the beginning"
    assert deck.period == pytest.approx(0.1)


def test_keys_play_files() -> None:
    head = Playhead(frames=401, rate=40.0)
    for keys, index in (
        ((SPACE, RIGHT, RIGHT, LEFT), 1),
        ((PAGE_DOWN, PAGE_DOWN, PAGE_UP), 40),
        ((END,), 400),
        ((END, HOME), 0),
        ((LEFT,), 0),
        ((ord("x"),), 0),
    ):
        now = head
        for key in keys:
            now = played(now, key)
        assert now.index == index, keys
    assert played(head, UP).speed == 2.0
    assert played(head, DOWN).speed == 0.5
    assert played(head, ENTER).is_looping
    assert not played(head, SPACE).is_playing


def test_keys_choose_cameras_and_looks() -> None:
    now = Controls()
    for key, preset in zip("123456", ("follow", "front", "back", "left", "right", "top"),
                           strict=True):  # fmt: skip
        then, now = now, pressed(now, ord(key))
        assert now.preset == preset
        assert now.aimed == then.aimed + 1
    looks = []
    for _ in range(3):
        now = pressed(now, ord("7"))
        looks.append(now.style.look)
    assert looks == ["sticks", "diamonds", "capsules"]
    assert not pressed(now, ord("8")).style.ghost
    assert not pressed(now, ord("9")).style.trails
    assert not pressed(now, ord("0")).shows_help
    assert pressed(now, ord("x")) is now
