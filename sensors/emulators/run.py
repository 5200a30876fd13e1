"""The emulator as a process: events on stdout, control on stdin.

A process of its own keeps the emulator's 40 Hz clock away from the interpreter lock of the
program under test. `time.monotonic` is one clock for all processes of a machine (Linux:
CLOCK_MONOTONIC), so the `start` event lets a consumer align the true motion with frames.
"""

import dataclasses
import json
import queue
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from sensors.emulators.base import Emulator, Start
from sensors.emulators.endpoints import Endpoint, PtyEndpoint, TcpEndpoint
from sensors.emulators.faults import Noise, parse_fault
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.is900_udp import Is900UdpEmulator
from sensors.emulators.osc import PORTS, OscEmulator
from sensors.emulators.recorded import load_motion
from sensors.emulators.source import PoseSource, looped, wandering
from sensors.emulators.vrpn import VrpnEmulator
from sensors.errors import ConfigurationError
from sensors.protocols import is900_udp, vrpn

AtEnd = Literal["hold", "loop", "exit"]
Protocol = Literal["is900", "is900-udp", "vrpn", "vmc", "vrchat"]
_Word = TypeVar("_Word", bound=str)

# A closing pseudo terminal takes unread bytes with it: give the host time for the last ones.
_LINGER = 0.5


@dataclass(frozen=True, slots=True)
class EmulateOptions:
    """Options of the command; see `sensors emulate --help`."""

    playback: Path | None = None
    protocol: str = "is900"
    to: str = ""
    stations: int = 6
    rate: float = 40.0
    tcp: str = ""
    link: Path | None = None
    start: str = "continuous"
    at_end: str = "hold"
    baud: int = 0
    noise_position: float = 0.0
    noise_orientation: float = 0.0
    seed: int = 0
    clock_drift: float = 0.0
    faults: tuple[str, ...] = ()
    control: bool = False


def run_emulator(options: EmulateOptions) -> None:
    """Emulate until the motion ends (with `exit`), a signal, or the controller's word.

    Raises:
        SensorError: for options or files that cannot be used.
    """
    start = _choice("start", options.start, get_args(Start))
    at_end = _choice("at-end", options.at_end, get_args(AtEnd))
    source, names, duration = _source(options, at_end)
    faults = [parse_fault(text) for text in options.faults]
    stop: queue.SimpleQueue[str] = queue.SimpleQueue()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.put("signal"))
    common: dict[str, Any] = {
        "rate": options.rate,
        "start": start,
        "faults": faults,
        "noise": Noise(options.noise_position, options.noise_orientation),
        "seed": options.seed,
        "clock_drift": options.clock_drift,
        "on_start": lambda zero: _say("start", monotonic=zero),
    }
    emulator = _emulator(options, source, len(names), common)
    with emulator:
        _say(
            "ready",
            address=emulator.address,
            names=names,
            stations=len(names),
            rate=options.rate,
            duration=duration,
        )
        if options.control:
            controller = threading.Thread(target=_obey, args=(emulator, stop), daemon=True)
            controller.start()
        reason = _wait(emulator, stop, duration if at_end == "exit" else None)
    counters = dataclasses.asdict(emulator.counters)
    _say("end", monotonic=time.monotonic(), reason=reason, **counters)


def _source(
    options: EmulateOptions, at_end: AtEnd
) -> tuple[PoseSource, tuple[str, ...], float | None]:
    if options.playback is None:
        if not 1 <= options.stations <= 12:
            raise ConfigurationError(f"there cannot be {options.stations} stations; give 1 to 12")
        names = tuple(f"station{n}" for n in range(1, options.stations + 1))
        return wandering(options.stations), names, None
    motion = load_motion(options.playback)
    source: PoseSource = motion.pose_at
    if at_end == "loop":
        source = looped(source, motion.duration)
    return source, motion.names, motion.duration


def _emulator(
    options: EmulateOptions, source: PoseSource, stations: int, common: dict[str, Any]
) -> Emulator:
    protocol = _choice("protocol", options.protocol, get_args(Protocol))
    if protocol == "is900":
        baud = options.baud or None
        return Is900Emulator(
            source, stations=stations, endpoint=_endpoint(options), baud=baud, **common
        )
    if protocol == "vrpn":
        host, port = _host_and_port("tcp", options.tcp or f"127.0.0.1:{vrpn.DEFAULT_PORT}")
        return VrpnEmulator(source, host=host, port=port, **common)
    usual = {"is900-udp": is900_udp.DEFAULT_PORT, **PORTS}
    host, port = _host_and_port("to", options.to or f"127.0.0.1:{usual[protocol]}")
    if protocol == "is900-udp":
        return Is900UdpEmulator(source, host=host, port=port, **common)
    return OscEmulator(source, host=host, port=port, dialect=protocol, **common)


def _endpoint(options: EmulateOptions) -> Endpoint:
    if not options.tcp:
        return PtyEndpoint(options.link)
    return TcpEndpoint(*_host_and_port("tcp", options.tcp))


def _host_and_port(name: str, text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise ConfigurationError(f"{name} is {text!r}; give host:port, like 127.0.0.1:5001")
    return host, int(port)


def _choice(name: str, value: str, valid: tuple[_Word, ...]) -> _Word:
    for choice in valid:
        if choice == value:
            return choice
    raise ConfigurationError(f"{name} is {value!r}; choose from {', '.join(valid)}")


def _wait(emulator: Emulator, stop: "queue.SimpleQueue[str]", duration: float | None) -> str:
    while True:
        zero = emulator.motion_zero
        left = None
        if duration is not None and zero is not None:
            left = zero + duration + _LINGER - time.monotonic()
            if left <= 0.0:
                return "finished"
        try:
            # Wake now and then: the zero may have become known.
            return stop.get(timeout=0.05 if left is None else left)
        except queue.Empty:
            continue


def _obey(emulator: Emulator, stop: "queue.SimpleQueue[str]") -> None:
    for line in sys.stdin:
        word, _, rest = line.strip().partition(" ")
        if word == "begin":
            emulator.begin()
        elif word == "quit":
            break
        elif word == "fault":
            try:
                fault = parse_fault(rest)
            except ConfigurationError as error:
                _say("error", message=str(error))
                continue
            # On the controller's line `start` counts from now.
            now = emulator.motion_time(time.monotonic())
            emulator.faults.inject(dataclasses.replace(fault, start=fault.start + now))
        elif word:
            _say("error", message=f"{word!r} is no command; there are begin, fault and quit")
    stop.put("stdin")


_say_lock = threading.Lock()


def _say(event: str, **fields: object) -> None:
    with _say_lock:
        sys.stdout.write(json.dumps({"event": event, **fields}) + "\n")
        sys.stdout.flush()
