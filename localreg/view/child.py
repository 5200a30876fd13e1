"""The process that shows a live run: `python -m localreg.view.child FD FD FD`.

It is started by `localreg.view.process` and ends with it. It hears nothing from the loop but
the newest frame, and gives way to it: its priority is lower.
"""

import json
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TextIO

from localreg.body.subject import read_subject
from localreg.errors import LocalregError
from localreg.view.feed import About, moment_of, unpack
from localreg.view.moment import Moment, Observer
from localreg.view.slot import Slot
from localreg.view.source import COMMANDS, Command, Source

_NICE: Final = 10


class LiveSource(Source):
    """What comes through the slots.

    Args:
        setup: what the run said of itself at the beginning.
        frames: slot of the frames.
        about: slot of what changes slowly.
        say: where commands go, line by line.
    """

    def __init__(self, setup: dict[str, Any], frames: Slot, about: Slot, say: TextIO) -> None:
        subject = read_subject(Path(setup["subject"]))
        self.subject = subject.with_trackers(tuple(setup["trackers"]))
        self.ghost = self.subject  # for whatever there is to be compared with
        self.commands = tuple(name for name in COMMANDS if name in setup["commands"])
        self.folder = Path(setup["folder"])
        self._frames, self._about_slot, self._say = frames, about, say
        self._about = About()
        self._observer = Observer(self.subject)
        self._newest: Moment | None = None

    def newest(self) -> Moment | None:
        """The moment of the newest frame."""
        if (data := self._about_slot.read()) is not None:
            self._about = About.of_bytes(data)
        if (data := self._frames.read()) is not None:
            glimpse = unpack(data, len(self.subject.trackers))
            self._newest = moment_of(glimpse, self._about, self._observer)
        return self._newest

    def command(self, name: Command) -> None:
        """Send a command to the run."""
        tell(self._say, {"do": name})

    @property
    def note(self) -> str:
        """What the last command brought about."""
        return self._about.note

    @property
    def notice(self) -> str:
        """What the run wants to be read first."""
        return self._about.notice

    @property
    def is_recording(self) -> bool:
        """Whether a take is being recorded."""
        return self._about.is_recording


def tell(to: TextIO, message: dict[str, Any]) -> None:
    """Write a line to the run; it may have gone."""
    try:
        to.write(json.dumps(message) + "\n")
        to.flush()
    except OSError:
        pass


def main(arguments: list[str]) -> int:
    """Show until the run ends."""
    # Ctrl-C in a terminal reaches this process, too; the run decides when it ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICE)
    if hasattr(os, "SCHED_BATCH"):  # when it wakes, nobody has to make room at once
        os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    frames_fd, about_fd, line_fd = map(int, arguments)
    frames, about = Slot(frames_fd), Slot(about_fd)
    with socket.socket(fileno=line_fd) as line:
        hear = line.makefile("r", encoding="utf-8")
        say = line.makefile("w", encoding="utf-8")
        first = hear.readline()
        if not first:
            return 0
        setup = json.loads(first)
        try:
            _show(setup, LiveSource(setup, frames, about, say), hear, say)
        except LocalregError as error:
            tell(say, {"failed": str(error)})
            return 1
    return 0


def _show(setup: dict[str, Any], source: LiveSource, hear: TextIO, say: TextIO) -> None:
    over = threading.Event()

    def ready() -> None:
        tell(say, {"ready": "a window", "open": False})

    if setup["kind"] == "web":
        from localreg.view.web_host import WebHost

        page = WebHost(source, setup["host"], setup["port"])
        _when_over(hear, page.close)
        page.run(lambda: tell(say, {"ready": page.url, "open": page.guard.is_open}))
    else:
        from localreg.view.native import show_native

        _when_over(hear, over.set)
        show_native(source, ready, over.is_set)


def _when_over(hear: TextIO, close: Callable[[], None]) -> None:
    def wait() -> None:
        while hear.readline():
            pass
        close()

    threading.Thread(target=wait, name="run-over", daemon=True).start()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
