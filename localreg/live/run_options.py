"""What a run is told beyond its configuration, and whether it could begin.

Imports nothing heavy: a mistake is answered before MuJoCo and compiled code are loaded.
"""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

from localreg.body.subject import Subject, canonical_subject, read_subject
from localreg.errors import LocalregError
from localreg.live.config import RunConfig
from localreg.live.view_options import ViewOptions
from localreg.synthesis.settings import METHODS, Settings
from sensors.devices.replay import ReplayConfig
from sensors.recording.replay import read_configuration

RECORDING = ".mcap"
"""Ending of a recording of everything."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line adds to a configuration.

    Attributes:
        database: folder of the poses to learn from; None for the sample set.
        subject: file of who wears the trackers; None for usual proportions.
        seconds: how long to run [s]; None for ever.
        record: files to record to: `.mcap` for everything, `.bvh` or `.amc` for the motion.
        health: where a line of JSON goes every second; see `HealthReport`.
        host: address on which servers for other machines listen.
        view: where the body is to be seen.
    """

    database: Path | None = None
    subject: Path | None = None
    seconds: float | None = None
    record: tuple[Path, ...] = ()
    health: str | None = None
    host: str = "127.0.0.1"
    view: ViewOptions = field(default_factory=ViewOptions)


def wearer_of(config: RunConfig, options: RunOptions) -> Subject:
    """Look whether a run could begin, without opening anything.

    Returns:
        Who wears the trackers.

    Raises:
        LocalregError: what is wrong, in one sentence.
    """
    if config.synthesis.method not in METHODS:
        raise LocalregError(
            f"synthesis.method is {config.synthesis.method!r}; choose among {', '.join(METHODS)}"
        )
    if options.seconds is not None and not 0.0 < options.seconds < math.inf:
        raise LocalregError(f"cannot run for {options.seconds:g} s; give a positive time")
    _check_files(options)
    subject = options.subject
    return wearing(canonical_subject() if subject is None else read_subject(subject), config)


def method_settings(config: RunConfig) -> Settings:
    """The method's settings, with what the configuration says of the trackers' errors."""
    wanted, settings = config.synthesis, METHODS[config.synthesis.method]
    if wanted.position_error_m is not None:
        settings = replace(settings, sigma_position=wanted.position_error_m)
    if wanted.orientation_error_deg is not None:
        settings = replace(settings, sigma_orientation=math.radians(wanted.orientation_error_deg))
    return settings


def _check_files(options: RunOptions) -> None:
    """Whether the files to write can be what they are named, and are not there yet."""
    if options.record:
        _check_endings(options.record)
    health = () if options.health in (None, "-") else (Path(options.health),)
    for path in (*options.record, *health):
        if path.exists():
            raise LocalregError(f"{path} exists and is not overwritten; give another name")


def _check_endings(record: tuple[Path, ...]) -> None:
    from localreg.live.sinks.motion_stream import GROWING

    for path in record:
        if path.suffix.lower() not in (RECORDING, *GROWING):
            raise LocalregError(
                f"cannot record to {path}; give files ending in {RECORDING} (everything), "
                f"{' or '.join(GROWING)} (the motion)"
            )
    if sum(path.suffix.lower() == RECORDING for path in record) > 1:
        raise LocalregError(f"one recording at a time; give one file ending in {RECORDING}")


def wearing(subject: Subject, config: RunConfig) -> Subject:
    """The subject with those of its trackers that the devices report.

    A recording that is replayed reports the trackers of its own devices.

    Raises:
        LocalregError: a device reports a tracker that has no place on the body, or none
            has.
    """
    reported = list(config.trackers)
    for device in config.devices:
        if isinstance(device, ReplayConfig) and not device.stations:
            reported += read_configuration(device.file).trackers
    unknown = [name for name in reported if name not in subject.trackers]
    if unknown or not reported:
        raise LocalregError(
            f"the subject {subject.name} wears no tracker {', '.join(unknown) or '(none named)'}; "
            f"name the stations of the devices among {', '.join(subject.trackers)}"
        )
    return subject.with_trackers(tuple(n for n in subject.trackers if n in reported))
