import math

import numpy as np
import pytest

from sensors import rotation
from sensors.emulators.faults import (
    Dropout,
    Fault,
    FaultMaker,
    Jump,
    Junk,
    Noise,
    Truncation,
    parse_fault,
)
from sensors.emulators.unit import Is900Unit
from sensors.errors import ConfigurationError
from sensors.protocols.is900 import Item, flip_quaternion

POSE = (np.array([1.0, 2.0, 0.5]), rotation.from_rotation_vector(np.array([0.1, -0.4, 0.7])))


def pose_at(t: float):
    return [(POSE[0] + [t, 0.0, 0.0], POSE[1])] * 6


def say(unit: Is900Unit, data: bytes, now: float = 0.0) -> bytes:
    return unit.receive(data, now, pose_at, 0.0)


def first(unit: Is900Unit, device_time: float = 0.0):
    return unit.records(pose_at, 0.0, device_time)[0][1]


@pytest.mark.parametrize("end", [b"\r\n", b"\r", b"\n"])
def test_line_ends_of_every_kind(end):
    unit = Is900Unit()
    assert say(unit, b"O2,2,11,1" + end + b"O2" + end) == b"22O 211 1\r\n"
    assert say(unit, b"l*" + end) == b"21l" + b"1" * 6 + b"0" * 26 + b"\r\n"
    assert unit.errors == 0


def test_commands_may_arrive_byte_by_byte():
    unit = Is900Unit()
    answers = b"".join(say(unit, bytes((b,))) for b in b"fuO1,2,11,21,1\r\nO1\r\nC")
    assert answers == b"21O 21121 1\r\n"
    assert unit.binary
    assert unit.metric
    assert unit.streaming


def test_defaults_and_reset():
    unit = Is900Unit()
    assert say(unit, b"S")[3:6] == b"000"
    assert say(unit, b"O1\r\n") == b"21O 2 4 1\r\n"
    say(unit, b"fuC")
    assert say(unit, b"S")[3:6] == b"00B"
    assert say(unit, b"\x19S")[3:6] == b"000"


def test_suspend_and_resume():
    unit = Is900Unit()
    say(unit, b"C\x13")
    assert not unit.streaming
    say(unit, b"\x11")
    assert unit.streaming


def test_poll_is_counted_and_bounded():
    unit = Is900Unit()
    say(unit, b"P" * 50)
    assert unit.polls == 4


@pytest.mark.parametrize(
    "line", [b"O1,99\r", b"O1,2,2\r", b"OZ\r", b"l\x7f\r", b"N1,a,b,c\r", b"qwerty\r", b"A1,1,2\r"]
)
def test_nonsense_is_answered_or_ignored_and_survived(line):
    unit = Is900Unit()
    say(unit, line)
    assert unit.errors >= 1
    assert say(unit, b"O1\r") == b"21O 2 4 1\r\n"


def test_endless_lines_do_not_grow():
    unit = Is900Unit()
    say(unit, b"O" * 100_000)
    assert len(unit._line) <= 128


def test_clock_zero():
    unit = Is900Unit()
    say(unit, b"O1,2,11,21,1\rMT\rMZ\r", now=7.0)
    assert first(unit, 8.5).time == pytest.approx(1.5)


def test_station_switch():
    unit = Is900Unit(2)
    assert say(unit, b"l1,0\rl1\r") == b"21l0100\r\n"
    assert [n for n, _ in unit.records(pose_at, 0.0, 0.0)] == [2]


def test_boresight_makes_the_present_orientation_the_zero():
    unit = Is900Unit()
    say(unit, b"O1,2,11,1\rB1\r")
    np.testing.assert_allclose(np.abs(first(unit).quaternion), [1, 0, 0, 0], atol=1e-12)
    say(unit, b"b1\r")
    np.testing.assert_allclose(first(unit).quaternion, flip_quaternion(POSE[1]), atol=1e-12)


def test_tip_offset_moves_with_the_body():
    unit = Is900Unit()
    say(unit, b"O1,2,11,1\r")
    plain = first(unit)
    assert say(unit, b"N1,10,0,0\rN1\r") == b"21N  10.00   0.00   0.00\r\n"
    moved = first(unit).position - plain.position
    np.testing.assert_allclose(moved, 0.1 * rotation.to_matrix(plain.quaternion)[:, 0], atol=1e-12)


def test_alignment_makes_its_points_the_axes():
    unit = Is900Unit()
    # Centimeters; origin at the tracker (1, -2, -0.5 north-east-down), x to the east.
    say(unit, b"uO1,2,11,1\rA1,100,-200,-50,100,-100,-50,0,-200,-50\r")
    np.testing.assert_allclose(first(unit).position, [0, 0, 0], atol=1e-12)
    say(unit, b"R1\r")
    np.testing.assert_allclose(first(unit).position, [1, -2, -0.5], atol=1e-12)


def test_prediction_looks_ahead_and_is_limited():
    unit = Is900Unit()
    assert say(unit, b"Mp1,80\rMp1\r") == b"31p50\r\n"
    assert first(unit).position[0] == pytest.approx(1.05)


def test_only_the_listed_items_are_made():
    unit = Is900Unit()
    say(unit, b"O1,2,5,6,7,40,22,23,1\r")
    record = first(unit)
    assert set(record.values) == {Item(i) for i in (2, 5, 6, 7, 40, 22, 23)}
    assert float(rotation.angle_between(record.quaternion, flip_quaternion(POSE[1]))) < 1e-6


def test_faults_by_name():
    fault = parse_fault("jump, station=3, start=2, duration=1, dx=0.5, turn=90")
    assert fault == Jump(start=2.0, duration=1.0, station=3, dx=0.5, turn=90.0)
    with pytest.raises(ConfigurationError, match="there are junk, truncation, corruption, silence"):
        parse_fault("fire")
    with pytest.raises(ConfigurationError, match="start, duration, station"):
        parse_fault("dropout,where=3")
    with pytest.raises(ConfigurationError, match="number"):
        parse_fault("dropout,station=three")


def test_jump_and_dropout_hit_one_station_for_a_time():
    maker = FaultMaker([Jump(1.0, 1.0, station=2, dx=0.5, turn=90.0), Dropout(1.0, 1.0, station=3)])
    position, quaternion = maker.bend(2, POSE, 1.5)
    np.testing.assert_allclose(position - POSE[0], [0.5, 0, 0])
    assert float(rotation.angle_between(quaternion, POSE[1])) == pytest.approx(math.pi / 2)
    assert maker.bend(3, POSE, 1.5) is None
    for station, t in ((1, 1.5), (2, 0.9), (2, 2.0), (3, 2.1)):
        bent = maker.bend(station, POSE, t)
        np.testing.assert_array_equal(bent[0], POSE[0])


def test_noise_is_of_its_size_and_repeats_with_its_seed():
    def run(seed):
        maker = FaultMaker(noise=Noise(0.003, 0.5), seed=seed)
        return [maker.bend(1, POSE, 0.0) for _ in range(2000)]

    a, b, c = run(1), run(1), run(2)
    p = np.array([x[0] for x in a]) - POSE[0]
    assert np.abs(p.std(axis=0) - 0.003).max() < 3e-4
    angles = np.array([float(rotation.angle_between(x[1], POSE[1])) for x in a])
    assert math.degrees(math.sqrt((angles**2).mean() / 3.0)) == pytest.approx(0.5, rel=0.05)
    np.testing.assert_array_equal([x[0] for x in a], [x[0] for x in b])
    assert not np.array_equal(a[0][0], c[0][0])


def test_junk_and_truncation_change_bytes_only_while_on():
    record = bytes(range(38))
    faults: list[Fault] = [Junk(1.0, 1.0, probability=1.0), Truncation(3.0, 1.0, probability=1.0)]
    maker = FaultMaker(faults)
    assert maker.spoil(record, 0.0) == record
    assert maker.spoil(record, 1.5).endswith(record)
    assert len(maker.spoil(record, 1.5)) > len(record)
    assert record.startswith(maker.spoil(record, 3.5))
    assert len(maker.spoil(record, 3.5)) < len(record)
