"""`localreg run`: everything that a performer's machine runs for hours, put together.

What can fail because of the user or the machine fails before anything slow begins: the
configuration and the database, then ports and files, then compiling, and the trackers last,
which are waited for as long as it takes.
"""

import contextlib
import logging
import math
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from localreg.body.subject import Subject, read_subject
from localreg.errors import LocalregError
from localreg.live.compiling import Compiling
from localreg.live.config import EmulatorConfig, RunConfig
from localreg.live.database_choice import ChosenDatabase, choose_database, sample_clips
from localreg.live.health import Health, HealthReport
from localreg.live.outputs import open_motion_file, open_outputs
from localreg.live.quiet import IdleWork, undisturbed
from localreg.live.recenter import Recentering
from localreg.live.run_options import (
    RECORDING,
    RunOptions,
    method_settings,
    wearer_of,
    wearing,
)
from localreg.live.service_manager import notify
from localreg.live.session import Session, stopped_by_interrupt
from localreg.live.sinks import Sink
from localreg.live.status_server import StatusServer
from localreg.live.take import TakeRecorder
from localreg.live.warm_up import warm_up
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.methods import build_synthesizer
from localreg.synthesis.settings import Settings
from sensors.recording import Recorder
from sensors.tracker_input import TrackerInput

Tell = Callable[[str], None]
"""Says one sentence to whoever started the run."""


def run(
    config: RunConfig, options: RunOptions, tell: Tell, status: StatusServer | None = None
) -> dict[str, Any]:
    """Run until stopped by a signal, or for `options.seconds`.

    SIGINT and SIGTERM end it cleanly, SIGUSR1 re-centres the performer.

    Args:
        config: the configuration.
        options: the rest.
        tell: says what the user should know, one sentence at a time.
        status: where the state is served; closing it is the caller's.

    Returns:
        The last look at the run's health.

    Raises:
        LocalregError: it cannot begin, or a file could not be finished.
        SensorError: a device or recording cannot be had at all.
    """
    wearer_of(config, options)
    with contextlib.ExitStack() as stack:
        compiling = stack.enter_context(Compiling())
        stack.enter_context(_told_warnings(tell))
        recentering = Recentering()
        stack.enter_context(_ended_by_request())
        stack.enter_context(_recentered_by_signal(recentering))
        chosen = choose_database(options.database, tell)
        config = _at_rate(config, chosen.poses.rate)
        subject = chosen.subject if options.subject is None else read_subject(options.subject)
        subject = wearing(subject, config)
        sinks = _sinks(config, options, subject, stack)
        recorder = _recorder(options.record, stack)
        view, chores = None, ()
        if options.view.kind != "none":
            from localreg.live.viewing import EVERY, LiveView

            view = LiveView(
                options.view, subject, config.assembler.rate, tell,
                recenter=recentering.request, recorder=recorder,
            )  # fmt: skip
            stack.callback(view.close)
            sinks += view.sinks
            chores = ((EVERY, view.refresh),)
            if compiling.is_first:
                view.announce("compiling once for this machine, half a minute to a minute")
        settings = method_settings(config)
        estimator = _warm_estimator(settings, subject, chosen, tell, compiling)
        if config.emulator is not None:
            config = config.with_port(stack.enter_context(_emulated(config.emulator, config)))
        log = None if recorder is None else TakeRecorder(recorder)
        if log is not None:
            method = config.synthesis.method
            log.begin(method, settings, config.performance, subject, chosen)
            recentering.on_change = log.placed
        trackers = TrackerInput(config, trackers=subject.trackers, recorder=recorder)
        session = Session(
            trackers.stream,
            lambda _: estimator,
            sinks,
            devices=trackers.devices,
            config=config.performance,
            on_idle=IdleWork(*chores),
            place=recentering,
            log=log,
            now=trackers.stream.clock.now,
        )
        if view is not None:
            view.watch(session, trackers.stream, tuple(trackers.devices), chosen.poses)
            view.wait()
        health = Health(session, trackers.devices, sinks, recentering, recorder)
        if status is not None:
            status.start(health.look, recentering.request)
        with (
            undisturbed(),
            trackers,
            HealthReport(health.look, tell, options.health),
            stopped_by_interrupt(session),
        ):
            notify("READY=1")
            end = math.inf
            if options.seconds is not None:
                end = trackers.stream.clock.now() + options.seconds
            session.run(end=end)
            notify("STOPPING=1")
    return health.look()


def _at_rate(config: RunConfig, rate: float) -> RunConfig:
    config = config.at_rate(rate)
    if config.assembler.rate != rate:
        raise LocalregError(
            f"the database is at {rate:g} Hz and the assembler at {config.assembler.rate:g} Hz; "
            "build one at that rate, or leave assembler.rate out of the configuration"
        )
    return config


def _sinks(
    config: RunConfig, options: RunOptions, subject: Subject, stack: contextlib.ExitStack
) -> list[Sink]:
    """The outputs and motion files, open; what goes wrong later closes them."""
    rate = config.assembler.rate
    sinks = open_outputs(config.outputs, subject, rate, options.host)
    for sink in sinks:
        stack.callback(sink.close)
    for path in options.record:
        if path.suffix.lower() != RECORDING:
            sinks.append(open_motion_file(path, subject, rate))
            stack.callback(sinks[-1].close)
    return sinks


def _warm_estimator(
    settings: Settings, subject: Subject, chosen: ChosenDatabase, tell: Tell, compiling: Compiling
) -> AnyEstimator:
    if compiling.is_first:
        tell("compiling once for this machine, half a minute to a minute")
    estimator = build_synthesizer(settings, subject, chosen.poses)
    compiling.wait()
    seconds = warm_up(estimator)
    compiling.finish()
    tell(f"learning from {len(chosen.poses):,} poses; warmed up in {seconds:.1f} s")
    return estimator


def _recorder(record: tuple[Path, ...], stack: contextlib.ExitStack) -> Recorder | None:
    recordings = [path for path in record if path.suffix.lower() == RECORDING]
    return stack.enter_context(Recorder(recordings[0])) if recordings else None


@contextlib.contextmanager
def _emulated(emulator: EmulatorConfig, config: RunConfig) -> Iterator[str]:
    """The port of an emulated IS-900 on which real walks are played, over and over."""
    from localreg.live.demo.playlist import Playlist
    from sensors.emulators.process import EmulatorProcess

    playlist = Playlist.of(sample_clips(emulator.clips), config.assembler.rate)
    playback = playlist.playback()
    with tempfile.TemporaryDirectory() as scratch:
        file = Path(scratch) / "walks.npz"
        playback.save(file)
        arguments = ["--at-end", "loop", "--rate", f"{playlist.rate:g}"]
        arguments += ["--noise-position", str(emulator.noise_position)]
        arguments += ["--noise-orientation", str(emulator.noise_orientation)]
        with EmulatorProcess(file, [*arguments, "--seed", str(emulator.seed)]) as process:
            yield process.address


@contextlib.contextmanager
def _ended_by_request() -> Iterator[None]:
    """SIGTERM before the loop runs ends the program, too, and not without closing files."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        raise SystemExit(0)

    before = signal.signal(signal.SIGTERM, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextlib.contextmanager
def _recentered_by_signal(recentering: Recentering) -> Iterator[None]:
    """SIGUSR1 re-centres; only in the main thread, which alone may listen to signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        recentering.request()

    before = signal.signal(signal.SIGUSR1, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGUSR1, before)


class _Teller(logging.Handler):
    """Hands warnings of the tracker side on, such as that of a full disk."""

    def __init__(self, tell: Tell) -> None:
        super().__init__(logging.WARNING)
        self._tell = tell

    def emit(self, record: logging.LogRecord) -> None:
        """Say one warning."""
        self._tell(record.getMessage())


@contextlib.contextmanager
def _told_warnings(tell: Tell) -> Iterator[None]:
    logger, handler = logging.getLogger("sensors"), _Teller(tell)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
