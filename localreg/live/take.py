"""What a recording holds beyond the trackers: how poses were made, and the poses.

The channels `/raw/...`, `/samples`, `/frames` and so on are those of `sensors.recording`.
With the ones here a take can be repeated from its raw bytes to the last bit, or solved anew
with other settings:

- `/take`: method, settings, subject, database, versions; once, at the beginning;
- `/search`: frames at which a body was being found, and frames that were passed over:
  what depended on the clock;
- `/poses`: what the estimator said, before any re-centring;
- `/placement`: from which frame on poses were published elsewhere.
"""

import dataclasses
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import Subject, read_subject, write_subject
from localreg.errors import LocalregError
from localreg.evaluation.results import program_version
from localreg.live.database_choice import ChosenDatabase
from localreg.live.performance import Search
from localreg.live.performance_config import PerformanceConfig
from localreg.live.sinks.base import LivePose
from localreg.synthesis.settings import METHODS, Settings
from sensors.assembler import AssembledFrame
from sensors.placement import RoomTransform
from sensors.recording import Recorder, read_recording
from sensors.recording.replay import read_configuration
from sensors.recording.schemas import FRAMES, object_schema

TAKE: Final = "/take"
SEARCH: Final = "/search"
POSES: Final = "/poses"
PLACEMENT: Final = "/placement"

PASSED_OVER: Final = "passed over"
"""What `/search` says of a frame that was not taken, for the loop was behind."""

VERSION: Final = 1
"""Version of the layout of these channels."""

DEFAULT_METHOD: Final = "localreg"
"""How poses are made where nobody says."""

_NUMBER: Final = {"type": "number"}
_INTEGER: Final = {"type": "integer"}
_TEXT: Final = {"type": "string"}
_OBJECT: Final = {"type": "object"}
_NUMBERS: Final = {"type": "array", "items": _NUMBER}

_TAKE_SCHEMA: Final = object_schema(
    "localreg.Take", "How the poses were made.", version=_INTEGER, program=_TEXT, method=_TEXT,
    settings=_OBJECT, performance=_OBJECT, subject=_TEXT, database=_OBJECT,
)  # fmt: skip
_SEARCH_SCHEMA: Final = object_schema(
    "localreg.Search",
    "How the search for the body stood, or that the frame was passed over.",
    index=_INTEGER,
    search=_TEXT,
)
_POSE_SCHEMA: Final = object_schema(
    "localreg.Pose",
    "Root position [m], root quaternion w x y z, 56 joint angles [rad]; before placement.",
    index=_INTEGER, time=_NUMBER, qpos=_NUMBERS, confidence={"type": ["number", "null"]},
    result=_INTEGER, held={"type": "boolean"}, start={"type": "boolean"},
)  # fmt: skip
_PLACEMENT_SCHEMA: Final = object_schema(
    "localreg.Placement", "Where poses are published from a frame on.",
    index=_INTEGER, yaw={**_NUMBER, "description": "about z [rad]"},
    translation={**_NUMBERS, "description": "x y z [m]"},
)  # fmt: skip


class TakeRecorder:
    """Writes these channels; it is the `FrameLog` of a session.

    Args:
        recorder: the recording.
    """

    def __init__(self, recorder: Recorder) -> None:
        self._take = recorder.channel(TAKE, "localreg.Take", _TAKE_SCHEMA)
        self._search = recorder.channel(SEARCH, "localreg.Search", _SEARCH_SCHEMA)
        self._poses = recorder.channel(POSES, "localreg.Pose", _POSE_SCHEMA)
        self._placement = recorder.channel(PLACEMENT, "localreg.Placement", _PLACEMENT_SCHEMA)

    def begin(
        self,
        method: str,
        settings: Settings,
        performance: PerformanceConfig,
        subject: Subject,
        database: ChosenDatabase,
    ) -> None:
        """Record how poses are made."""
        message = {
            "version": VERSION,
            "program": program_version(),
            "method": method,
            "settings": dataclasses.asdict(settings),
            "performance": performance.model_dump(mode="json"),
            "subject": _subject_text(subject),
            "database": {
                "identity": database.identity,
                "source": database.source,
                "poses": len(database.poses),
                "rate": database.poses.rate,
            },
        }
        self._take.write(message, time.monotonic())

    def taken(self, assembled: AssembledFrame, search: Search, live: LivePose | None) -> None:
        """Record how a frame was taken and what came of it."""
        when = assembled.frame.time
        if search != "none":
            self._search.write({"index": assembled.index, "search": search}, when)
        if live is None:
            return
        pose = live.pose
        message = {
            "index": live.instant,
            "time": when,
            "qpos": np.asarray(pose.qpos),
            "confidence": float(pose.confidence),
            "result": int(pose.result),
            "held": live.is_held,
            "start": live.is_start,
        }
        self._poses.write(message, when)

    def passed_over(self, assembled: AssembledFrame) -> None:
        """Record that a frame was not taken."""
        message = {"index": assembled.index, "search": PASSED_OVER}
        self._search.write(message, assembled.frame.time)

    def placed(self, live: LivePose, transform: RoomTransform) -> None:
        """Record that poses are published elsewhere from this frame on."""
        message = {
            "index": live.instant,
            "yaw": transform.yaw,
            "translation": list(transform.translation),
        }
        self._placement.write(message, live.frame.time)


class NoTakeError(LocalregError):
    """A recording that does not say how poses were made: nobody made any."""


@dataclass(frozen=True, eq=False)
class Take:
    """How the poses of a recording were made.

    Attributes:
        program: version of the program.
        method: name of the method.
        settings: the method's.
        performance: when to step, when to hold.
        subject: whose body, wearing the trackers of the frames.
        database: identity, source, poses and rate of the database.
        searches: how the search stood at the frames where there was one, by index; or that
            a frame was passed over.
        placements: transforms that poses were published with, by index of the first frame.
        frames: how many frames were closed.
        indices: of the recorded poses.
        qpos: the recorded poses, before placement.
    """

    program: str
    method: str
    settings: Settings
    performance: PerformanceConfig
    subject: Subject
    database: dict[str, Any]
    searches: dict[int, str]
    placements: dict[int, RoomTransform]
    frames: int
    indices: tuple[int, ...]
    qpos: Float[ndarray, "frames 63"]

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read these channels of a recording, complete or cut off.

        Raises:
            NoTakeError: it holds trackers only.
            LocalregError: it is of another version.
            SensorError: it is no recording.
        """
        document: dict[str, Any] | None = None
        searches: dict[int, str] = {}
        placements: dict[int, RoomTransform] = {}
        indices: list[int] = []
        rows: list[list[float]] = []
        frames = 0
        for message in read_recording(path, (TAKE, SEARCH, POSES, PLACEMENT, FRAMES)):
            data = message.data
            if message.topic == FRAMES:
                frames += 1
            elif message.topic == TAKE:
                document = data
            elif message.topic == SEARCH:
                searches[data["index"]] = data["search"]
            elif message.topic == PLACEMENT:
                x, y, z = data["translation"]
                placements[data["index"]] = RoomTransform(data["yaw"], (x, y, z))
            else:
                indices.append(data["index"])
                rows.append(data["qpos"])
        if document is None:
            raise NoTakeError(
                f"{path} is no take of localreg run: it does not say how poses were made; "
                "localreg synthesize can make some of its trackers"
            )
        if document["version"] != VERSION:
            raise LocalregError(
                f"{path} is of version {document['version']}; this program reads {VERSION}"
            )
        return cls(
            program=document["program"],
            method=document["method"],
            settings=_settings(document["settings"], path),
            performance=PerformanceConfig.parse(document["performance"], str(path)),
            subject=_subject(document["subject"]),
            database=document["database"],
            searches=searches,
            placements=placements,
            frames=frames,
            indices=tuple(indices),
            qpos=np.array(rows, dtype=float).reshape(len(rows), QPOS_SIZE),
        )

    @classmethod
    def of_trackers(cls, path: Path, subject: Subject) -> Self:
        """A recording of trackers alone, as if nobody had looked on.

        Args:
            path: the recording.
            subject: who wore the trackers.

        Raises:
            SubjectError: the subject does not wear one of them.
            SensorError: it is no recording.
        """
        recorded = read_configuration(path)
        return cls(
            program=program_version(),
            method=DEFAULT_METHOD,
            settings=METHODS[DEFAULT_METHOD],
            performance=PerformanceConfig(),
            subject=subject.with_trackers(recorded.trackers),
            database={"identity": "", "rate": recorded.assembler.rate},
            searches={},
            placements={},
            frames=sum(1 for _ in read_recording(path, (FRAMES,))),
            indices=(),
            qpos=np.zeros((0, QPOS_SIZE)),
        )

    def placement(self, index: int) -> RoomTransform | None:
        """The transform that the frame of an index was published with."""
        before = [first for first in self.placements if first <= index]
        return self.placements[max(before)] if before else None


def _settings(document: dict[str, Any], path: Path) -> Settings:
    values: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in document.items()
    }
    try:
        return Settings(**values)
    except TypeError:
        raise LocalregError(
            f"{path} was made with settings that this version of the method does not have; "
            "name the method to solve it anew: --method localreg"
        ) from None


def _subject_text(subject: Subject) -> str:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "subject.toml"
        write_subject(subject, file)
        return file.read_text(encoding="utf-8")


def _subject(text: str) -> Subject:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "subject.toml"
        file.write_text(text, encoding="utf-8")
        return read_subject(file)
