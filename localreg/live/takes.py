"""What the view's buttons write: motion files, marks, and the whole run so far.

Buttons are pressed while the loop runs, so whatever takes time is done elsewhere: growing
files by a thread of their own, the whole run by a process of low priority.
"""

import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np

from localreg.body.subject import Subject, write_subject
from localreg.errors import LocalregError
from localreg.live.outputs import open_motion_file
from localreg.live.sinks.base import LivePose, Sink
from localreg.live.sinks.collector import Collector
from sensors.recording import Recorder
from sensors.recording.schemas import object_schema

MARKS = "/marks"
"""Channel of a recording that says when somebody pressed the button."""

_LONGEST_WAIT = 300.0


class Takes(Sink):
    """Records, marks and exports when asked to; any thread may ask.

    Args:
        folder: where files go; made when it is needed.
        subject: whose body it is.
        rate: frames a second [Hz].
        tell: told where files are.
        recorder: the run's recording, which marks go into, too.
        capacity: frames kept for an export.
    """

    name = "takes"

    def __init__(
        self,
        folder: Path,
        subject: Subject,
        rate: float,
        tell: Callable[[str], None],
        *,
        recorder: Recorder | None = None,
        capacity: int = 144_000,
    ) -> None:
        self._folder, self._subject, self._rate, self._tell = folder, subject, rate, tell
        self._collector = Collector(capacity)
        self._recording: Sink | None = None
        self._latest: LivePose | None = None
        self._first: float | None = None
        self._note = ""
        self._exports: list[threading.Thread] = []
        number, integer = {"type": "number"}, {"type": "integer"}
        self._marks = None
        if recorder is not None:
            schema = object_schema(
                "localreg.Mark", "Somebody marked a frame.", index=integer, time=number
            )
            self._marks = recorder.channel(MARKS, "localreg.Mark", schema)

    @property
    def note(self) -> str:
        """What the last button brought about; names files, not folders."""
        return self._note

    @property
    def is_recording(self) -> bool:
        """Whether a motion file is growing."""
        return self._recording is not None

    def publish(self, live: LivePose) -> None:
        """Keep one pose, and write it where a file is growing."""
        self._latest = live
        if self._first is None:
            self._first = live.frame.time
        self._collector.publish(live)
        recording = self._recording
        if recording is not None:
            recording.publish(live)

    def record(self) -> None:
        """Begin a motion file, or end the one that is growing."""
        if (recording := self._recording) is not None:
            self._recording = None
            recording.close()
            self._say(Path(recording.name), "recorded")
            return
        file = self._new("take", ".bvh")
        self._recording = open_motion_file(file, self._subject, self._rate)
        self._note = f"recording {file.name}"

    def mark(self) -> None:
        """Write down the newest frame."""
        live = self._latest
        if live is None or self._first is None:
            self._note = "there is no frame to mark yet"
            return
        if self._marks is not None:
            self._marks.write({"index": live.instant, "time": live.frame.time}, live.frame.time)
        self._make_folder()
        file = self._folder / "marks.csv"
        is_new = not file.exists()
        with file.open("a", encoding="utf-8") as lines:
            if is_new:
                lines.write("frame,seconds\n")
            lines.write(f"{live.instant},{live.frame.time - self._first:.3f}\n")
        self._note = f"marked frame {live.instant} in {file.name}"

    def export(self) -> None:
        """Write all frames so far to a motion file, in a process of its own."""
        if not len(self._collector):
            self._note = "there is no frame to export yet"
            return
        file = self._new("run", ".bvh")
        qpos = self._collector.qpos[self._collector.rows_on_grid()]
        self._note = f"exporting {file.name}"
        thread = threading.Thread(target=self._export, args=(qpos, file), name="export")
        self._exports.append(thread)
        thread.start()

    def close(self) -> None:
        """Finish what is growing. Doing so twice is no error."""
        if self._recording is not None:
            self.record()
        for thread in self._exports:
            thread.join(_LONGEST_WAIT)

    def _export(self, qpos: np.ndarray, file: Path) -> None:
        with tempfile.TemporaryDirectory() as scratch:
            np.save(Path(scratch) / "qpos.npy", qpos)
            write_subject(self._subject, Path(scratch) / "subject.toml")
            done = subprocess.run(
                [sys.executable, "-m", "localreg.live.export", scratch, str(file), str(self._rate)],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
        if done.returncode:
            self._note = "the export failed; see the terminal"
            self._tell(f"cannot export {file}: {done.stderr.strip().splitlines()[-1]}")
        else:
            self._say(file, "exported")

    def _say(self, file: Path, what: str) -> None:
        self._note = f"{what} {file.name}"
        self._tell(f"{what}: {file}")

    def _new(self, stem: str, suffix: str) -> Path:
        self._make_folder()
        stamp = datetime.now().strftime("%Y%m%d-%H%M%S")
        file = self._folder / f"{stem}-{stamp}{suffix}"
        number = 1
        while file.exists():
            number += 1
            file = self._folder / f"{stem}-{stamp}-{number}{suffix}"
        return file

    def _make_folder(self) -> None:
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise LocalregError(f"cannot make the folder {self._folder}: {reason}") from None
