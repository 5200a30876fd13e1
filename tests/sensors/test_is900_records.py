import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors import rotation
from sensors.errors import MalformedRecordError, ProtocolError
from sensors.placement import RoomTransform
from sensors.protocols.is900 import Item, Record, Status, Unit, layout_variants
from sensors.protocols.is900.axes import flip_position, flip_quaternion
from sensors.protocols.is900.responses import (
    Response,
    output_list_response,
    parse_output_list,
    parse_response,
    parse_station_flags,
    parse_status,
    station_flags_response,
)

LISTS = [
    (2, 4, 1),
    (2, 11, 1),
    (2, 11, 21, 1),
    (2, 11, 40, 21, 1),
    (2, 11, 0),
    (2, 11, 21, 0),
    (2, 4, 40, 22, 23, 1),
    (2, 5, 6, 7, 1),
    (0, 2, 0, 4, 0, 1),
]
BINARY_LISTS = [*LISTS, (18, 20), (18, 19), (18, 20, 1), (20,), (2, 19, 1)]

angle = st.floats(-math.pi, math.pi)


@st.composite
def poses(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    p = np.array([draw(st.floats(-2.9, 2.9)) for _ in range(3)])
    v = np.array([draw(st.floats(-2.0, 2.0)) for _ in range(3)])
    return p, rotation.from_rotation_vector(v)


def record_of(p: np.ndarray, q: np.ndarray, items: tuple[int, ...], station: int = 1) -> Record:
    R = rotation.to_matrix(q)
    euler = tuple(map(float, rotation.to_euler(q)))
    values = {
        Item.POSITION: tuple(map(float, p)),
        Item.POSITION_14BIT: tuple(map(float, p)),
        Item.EULER: euler,
        Item.EULER_14BIT: euler,
        Item.X_COSINES: tuple(map(float, R[:, 0])),
        Item.Y_COSINES: tuple(map(float, R[:, 1])),
        Item.Z_COSINES: tuple(map(float, R[:, 2])),
        Item.QUATERNION: tuple(map(float, q)),
        Item.QUATERNION_14BIT: tuple(map(float, q)),
        Item.TIME: (12.345,),
        Item.BUTTONS: (5.0,),
        Item.JOYSTICK: (0.0, 255.0),
        Item.TRACKING_STATUS: (200.0,),
    }
    return Record(station, " ", {i: v for i, v in values.items() if int(i) in items})


@pytest.mark.parametrize(
    ("items", "length"),
    [((2, 11, 1), 33), ((2, 11, 21, 1), 37), ((18, 20), 17), ((2, 4, 40, 22, 23, 1), 33)],
)
def test_length_of_a_binary_record_follows_from_its_list(items: tuple[int, ...], length: int):
    assert layout_variants(items)[0].length == length


def test_golden_binary_record_in_centimeters():
    # Yaw of 10 degrees is (0.9962, 0, 0, 0.0872); 100, -50, 25 cm; 1500 ms.
    floats = struct.pack("<8f", 100.0, -50.0, 25.0, 0.9962, 0.0, 0.0, 0.0872, 1500.0)
    record = layout_variants((2, 11, 21, 1))[0].decode(b"0A " + floats + b"\r\n")
    assert record.station == 10
    np.testing.assert_allclose(record.position, [1.0, -0.5, 0.25], atol=1e-7)
    np.testing.assert_allclose(rotation.to_euler(record.quaternion)[0], math.radians(10), atol=1e-4)
    assert record.time == pytest.approx(1.5)


def test_golden_ascii_record_with_numbers_that_touch():
    layout = layout_variants((2, 4, 1), "ascii", Unit.INCH)[0]
    record = layout.decode(b"02 -100.00  39.37-010.50 010.00-179.99  -0.01\r\n")
    np.testing.assert_allclose(record.position, [-2.54, 0.999998, -0.2667], atol=1e-9)
    np.testing.assert_allclose(
        record.values[Item.EULER], np.radians([10.0, -179.99, -0.01]), atol=1e-12
    )


def test_golden_14_bit_record():
    # 1.5 m of 3 m is half of 8192: low 7 bits 0, high 32. -0.75 m is -2048: 0 and 0x70.
    data = bytes((0x80, 32, 0, 0x70, 0, 0)) + bytes((0x7F, 0x3F, 0, 0, 0, 0, 0, 0))
    record = layout_variants((18, 20))[0].decode(b"03 " + data)
    np.testing.assert_allclose(record.position, [1.5, -0.75, 0.0])
    np.testing.assert_allclose(record.quaternion, [1.0, 0.0, 0.0, 0.0])


def test_14_bit_data_without_its_start_mark_is_refused():
    data = b"03 " + bytes(6) + bytes((0x7F, 0x3F, 0, 0, 0, 0, 0, 0))
    with pytest.raises(MalformedRecordError, match="out of step"):
        layout_variants((18, 20))[0].decode(data)


@settings(deadline=None, max_examples=15)
@given(pose=poses(), unit=st.sampled_from(Unit), station=st.integers(1, 12))
@pytest.mark.parametrize("items", BINARY_LISTS)
def test_binary_round_trip(items, pose, unit, station):
    p, q = pose
    layout = layout_variants(items, "binary", unit)[0]
    record = record_of(p, q, items, station)
    data = layout.encode(record)
    assert len(data) == layout.length
    again = layout.decode(data)
    assert again.station == station
    if again.position is not None:
        tolerance = 1e-6 if Item.POSITION in again.values else 3.0 / 8192
        np.testing.assert_allclose(again.position, p, atol=tolerance)
    if again.quaternion is not None:
        coarse = {19, 20} & set(items)
        error = float(rotation.angle_between(again.quaternion, q))
        # Near pitch 90 deg yaw and roll are one; float32 degrees then give some 1e-3.
        assert error < (2e-3 if coarse or 4 in items else 1e-5)
    for item in (Item.BUTTONS, Item.JOYSTICK, Item.TRACKING_STATUS):
        assert again.values.get(item) == record.values.get(item)


@settings(deadline=None, max_examples=15)
@given(pose=poses(), unit=st.sampled_from(Unit))
@pytest.mark.parametrize("items", LISTS)
def test_ascii_round_trip_in_every_width(items, pose, unit):
    p, q = pose
    for layout in layout_variants(items, "ascii", unit):
        again = layout.decode(layout.encode(record_of(p, q, items)))
        np.testing.assert_allclose(again.position, p, atol=0.006 * unit.value)
        assert float(rotation.angle_between(again.quaternion, q)) < 0.02
        if Item.TIME in again.values:
            assert again.time == pytest.approx(12.345)


@pytest.mark.parametrize(
    "floats",
    [
        (math.nan, 0, 0, 1, 0, 0, 0, 1),
        (0, math.inf, 0, 1, 0, 0, 0, 1),
        (1e6, 0, 0, 1, 0, 0, 0, 1),
        (0, 0, 0, 0, 0, 0, 0, 1),
        (0, 0, 0, 1, 1, 1, 1, 1),
        (0, 0, 0, 1, 0, 0, 0, -5),
        (0, 0, 0, 1, 0, 0, 0, math.nan),
    ],
)
def test_absurd_values_are_refused(floats):
    data = b"01 " + struct.pack("<8f", *floats) + b"\r\n"
    with pytest.raises(MalformedRecordError):
        layout_variants((2, 11, 21, 1))[0].decode(data)


def test_unknown_and_repeated_items_are_refused_with_the_valid_ones():
    with pytest.raises(ProtocolError, match="valid are 0,1,2,4"):
        layout_variants((2, 3, 1))
    with pytest.raises(ProtocolError, match="twice"):
        layout_variants((2, 2, 1))
    with pytest.raises(ProtocolError, match="binary only"):
        layout_variants((18, 20), "ascii")


def test_status_record_has_55_bytes_and_its_flags_in_the_low_nibble():
    status = Status(binary=True, metric=True, continuous=True, version="4.13", identification="x")
    line = status.encode()
    assert len(line) == 55
    assert line[:6] == b"21S00B"
    assert parse_status(parse_response(line)) == Status(
        binary=True, metric=True, continuous=True, version="4.13", identification="x"
    )
    assert parse_status(parse_response(line[:-3] + b"\r\n")).version == "4.13"


def test_answers_of_the_manual():
    assert output_list_response(1, (2, 4, 1)).encode() == b"21O 2 4 1\r\n"
    assert parse_output_list(parse_response(b"2CO 21121\r\n")) == (2, 11, 21)
    flags = tuple(n in (0, 2) for n in range(32))
    line = station_flags_response(flags).encode()
    assert line == b"21l10100000000000000000000000000000\r\n"
    assert parse_station_flags(parse_response(line)) == flags
    assert parse_response(b"31S000\r\n") == Response("3", 1, "S", "000")


@given(pose=poses())
def test_axes_half_a_turn_about_north(pose):
    p, q = pose
    S = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(flip_position(p), S @ p)
    np.testing.assert_allclose(
        rotation.to_matrix(flip_quaternion(q)), S @ rotation.to_matrix(q) @ S.T, atol=1e-12
    )


def test_a_turn_to_the_right_seen_from_above_is_negative_in_the_world():
    # In north-east-down a positive yaw turns from north to east; the world's z is up.
    yaw = rotation.from_euler(np.array([math.radians(30), 0.0, 0.0]))
    world = flip_quaternion(yaw)
    np.testing.assert_allclose(rotation.to_euler(world), [math.radians(-30), 0, 0], atol=1e-12)
    np.testing.assert_allclose(flip_position(np.array([1.0, 2.0, 3.0])), [1.0, -2.0, -3.0])


@given(pose=poses(), yaw=angle)
def test_room_transform_and_back(pose, yaw):
    p, q = pose
    room = RoomTransform(yaw, (1.0, -2.0, 0.5))
    p_room, q_room = room.apply(p, q)
    turn = np.array(
        [[math.cos(yaw), -math.sin(yaw), 0], [math.sin(yaw), math.cos(yaw), 0], [0, 0, 1]]
    )
    np.testing.assert_allclose(p_room, turn @ p + [1.0, -2.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(rotation.to_matrix(q_room), turn @ rotation.to_matrix(q), atol=1e-12)
    p_back, q_back = room.invert(p_room, q_room)
    np.testing.assert_allclose(p_back, p, atol=1e-12)
    np.testing.assert_allclose(q_back, q, atol=1e-12)
