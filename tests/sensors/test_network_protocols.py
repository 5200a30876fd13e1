"""Wire formats of UDP, VRPN, OSC and the axes of Unity, byte for byte."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pythonosc import osc_bundle_builder, osc_message_builder

from sensors import rotation
from sensors.arrival_clock import ArrivalClock
from sensors.chunk import Chunk
from sensors.devices.axes import to_world
from sensors.devices.is900 import Is900Config, Is900Decoder
from sensors.errors import MalformedRecordError
from sensors.protocols import is900_udp, osc, unity, vrpn
from sensors.protocols.is900 import Item, Record, layout_variants
from sensors.protocols.is900.axes import flip_position, flip_quaternion

GOLDEN = bytes.fromhex(
    "ff0107470402ff007f7f000000000000000028410000a2c10000f0410000c03f000000bf0000a0bf1f854541"
)


def test_the_udp_packet_of_the_manual():
    packet = is900_udp.decode(GOLDEN)
    assert (packet.sequence, packet.station, packet.status, packet.model) == (7, 2, 255, 4)
    np.testing.assert_allclose(np.degrees(packet.euler), [10.5, -20.25, 30.0], atol=1e-6)
    np.testing.assert_allclose(packet.position, [1.5, -0.5, -1.25])
    assert packet.time == pytest.approx(12.345, abs=1e-6)
    assert packet.encode() == GOLDEN


@given(at=st.integers(4, 43), bit=st.integers(0, 7))
def test_one_turned_bit_is_noticed(at, bit):
    data = bytearray(GOLDEN)
    data[at] ^= 1 << bit
    with pytest.raises(MalformedRecordError):
        is900_udp.decode(bytes(data))


def test_a_vrpn_pose_byte_for_byte():
    report = vrpn.PoseReport(2, np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    data = vrpn.Message(4, 1, 10.5, report.encode()).encode()
    expected = "00000058 0000000a 0007a120 00000001 00000004 00000000 00000002 00000000"
    expected += "3ff0000000000000 4000000000000000 4008000000000000"
    expected += "0000000000000000" * 3 + "3ff0000000000000"
    assert data == bytes.fromhex(expected)
    (message,) = vrpn.read_datagram(data)
    assert message == vrpn.Message(4, 1, 10.5, report.encode())
    assert vrpn.decode_pose(message.payload).sensor == 2


def test_a_vrpn_description_is_padded_but_its_length_is_not():
    data = vrpn.description(vrpn.SENDER_DESCRIPTION, 3, "Tracker0").encode()
    assert data[:4] == (24 + 4 + 9).to_bytes(4, "big")
    assert len(data) == 24 + 16
    (message,) = vrpn.read_datagram(data)
    assert vrpn.decode_description(message.payload) == "Tracker0"


@given(cuts=st.lists(st.integers(0, 400), max_size=8))
def test_vrpn_messages_may_come_in_any_portions(cuts):
    messages = [vrpn.Message(k, 0, float(k), b"x" * (7 * k)) for k in range(6)]
    stream = vrpn.COOKIE + b"".join(m.encode() for m in messages)
    reader = vrpn.MessageReader(with_cookie=True)
    edges = [0, *sorted(min(c, len(stream)) for c in cuts), len(stream)]
    found = [m for a, b in itertools.pairwise(edges) for m in reader.feed(stream[a:b])]
    assert found == messages
    assert reader.pending == 0


@pytest.mark.parametrize(
    ("cookie", "accepted"),
    [
        (b"vrpn: ver. 07.38  0\0\0\0\0\0", True),
        (b"vrpn: ver. 07.29  0\0\0\0\0\0", True),
        (b"vrpn: ver. 06.04  0\0\0\0\0\0", False),
        (b"HTTP/1.1 400 Bad Request", False),
    ],
)
def test_versions_that_connect(cookie, accepted):
    assert len(cookie) == 24
    reader = vrpn.MessageReader(with_cookie=True)
    if accepted:
        assert reader.feed(cookie) == []
        assert reader.has_cookie
    else:
        with pytest.raises(MalformedRecordError):
            reader.feed(cookie)


@pytest.mark.parametrize(
    "data", [b"", b"here", b"host\0", b"host 0\0", b"host 99999\0", b"a" * 300 + b" 1\0"]
)
def test_datagrams_that_ask_for_no_connection(data):
    with pytest.raises(MalformedRecordError):
        vrpn.decode_connection_request(data)
    assert vrpn.decode_connection_request(vrpn.connection_request("::1", 5)) == ("::1", 5)


@given(
    numbers=st.lists(st.floats(width=32, allow_nan=False), max_size=6),
    integer=st.integers(-(2**31), 2**31 - 1),
    text=st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=12),
    blob=st.binary(min_size=1, max_size=9),
)
def test_osc_of_another_writer_is_read(numbers, integer, text, blob):
    builder = osc_message_builder.OscMessageBuilder("/some/where")
    for number in numbers:
        builder.add_arg(number, "f")
    builder.add_arg(integer, "i")
    builder.add_arg(text, "s")
    builder.add_arg(blob, "b")
    builder.add_arg(True)
    bundle = osc_bundle_builder.OscBundleBuilder(1_700_000_000.25)
    bundle.add_content(builder.build())
    inner = osc_bundle_builder.OscBundleBuilder(osc_bundle_builder.IMMEDIATELY)
    inner.add_content(builder.build())
    bundle.add_content(inner.build())
    first, second = osc.decode(bundle.build().dgram)
    assert first.address == "/some/where"
    assert first.arguments == (*numbers, integer, text, blob, True)
    assert first.time == pytest.approx(1_700_000_000.25, abs=1e-6)
    assert (second.arguments, second.time) == (first.arguments, None)


ANGLES = st.floats(-3.1, 3.1)


@given(yaw=ANGLES, pitch=st.floats(-1.5, 1.5), roll=ANGLES)
def test_unity_axes_are_those_of_the_is900_relabeled(yaw, pitch, roll):
    """From north-east-down: position (y, -z, x), quaternion x y z w (-qy, qz, -qx, qw)."""
    p, q = np.array([1.0, 2.0, 3.0]), rotation.from_euler(np.array([yaw, pitch, roll]))
    w, x, y, z = q
    in_unity_p, in_unity_q = np.array([p[1], -p[2], p[0]]), np.array([w, -y, z, -x])
    np.testing.assert_array_equal(unity.position_to_world(in_unity_p), flip_position(p))
    np.testing.assert_array_equal(unity.quaternion_to_world(in_unity_q), flip_quaternion(q))
    np.testing.assert_array_equal(unity.position_from_world(flip_position(p)), in_unity_p)
    np.testing.assert_array_equal(unity.quaternion_from_world(flip_quaternion(q)), in_unity_q)


@given(x=st.floats(-1.5, 1.5), y=ANGLES, z=ANGLES)
def test_unity_euler_angles_there_and_back(x, y, z):
    q = unity.euler_to_quaternion(np.array([x, y, z]))
    again = unity.euler_to_quaternion(unity.quaternion_to_euler(q))
    assert float(rotation.angle_between(q, again)) < 1e-6


def test_unity_turns_about_z_first_then_x_then_y():
    # Unity's own example: Euler (90, 90, 0) takes forward (0, 0, 1) to down (0, -1, 0).
    q = unity.euler_to_quaternion(np.radians([90.0, 90.0, 0.0]))
    forward = rotation.rotate(q, np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(forward, [0.0, -1.0, 0.0], atol=1e-12)
    up = rotation.rotate(q, np.array([0.0, 1.0, 0.0]))
    np.testing.assert_allclose(up, [1.0, 0.0, 0.0], atol=1e-12)


@given(yaw=ANGLES, pitch=st.floats(-1.5, 1.5), roll=ANGLES)
def test_axes_turn_positions_and_rotations_alike(yaw, pitch, roll):
    q = rotation.from_euler(np.array([yaw, pitch, roll]))
    v = np.array([0.3, -0.5, 0.7])
    for axes in ("z-up", "y-up", "north-east-down"):
        position, quaternion = to_world(axes)
        turned = rotation.rotate(quaternion(q), position(v))
        np.testing.assert_allclose(turned, position(rotation.rotate(q, v)), atol=1e-12)
    np.testing.assert_array_equal(to_world("y-up")[0](np.array([0.0, 1.0, 0.0])), [0, 0, 1])


def beat(count: int, period: float, delays: np.ndarray, lost: frozenset[int]) -> float:
    """Scatter of the smoothed times after the beginning [s]."""
    clock, errors = ArrivalClock(), []
    for k in range(count):
        if k in lost:
            continue
        time = clock.update(k * period + float(delays[k]))
        assert time <= k * period + float(delays[k])
        if k > 200:
            errors.append(time - k * period)
    return float(np.std(errors))


def test_the_beat_behind_uneven_arrivals():
    rng = np.random.default_rng(3)
    delays = 0.001 + rng.gamma(1.0, 0.003, 1000)
    lost = frozenset(rng.choice(1000, 50, replace=False).tolist())
    assert beat(1000, 0.025, delays, lost) < 0.6 * np.std(delays)
    assert beat(1000, 0.0111, 0.3 * delays, frozenset()) < 0.6 * np.std(0.3 * delays)


def test_an_is900_without_time_stamps_keeps_the_beat():
    items = (2, 11, 1)
    (layout,) = layout_variants(items)
    values = {Item.POSITION: (1.0, 2.0, 3.0), Item.QUATERNION: (1.0, 0.0, 0.0, 0.0)}
    data = layout.encode(Record(1, " ", values))
    decoder = Is900Decoder(Is900Config(port="x", items=items, stations={"head": 1}))
    opening = {"lists": {"1": list(items)}, "transport_delay": 0.002}
    decoder.take(Chunk(0.0, opening=opening))
    delays = np.random.default_rng(4).gamma(1.0, 0.002, 600)
    times = []
    for k, delay in enumerate(delays):
        ((sample, arrival),) = decoder.take(Chunk(0.02 * k + float(delay), data))
        assert sample.time <= arrival - 0.002 + 1e-12
        times.append(sample.time - 0.02 * k)
    assert np.std(times[200:]) < 0.6 * np.std(delays[200:])


def test_the_beat_survives_pauses_and_steps():
    clock = ArrivalClock()
    for k in range(100):
        clock.update(0.02 * k)
    assert clock.period == pytest.approx(0.02, abs=1e-4)
    assert clock.update(10.0) == 10.0
    assert clock.update(9.0) == 9.0
    times = [clock.update(9.0 + 0.01 * k) for k in range(1, 60)]
    assert times == sorted(times)
    assert clock.period == pytest.approx(0.01, abs=1e-4)
    assert math.isfinite(times[-1])
