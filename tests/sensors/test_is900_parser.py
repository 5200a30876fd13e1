import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors import rotation
from sensors.protocols.is900 import Item, Parser, Record, Response, Unit, layout_variants

ITEMS = (2, 11, 40, 21, 1)


def record(station: int, k: int, items: tuple[int, ...] = ITEMS) -> Record:
    q = rotation.from_rotation_vector(np.array([0.01 * k, 0.3, -0.2]))
    values = {
        Item.POSITION: (0.01 * k, -1.0, 0.5),
        Item.QUATERNION: tuple(map(float, q)),
        Item.QUATERNION_14BIT: tuple(map(float, q)),
        Item.POSITION_14BIT: (0.01 * k, -1.0, 0.5),
        Item.EULER: (0.1, 0.2, 0.3),
        Item.TRACKING_STATUS: (255.0,),
        Item.TIME: (k / 40.0,),
        Item.BUTTONS: (3.0,),
        Item.JOYSTICK: (127.0, 0.0),
    }
    return Record(station, " ", {i: v for i, v in values.items() if int(i) in items})


def wire(k: int, station: int = 1, items: tuple[int, ...] = ITEMS) -> bytes:
    return layout_variants(items)[0].encode(record(station, k, items))


def times(found: list[Record | Response]) -> list[int]:
    return [round(m.time * 40) for m in found if isinstance(m, Record) and m.time is not None]


@settings(deadline=None, max_examples=30)
@given(data=st.data())
def test_any_split_gives_the_same_records(data):
    stream = b"".join(wire(k, station=1 + k % 6) for k in range(12))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    parser = Parser(dict.fromkeys(range(1, 7), ITEMS))
    found = []
    for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        found += parser.feed(stream[a:b])
    assert times(found) == list(range(12))
    assert parser.counters.skipped_bytes == parser.counters.bad_records == parser.pending == 0


@settings(deadline=None, max_examples=50)
@given(
    junk=st.lists(st.binary(max_size=60), min_size=8, max_size=8),
    cut=st.integers(1, 400),
)
def test_junk_between_records_costs_no_record(junk, cut):
    parser = Parser({1: ITEMS})
    stream = b"".join(j + wire(k) for k, j in enumerate(junk))
    found = [m for i in range(0, len(stream), cut) for m in parser.feed(stream[i : i + cut])]
    assert times(found) == list(range(8))
    answers = sum(len(m.encode()) for m in found if isinstance(m, Response))
    assert parser.counters.skipped_bytes + answers == sum(map(len, junk))


@settings(deadline=None, max_examples=50)
@given(keep=st.lists(st.integers(0, 37), min_size=6, max_size=6))
def test_truncated_records_cost_only_themselves(keep):
    parser = Parser({1: ITEMS})
    found = []
    for k, length in enumerate(keep):
        found += parser.feed(wire(2 * k)[:length])
        found += parser.feed(wire(2 * k + 1))
    assert times(found) == [2 * k + 1 for k in range(6)]


@settings(deadline=None, max_examples=50)
@given(junk=st.binary(max_size=200), items=st.sampled_from([(2, 11, 21, 0), (2, 11, 21), (18, 20)]))
def test_weak_terminators_are_in_step_within_two_records(junk, items):
    parser = Parser({1: items})
    clean = b"".join(wire(k, items=items) for k in range(6))
    found = [m for m in parser.feed(junk + clean) if isinstance(m, Record)]
    expected = [layout_variants(items)[0].decode(wire(k, items=items)) for k in range(6)]
    assert found[-4:] == expected[-4:]


def test_line_ends_inside_floats_do_not_split():
    # 0x0A0D0A0D as float32 is a position of 6.8e-33 units: CR LF twice inside one number.
    base = bytearray(wire(3))
    base[3:7] = b"\r\n\r\n"
    parser = Parser({1: ITEMS})
    (found,) = parser.feed(bytes(base))
    assert isinstance(found, Record)
    assert parser.counters.skipped_bytes == 0


def test_answers_are_recognized_between_binary_records():
    parser = Parser({1: ITEMS})
    answer = b"21l11111100000000000000000000000000\r\n"
    found = parser.feed(wire(0) + answer + wire(1) + b"31S000\r\n")
    assert [type(m) for m in found] == [Record, Response, Record, Response]
    assert parser.counters.responses == 2


def test_records_of_unknown_stations_are_skipped_and_counted():
    parser = Parser({1: ITEMS})
    found = parser.feed(wire(0, station=2) + wire(1))
    assert times(found) == [1]
    assert parser.counters.skipped_bytes == len(wire(0))


def test_zero_quaternion_is_a_bad_record_of_its_station():
    bad = bytearray(wire(0))
    bad[15:31] = bytes(16)
    parser = Parser({1: ITEMS})
    assert times(parser.feed(bytes(bad) + wire(1))) == [1]
    assert parser.counters.bad_records == 1
    assert parser.counters.bad_by_station == {1: 1}


@settings(deadline=None, max_examples=50)
@given(st.lists(st.binary(max_size=300), max_size=20))
def test_the_buffer_stays_bounded_whatever_comes(chunks):
    parser = Parser(dict.fromkeys(range(1, 13), ITEMS))
    for chunk in chunks:
        parser.feed(chunk)
        assert parser.pending <= 128


@pytest.mark.parametrize("widths", [(3, 3), (4, 4), (5, 3)])
def test_ascii_widths_of_buttons_and_joystick_are_found_out(widths):
    items = (2, 4, 40, 22, 23, 1)
    layouts = layout_variants(items, "ascii", Unit.CENTIMETER)
    (layout,) = [x for x in layouts if x.widths[3:5] == widths]
    parser = Parser({1: items}, "ascii", Unit.CENTIMETER)
    stream = b"".join(layout.encode(record(1, k, items)) for k in range(4))
    found = parser.feed(stream)
    assert len(found) == 4
    assert all(isinstance(m, Record) and m.values[Item.JOYSTICK] == (127.0, 0.0) for m in found)
    assert parser.counters.bad_records == 0


def test_ascii_without_binary_knowledge_is_rejected_not_misread():
    parser = Parser({1: ITEMS})
    text = layout_variants((2, 4, 1), "ascii")[0].encode(record(1, 0, (2, 4, 1)))
    assert not [m for m in parser.feed(text * 10) if isinstance(m, Record)]
