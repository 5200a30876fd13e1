"""The view of a run: which one, its process, its buttons, and what it is told."""

import threading
import time
from collections.abc import Callable
from typing import Final, Literal, Self
from urllib.parse import urlsplit

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.subject import Subject
from localreg.database.store import PoseDatabase
from localreg.errors import LocalregError
from localreg.live.nearest_clips import Example, Found, NearestClips
from localreg.live.session import Session
from localreg.live.sinks.base import LivePose, Sink
from localreg.live.sinks.view import GhostAt, ViewSink
from localreg.live.takes import Takes
from localreg.live.view_options import ViewOptions
from localreg.view.feed import About, Glimpse
from localreg.view.moment import Heard, Timing
from localreg.view.process import ViewProcess
from localreg.view.source import Command
from sensors.devices.base import Device
from sensors.errors import SensorError
from sensors.pose import TrackerFrame
from sensors.recording import Recorder
from sensors.stream import FrameStream

EVERY: Final = 0.25
"""How often the view is told what changes slowly [s]."""

PAUSES: Final = (1.0, 3.0, 10.0, 30.0)
"""After what time a view that died is begun again, the first time and so on [s]."""

_FORGIVEN: Final = 600.0  # a view that lasted so long may die as often as a new one [s]
_RECENT: Final = 2400
SEARCH_EVERY: Final = 2
"""How many of these times pass until clips are looked for again."""


class LiveView:
    """Begins at once and in the background; `wait` when it is needed.

    Should its process die once it was seen, it is begun again, a few times.

    Args:
        options: page or window, and where.
        subject: whose body is shown, wearing the trackers of the frames.
        rate: frames a second [Hz].
        tell: says one sentence to whoever started the run.
        recenter: re-centres the performer; None where that cannot be asked for.
        recorder: the run's recording, which marks go into.
        ghost_at: a body to compare with, in the live loop; the database's best example by
            default.
        ghost_name: what that body is.
        capacity: frames kept for an export.
    """

    def __init__(
        self,
        options: ViewOptions,
        subject: Subject,
        rate: float,
        tell: Callable[[str], None],
        *,
        recenter: Callable[[], None] | None = None,
        recorder: Recorder | None = None,
        ghost_at: GhostAt | None = None,
        ghost_name: str = "best example",
        capacity: int = 144_000,
    ) -> None:
        if options.kind == "none":
            raise ValueError("there is no view to begin")
        self._tell = tell
        self._ghost_name = ghost_name
        self._takes = Takes(
            options.takes, subject, rate, tell, recorder=recorder, capacity=capacity
        )
        self._do: dict[Command, Callable[[], None]] = {
            "record": self._takes.record,
            "mark": self._takes.mark,
            "export": self._takes.export,
        }
        if recenter is not None:
            self._do["recenter"] = recenter
        self._note = ""
        self._options, self._subject = options, subject
        self._kind: Literal["web", "native"] = options.kind
        self._port = options.port
        self._changing, self._is_over = threading.RLock(), threading.Event()
        self._left: list[ViewProcess] = []
        self._deaths, self._since = 0, time.monotonic()
        self._process = self._begin()
        self._sink = ViewSink(self._process, ghost_at or self._example_at)
        self._watched: _Watched | None = None
        self._turn = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def sinks(self) -> list[Sink]:
        """Who is to be handed every pose."""
        return [self._takes, self._sink]

    @property
    def pid(self) -> int:
        """Of the view's process."""
        return self._process.pid

    def wait(self) -> str:
        """Until the view can be seen; says where, and warns if others can see it, too.

        Raises:
            LocalregError: it cannot be shown, in one sentence.
        """
        try:
            where, is_open = self._process.wait()
        except LocalregError as error:
            if self._options.kind != "native" or not self._options.falls_back:
                raise
            self._tell(f"{error}; a page will do")
            self._process.close()
            self._kind = "web"
            self._process = self._sink.process = self._begin()
            where, is_open = self._process.wait()
        self._tell(f"view: {where}")
        if self._kind == "web":
            self._port = urlsplit(where).port  # where open pages look for one that comes again
        if is_open:
            self._tell(
                "warning: the view is open to every machine that reaches this address; whoever "
                "does sees the body and may press the buttons. Leave --host away to close it"
            )
        return where

    def watch(
        self,
        session: Session,
        stream: FrameStream,
        devices: tuple[Device, ...],
        database: PoseDatabase,
        *,
        title_at: Callable[[float], str] = lambda time: "",
        allowed_at: Callable[[float], Bool[ndarray, " poses"] | None] = lambda time: None,
    ) -> None:
        """Say what the view is to be told of.

        Args:
            session: the loop.
            stream: where its frames come from.
            devices: the drivers.
            database: the poses that are learned from.
            title_at: what is being played at an instant [s].
            allowed_at: which poses may be learned from at an instant; None for all.
        """
        self._watched = _Watched(
            session,
            stream,
            devices,
            NearestClips(database),
            Example(database),
            title_at,
            allowed_at,
        )

    def refresh(self) -> None:
        """Tell the view what has changed; for an idle moment of the loop, about 0.5 ms."""
        watched = self._watched
        if watched is None:
            return
        self._turn += 1
        if self._turn % SEARCH_EVERY == 0:
            watched.search()
        self._process.tell(
            watched.about(
                ghost_name=self._ghost_name,
                note=self._note or self._takes.note,
                is_recording=self._takes.is_recording,
            )
        )

    def announce(self, words: str, title: str = "") -> None:
        """Show some words above all else until the first `refresh`.

        Args:
            words: what has to be known, for example that something is being compiled.
            title: what is being shown.
        """
        self._process.tell(About(title=title, notice=words))

    def show(self, index: int, at: float, qpos: Float[ndarray, "63"]) -> None:
        """Show a body that no tracker has been heard for, before the first pose is live.

        Args:
            index: number of the frame.
            at: its instant [s].
            qpos: the body.
        """
        count = len(self._subject.trackers)
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
        unseen = np.zeros(count, dtype=bool)
        frame = TrackerFrame(at, np.zeros((count, 3)), quaternions, unseen, unseen)
        self._process.show(Glimpse(index, frame, qpos, float("nan"), False, False, None))

    def close(self) -> None:
        """End the view, and finish what its buttons began. Doing so twice is no error."""
        self._is_over.set()
        with self._changing:
            for process in (self._process, *self._left):
                process.close()
        self._takes.close()

    def _example_at(self, live: LivePose) -> Float[ndarray, "63"] | None:
        watched = self._watched
        return None if watched is None else watched.example.at(live.pose.qpos, live.frame.time)

    def _begin(self) -> ViewProcess:
        return ViewProcess(
            self._subject,
            self._kind,
            host=self._options.host,
            port=self._port,
            takes=self._options.takes,
            commands=tuple(self._do),
            on_command=self._obey,
            on_end=self._ended,
        )

    def _ended(self, code: int) -> None:
        """Begin again what died; called in a thread of the process that has ended."""
        if code == 0:
            self._tell("the view was closed; the motion goes on without it")
            return
        if time.monotonic() - self._since > _FORGIVEN:
            self._deaths = 0
        while self._deaths < len(PAUSES):
            pause = PAUSES[self._deaths]
            self._deaths += 1
            self._tell(f"the view died and begins again in {pause:g} s; the motion goes on")
            if self._is_over.wait(pause) or self._is_seen_again():
                return
        self._tell("the view died too often; the motion goes on without it")

    def _is_seen_again(self) -> bool:
        """Whether another process can be seen, or none is wanted any more."""
        with self._changing:
            if self._is_over.is_set():
                return True
            # The loop may be writing to the old one just now, so it is closed with all else.
            self._left.append(self._process)
            self._since = time.monotonic()
            self._process = self._sink.process = self._begin()
        try:
            self._process.wait()
        except LocalregError:
            return self._is_over.is_set()
        return True

    def _obey(self, name: Command) -> None:
        self._note = ""
        try:
            self._do[name]()
        except (OSError, LocalregError, SensorError) as error:
            self._note = f"could not {name}; see the terminal"
            self._tell(f"could not {name}: {error}")
        if name == "recenter":
            self._note = "recentered"


class _Watched:
    """What a view is told of, and the figures in between."""

    def __init__(
        self,
        session: Session,
        stream: FrameStream,
        devices: tuple[Device, ...],
        clips: NearestClips,
        example: Example,
        title_at: Callable[[float], str],
        allowed_at: Callable[[float], Bool[ndarray, " poses"] | None],
    ) -> None:
        self._session, self._stream, self._devices = session, stream, devices
        self._clips, self._title_at, self._allowed_at = clips, title_at, allowed_at
        self.example = example
        self._nearest = Found()
        self._counts: dict[str, tuple[float, int]] = {}
        self._rates: dict[str, float] = {}

    def search(self) -> None:
        """Look for clips that hold poses like the present one."""
        latest = self._session.latest
        if latest is not None:
            allowed = self._allowed_at(latest.frame.time)
            self._nearest = self._clips.find(latest.pose.qpos, allowed)
            self.example.begin(self._nearest.row, latest.frame.time)

    def about(self, *, ghost_name: str, note: str, is_recording: bool) -> About:
        """What changes slowly, as it is now."""
        session = self._session
        latest, counters = session.latest, session.counters
        latency, compute = counters.latency.recent(_RECENT), counters.compute.recent(_RECENT)
        return About(
            timing=Timing(
                *_percentiles(latency), counters.frames, counters.late_frames,
                *_percentiles(compute),
            ),
            heard=self._heard(),
            neighbors=self._nearest.clips,
            title="" if latest is None else self._title_at(latest.frame.time),
            ghost_name=ghost_name,
            note=note,
            is_recording=is_recording,
        )  # fmt: skip

    def _heard(self) -> dict[str, Heard]:
        now = self._stream.clock.now()
        heard = {}
        for device in self._devices:
            for name, count in device.counters.samples.items():
                since, before = self._counts.setdefault(name, (now, count))
                if now - since >= 1.0:
                    self._rates[name] = (count - before) / (now - since)
                    self._counts[name] = (now, count)
                if name in self._stream.assembler.trackers:
                    age = now - self._stream.assembler.newest(name)
                    heard[name] = Heard(self._rates.get(name, float("nan")), age)
        return heard


def _percentiles(values: Float[ndarray, " n"]) -> tuple[float, float]:
    if not values.size:
        return float("nan"), float("nan")
    p50, p99 = np.percentile(values, (50.0, 99.0))
    return float(p50), float(p99)
