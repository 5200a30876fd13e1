"""Plays the clips over a serial line and synthesizes them as they come."""

import contextlib
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from localreg.database.store import DEFAULT_RATE, PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.results import Settings, program_version
from localreg.live.compiling import Compiling
from localreg.live.demo.faults import bad_day
from localreg.live.demo.playlist import Playlist
from localreg.live.demo.preview import Preview
from localreg.live.demo.scores import LiveScore, score, with_counts
from localreg.live.demo.show import REFRESH, ProgressLine
from localreg.live.demo.view import DemoView
from localreg.live.quiet import IdleWork, undisturbed
from localreg.live.session import Session, stopped_by_interrupt
from localreg.live.sinks import Collector, MotionFile
from localreg.live.view_options import ViewOptions
from localreg.live.viewing import EVERY
from localreg.live.warm_up import warm_up
from localreg.motion.motion import Motion
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.methods import build_estimator
from sensors.assembler import AssemblerConfig, FrameAssembler
from sensors.devices.is900 import Is900Config, Is900Device
from sensors.emulators.process import EmulatorProcess
from sensors.errors import ConnectionFailedError
from sensors.stream import FrameStream

MOTION_FILE = "synthesis.bvh"
PICTURE = "filmstrip.png"

_CONNECT_TIMEOUT = 20.0
_BEGIN_TIMEOUT = 5.0

# Held poses before the motion begins: the clock of the device and the phase of the frames
# settle meanwhile.
_LEAD_IN = 1.0


@dataclass(frozen=True, slots=True)
class DemoConfig:
    """Settings of the demo.

    Attributes:
        seconds: how long to play [s]; None for the whole list once.
        seed: of the emulator's noise and faults.
        noise_position: standard deviation on each axis [m].
        noise_orientation: standard deviation about each axis [deg].
        faults: whether the line has a bad day; see `bad_day`.
        method: which estimator.

    Raises:
        LocalregError: a number that cannot be.
    """

    seconds: float | None = None
    seed: int = 0
    noise_position: float = 0.003
    noise_orientation: float = 0.5
    faults: bool = False
    method: str = "localreg"

    def __post_init__(self) -> None:
        if self.seconds is not None and not 0.5 <= self.seconds < math.inf:
            raise LocalregError(f"cannot play {self.seconds:g} s; give half a second or more")
        if self.seed < 0:
            raise LocalregError(f"the seed is {self.seed}; give a number of 0 or more")
        for name in ("noise_position", "noise_orientation"):
            value = getattr(self, name)
            if not 0.0 <= value < math.inf:
                raise LocalregError(f"{name} is {value}; give a standard deviation of 0 or more")


@dataclass(frozen=True, eq=False)
class DemoRun:
    """What came of it.

    Attributes:
        score: figures.
        session: its counters.
        collected: what was published.
        zero: host's monotonic time of the motion's beginning [s].
        motion_file: the synthesized motion.
    """

    score: LiveScore
    session: Session
    collected: Collector
    zero: float
    motion_file: Path


def run_demo(
    motions: Sequence[Motion],
    config: DemoConfig,
    folder: Path,
    console: Console,
    seen: ViewOptions | None = None,
    compiling: Compiling | None = None,
) -> DemoRun:
    """Play motions, each left out of the database while it plays.

    The emulator is a process of its own on a pseudo terminal; the driver reads it with
    pyserial in a thread of this process, and everything else is in the calling thread.
    Ctrl-C ends the playing, and what was played is scored.

    Args:
        motions: the clips; also the database.
        config: settings.
        folder: where the motion file goes; it exists.
        console: for what is said meanwhile.
        seen: where the body is to be seen; by default nowhere. The clips are shown as they
            were recorded until the first pose is live.
        compiling: what is being compiled beside; closing it is the caller's.

    Raises:
        LocalregError: nothing can be played, not one pose came, or the view cannot begin.
        SensorError: the emulator or the line does not work.
    """
    playlist = Playlist.of(motions, DEFAULT_RATE, config.seconds)
    arguments = _emulator_arguments(config, playlist)
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "walks.npz"
        playlist.playback().save(file)
        with (
            _begun(seen, playlist, console) as view,
            EmulatorProcess(file, arguments) as emulator,
        ):
            with _waiting(playlist, view, compiling, console):
                database = PoseDatabase.build(motions, rate=playlist.rate, mirror=True)
                estimators = _warm_estimators(database, playlist, config.method, console, compiling)
            return _play(playlist, database, estimators, emulator, config, folder, console, view)


@contextlib.contextmanager
def _begun(
    seen: ViewOptions | None, playlist: Playlist, console: Console
) -> Iterator[DemoView | None]:
    """The view, beginning beside the warm-up; None if none is wanted."""
    if seen is None or seen.kind == "none":
        yield None
        return
    with DemoView(
        seen, playlist, lambda words: console.print(words, highlight=False, soft_wrap=True)
    ) as view:
        yield view


def _emulator_arguments(config: DemoConfig, playlist: Playlist) -> list[str]:
    arguments = ["--start", "later", "--rate", f"{playlist.rate:g}"]
    arguments += ["--noise-position", str(config.noise_position)]
    arguments += ["--noise-orientation", str(config.noise_orientation)]
    arguments += ["--seed", str(config.seed)]
    for fault in bad_day(playlist.seconds) if config.faults else ():
        arguments += ["--fault", fault]
    return arguments


@contextlib.contextmanager
def _waiting(
    playlist: Playlist, view: DemoView | None, compiling: Compiling | None, console: Console
) -> Iterator[None]:
    """Something to see, and words on what is done, while the database is learned from."""

    def progress() -> str:
        if compiling is None or not compiling.is_first:
            return "learning from the database"
        return compiling.progress()

    if compiling is not None and compiling.is_first:
        console.print(
            "compiling once for this machine, half a minute to a minute; until then the view "
            "shows the walk as it was recorded",
            highlight=False, soft_wrap=True,
        )  # fmt: skip
    with (
        console.status(progress()) as status,
        Preview(playlist, view, progress, status.update),
    ):
        yield


def _warm_estimators(
    database: PoseDatabase,
    playlist: Playlist,
    method: str,
    console: Console,
    compiling: Compiling | None,
) -> tuple[AnyEstimator, ...]:
    """For every clip of the list an estimator that must not look at it, compiled."""
    everything = build_estimator(method, playlist.subject, database)
    without: dict[str, AnyEstimator] = {}
    for clip in playlist.clips:
        name = clip.provenance.name
        if name not in without:
            without[name] = everything.leave_out(database.exclude(clip=name))
    if compiling is not None:
        compiling.wait()
    seconds = warm_up(without[playlist.clips[0].provenance.name], halves=False)
    if compiling is not None:
        compiling.finish()
    console.print(
        f"database of {len(database):,} poses at {database.rate:g} Hz; "
        f"warmed up in {seconds:.1f} s",
        highlight=False,
    )
    return tuple(without[clip.provenance.name] for clip in playlist.clips)


def _play(
    playlist: Playlist,
    database: PoseDatabase,
    estimators: tuple[AnyEstimator, ...],
    emulator: EmulatorProcess,
    config: DemoConfig,
    folder: Path,
    console: Console,
    view: DemoView | None,
) -> DemoRun:
    trackers = playlist.subject.trackers
    stations = {name: number for number, name in enumerate(trackers, start=1)}
    device = Is900Device(Is900Config(port=emulator.address, stations=stations))
    stream = FrameStream(
        device.samples, FrameAssembler(trackers, AssemblerConfig(rate=playlist.rate))
    )
    capacity = playlist.rows + round(playlist.rate)
    collected = Collector(capacity)
    file = MotionFile(folder / MOTION_FILE, playlist.subject, playlist.rate, capacity)
    with undisturbed(), device:
        _settle(device, stream)
        zero = _begin(emulator)

        def clip_at(time: float) -> int:
            return playlist.clip_at(time - zero)

        # Every frame counts for accuracy, however late it comes on a busy machine.
        session = Session(
            stream,
            lambda t: estimators[clip_at(t)],
            [collected, file, *(() if view is None else view.sinks)],
            devices=[device],
            most_behind=math.inf,
        )
        line = ProgressLine(
            console,
            session,
            lambda t: playlist.clips[clip_at(t)].provenance.name,
            playlist.seconds,
            zero,
        )
        chores = [(REFRESH, line.draw)]
        if view is not None:
            view.begin(session, stream, device, database, zero)
            chores.append((EVERY, view.refresh))
        session.on_idle = IdleWork(*chores)
        with line, stopped_by_interrupt(session):
            # Half a period early: a frame counts for the row that is nearest.
            half = 0.5 / playlist.rate
            session.run(zero - half, zero + playlist.seconds - half)
    settings = _settings(playlist, config)
    scored = with_counts(score(playlist, collected, zero, settings, config.method), session)
    return DemoRun(scored, session, collected, zero, file.path)


def _settle(device: Is900Device, stream: FrameStream) -> None:
    """Wait for the stream, then let clock and phase settle on held poses.

    Raises:
        ConnectionFailedError: nothing came.
    """
    give_up = time.monotonic() + _CONNECT_TIMEOUT
    while stream.next(0.1) is None:
        if time.monotonic() > give_up:
            raise ConnectionFailedError(
                f"no tracker data within {_CONNECT_TIMEOUT:g} s: "
                f"{device.last_error or device.state}; try again"
            )
    settled = time.monotonic() + _LEAD_IN
    while time.monotonic() < settled:
        stream.next(0.1)


def _begin(emulator: EmulatorProcess) -> float:
    """Start the motion; returns the host's monotonic time of its zero [s]."""
    emulator.begin()
    if not emulator.wait_started(_BEGIN_TIMEOUT) or emulator.motion_zero is None:
        raise ConnectionFailedError("the emulator did not begin to play; try again")
    return emulator.motion_zero


def _settings(playlist: Playlist, config: DemoConfig) -> Settings:
    return Settings(
        rate_hz=playlist.rate,
        seed=config.seed,
        start="cold",
        noise_position_m=config.noise_position,
        noise_orientation_deg=config.noise_orientation,
        database="leave-out clip",
        version=program_version(),
    )
