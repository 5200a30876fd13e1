"""Fuzzing of everything that reads bytes from outside.

A target takes bytes that nobody chose well and must neither raise, nor hang, nor keep more
than a little of them. Targets that follow a stream must also be back in step after at most
two records of clean data, whatever came before.

`python -m tests.sensors.fuzzing --inputs 1000000` runs them all for long; the tests run each
for a moment. Inputs are clean recordings of each protocol that were mutilated, and plain
noise; all from one seed, so a failure can be repeated.
"""

import argparse
import resource
import sys
import time
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from sensors.chunk import Chunk
from sensors.devices.decoder import Decoder
from sensors.devices.is900 import Is900Config, Is900Decoder
from sensors.devices.is900_udp import Is900UdpConfig, Is900UdpDecoder
from sensors.devices.osc import OscConfig, OscDecoder
from sensors.devices.vrpn import VrpnConfig, VrpnDecoder
from sensors.emulators.source import wandering
from sensors.emulators.unit import Is900Unit
from sensors.protocols import vrpn
from sensors.protocols.is900 import Item, Parser, Record, Unit, layout_variants
from sensors.protocols.is900_udp import Packet

SLOWEST = 2.0
"""A single input may take this much time of the processor [s]."""

_MEMORY = 4_000_000
_BURST = 50


@dataclass(frozen=True)
class Target:
    """Something that reads bytes.

    Attributes:
        name: for messages.
        clean: pieces of good data, in order.
        make: a fresh reader; what it returns takes bytes and tells how many records it saw.
        follows_stream: whether pieces follow one another in a stream, so that the reader must
            find its way back.
    """

    name: str
    clean: Sequence[bytes]
    make: Callable[[], Callable[[bytes], int]]
    follows_stream: bool


def _decoder(make: Callable[[], Decoder], opening: dict[str, object], source: str = ""):
    def fresh() -> Callable[[bytes], int]:
        decoder = make()
        decoder.take(Chunk(0.0, opening=opening))
        now = 0.0

        def take(data: bytes) -> int:
            nonlocal now
            now += 0.004
            before = decoder.counters.parser.records
            for sample, arrival in decoder.take(Chunk(now, data, source)):
                assert arrival == now
                assert sample.time <= now + 1e-9
                assert np.isfinite(sample.position).all()
                assert abs(float(np.linalg.norm(sample.quaternion)) - 1.0) < 1e-6
            assert len(decoder.counters.seen) <= 256
            return decoder.counters.parser.records - before

        return take

    return fresh


def _record(station: int, k: int, items: tuple[int, ...]) -> Record:
    p, q = wandering(6)(0.025 * k)[station - 1] or (np.zeros(3), np.array([1.0, 0, 0, 0]))
    values: dict[Item, tuple[float, ...]] = {
        Item.POSITION: tuple(p),
        Item.QUATERNION: tuple(q),
        Item.EULER: (0.1, 0.2, 0.3),
        Item.TIME: (0.025 * k,),
        Item.TRACKING_STATUS: (255.0,),
        Item.BUTTONS: (0.0,),
        Item.JOYSTICK: (127.0, 127.0),
        Item.POSITION_14BIT: tuple(p),
        Item.QUATERNION_14BIT: tuple(q),
    }
    return Record(station, " ", {i: values[i] for i in map(Item, items) if i in values})


def _is900(items: tuple[int, ...], encoding: str) -> Target:
    (layout, *_) = layout_variants(items, encoding, Unit.CENTIMETER)
    clean = [layout.encode(_record(n, k, items)) for k in range(40) for n in (1, 2, 3)]
    lists = dict.fromkeys((1, 2, 3), items)

    def parser() -> Callable[[bytes], int]:
        p = Parser(lists, encoding, Unit.CENTIMETER)

        def take(data: bytes) -> int:
            before = p.counters.records
            p.feed(data)
            assert p.pending <= 256
            return p.counters.records - before

        return take

    make = parser
    if encoding == "binary" and 2 in items:
        opening = {"lists": {str(n): list(items) for n in lists}, "transport_delay": 0.0}
        make = _decoder(lambda: Is900Decoder(Is900Config(port="x")), opening)
    return Target(f"is900 {encoding} {','.join(map(str, items))}", clean, make, True)


def _unit() -> Target:
    commands = [b"c", b"S", b"O1,2,11,21,0\r", b"l*\r\n", b"MT\r\n", b"MZ\r\n", b"MS\r\n", b"f"]
    commands += [b"C", b"P", b"\x11", b"\x13", b"\x19", b"A1,0,0,0,1,0,0,0,1,0\r\n", b"B1\r\n"]
    commands += [
        b"N2,1,2,3\r\n",
        b"O3\r\n",
        b"Mp1,20\r\n",
        b"MF1,2\r\n",
        b"H1,0,0,1\r\n",
        b"R1\r\n",
    ]

    def fresh() -> Callable[[bytes], int]:
        unit, count = Is900Unit(6), [0]

        def take(data: bytes) -> int:
            assert len(unit.receive(data, 1.0, wandering(6), 0.5)) < 200 * (len(data) + 2)
            count[0] += 1
            if count[0] % 20 == 0:
                for _, record in unit.records(wandering(6), 0.5, 1.0):
                    unit.encode(record)
            return 0

        return take

    return Target("is900 unit", commands, fresh, False)


def _udp() -> Target:
    clean = [
        Packet(k % 256, 1 + k % 3, 255, np.full(3, 0.1), np.ones(3), 0.025 * k).encode()
        for k in range(60)
    ]
    make = _decoder(lambda: Is900UdpDecoder(Is900UdpConfig()), {})
    return Target("is900-udp", clean, make, False)


def _vrpn_messages() -> list[bytes]:
    report = vrpn.PoseReport(0, np.ones(3), np.array([1.0, 0.0, 0.0, 0.0])).encode()
    return [
        vrpn.description(vrpn.SENDER_DESCRIPTION, 0, "Tracker0").encode(),
        vrpn.description(vrpn.TYPE_DESCRIPTION, 0, vrpn.POSE).encode(),
        *(vrpn.Message(0, 0, 1e9 + 0.025 * k, report).encode() for k in range(40)),
    ]


def _vrpn(source: str) -> Target:
    clean = _vrpn_messages()
    if source == "tcp":
        clean = [vrpn.COOKIE, *clean]
    make = _decoder(lambda: VrpnDecoder(VrpnConfig(server="host")), {}, source)
    # TCP never loses its step by itself; if it does, the connection is made anew.
    return Target(f"vrpn {source}", clean, make, False)


def _requests() -> Target:
    def fresh() -> Callable[[bytes], int]:
        def take(data: bytes) -> int:
            try:
                host, port = vrpn.decode_connection_request(data)
            except vrpn.MalformedRecordError:
                return 0
            assert 1 <= port <= 65535
            return len(host) >= 0

        return take

    return Target("vrpn request", [vrpn.connection_request("127.0.0.1", 4000)], fresh, False)


def _osc() -> Target:
    clean: list[bytes] = []
    for k in range(20):
        bundle = OscBundleBuilder(IMMEDIATELY)
        for n in range(3):
            message = OscMessageBuilder("/VMC/Ext/Tra/Pos")
            message.add_arg(f"station{n}", "s")
            for value in (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0):
                message.add_arg(value, "f")
            bundle.add_content(message.build())
        time_message = OscMessageBuilder("/VMC/Ext/T")
        time_message.add_arg(0.025 * k, "f")
        bundle.add_content(time_message.build())
        clean.append(bundle.build().dgram)
        for part in ("position", "rotation"):
            message = OscMessageBuilder(f"/tracking/trackers/{1 + k % 3}/{part}")
            for value in (10.0, 20.0, 30.0):
                message.add_arg(value, "f")
            clean.append(message.build().dgram)
    return Target("osc", clean, _decoder(lambda: OscDecoder(OscConfig()), {}), False)


TARGETS: tuple[Target, ...] = (
    _is900((2, 11, 40, 21, 1), "binary"),
    _is900((2, 11, 21, 0), "binary"),
    _is900((2, 4), "binary"),
    _is900((18, 20), "binary"),
    _is900((2, 4, 40, 22, 23, 1), "ascii"),
    _unit(),
    _udp(),
    _vrpn("tcp"),
    _vrpn("udp"),
    _requests(),
    _osc(),
)

# Bytes that mean something to one protocol or another.
_SPICE = (b"0", b"2", b"3", b"01 ", b"\r\n", b"#bundle\0", b"/", b",", b"\xff\xff\xff\xff")
_SPICE += (b"\0\0\0\0", b"\x7f\xff\xff\xff", b"\x7f\xc0\0\0", b"\0\0\xc0\x7f", b"\xff\x01", b"\x19")


def mutilate(pieces: Sequence[bytes], rng: np.random.Generator) -> bytes:
    """One input: some pieces, damaged in one of many ways, or plain noise."""
    if rng.random() < 0.1:
        return rng.bytes(int(rng.integers(0, 200)))
    first = int(rng.integers(len(pieces)))
    data = bytearray(b"".join(pieces[first : first + int(rng.integers(1, 4))]))
    for _ in range(int(rng.integers(0, 4))):
        at = int(rng.integers(0, len(data) + 1))
        way = int(rng.integers(5))
        if way == 0 and at < len(data):
            data[at] ^= 1 << int(rng.integers(8))
        elif way == 1:
            del data[at : at + int(rng.integers(1, 20))]
        elif way == 2:
            data[at:at] = rng.bytes(int(rng.integers(1, 20)))
        elif way == 3:
            spice = _SPICE[int(rng.integers(len(_SPICE)))]
            data[at : at + len(spice)] = spice
        else:
            data[at:at] = data[: int(rng.integers(0, 60))]
    return bytes(data)


def fuzz(target: Target, inputs: int, rng: np.random.Generator) -> float:
    """Run a target.

    Args:
        target: what to run.
        inputs: how many inputs.
        rng: where they come from.

    Returns:
        The longest time that a single input kept the processor [s].

    Raises:
        AssertionError: naming the input that did what must not be.
    """
    take, slowest = target.make(), 0.0
    for k in range(inputs):
        data = mutilate(target.clean, rng)
        begun = time.thread_time()
        try:
            take(data)
        except Exception as error:
            raise AssertionError(f"{target.name}: {data!r} raised {error!r}") from error
        slowest = max(slowest, time.thread_time() - begun)
        if k % _BURST == _BURST - 1:
            if target.follows_stream:
                _check_step(target, take, data)
            if rng.random() < 0.2:
                take = target.make()
    return slowest


def _check_step(target: Target, take: Callable[[bytes], int], before: bytes) -> None:
    """After any nonsense, of ten clean records at most two are lost."""
    found = sum(take(piece) for piece in target.clean[:10])
    # What the nonsense began may be completed by clean bytes: more records, never fewer.
    assert found >= 8, f"{target.name}: {found} of 10 clean records after {before!r}"


def grows(target: Target, inputs: int, rng: np.random.Generator) -> int:
    """Bytes that a target keeps after many inputs, above what it keeps after some."""
    take = target.make()
    stream = [mutilate(target.clean, rng) for _ in range(200)]
    for k in range(inputs // 4):
        take(stream[k % len(stream)])
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for k in range(inputs):
            take(stream[k % len(stream)])
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()


def main() -> None:
    """Run all targets for long."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="in all")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    each = -(-options.inputs // len(TARGETS))
    for n, target in enumerate(TARGETS):
        rng = np.random.default_rng([options.seed, n])
        begun = time.monotonic()
        slowest = fuzz(target, each, rng)
        assert slowest < SLOWEST, f"{target.name}: one input took {slowest:.2f} s"
        kept = grows(target, 2_000, rng)
        assert kept < _MEMORY, f"{target.name} keeps {kept} bytes"
        seconds = time.monotonic() - begun
        sys.stdout.write(
            f"{target.name}: {each} inputs in {seconds:.0f} s, slowest {1e3 * slowest:.1f} ms, "
            f"kept {kept} bytes\n"
        )
        sys.stdout.flush()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sys.stdout.write(f"{each * len(TARGETS)} inputs, no complaint; peak memory {peak:.0f} MB\n")


if __name__ == "__main__":
    main()
