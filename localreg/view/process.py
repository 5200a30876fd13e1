"""A view of a live run in a process of its own, so that the loop never waits for it."""

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Final, Literal, Self

from localreg.body.subject import Subject, write_subject
from localreg.errors import LocalregError
from localreg.view.feed import ABOUT_SIZE, About, Glimpse, glimpse_size, pack
from localreg.view.slot import Slot
from localreg.view.source import COMMANDS, Command

Kind = Literal["web", "native"]
"""A page for browsers, or a window."""

_BEGIN: Final = 60.0  # how long it may take to begin, on a busy machine [s]
_END: Final = 10.0
# A development setting of the viewer that would serve other files.
_UNWANTED: Final = ("MUJOCO_WEB_VIEWER_DIST", "MUJOCO_STUDIO_ASSETS_DIR")


class ViewProcess:
    """Started at once; `wait` says where it is to be seen.

    Args:
        subject: whose body is shown, wearing the trackers of the frames.
        kind: page or window.
        host: where a page is served.
        port: None for the first free one from 8080 on, 0 for any.
        takes: folder of files that somebody asks for on the page.
        commands: what buttons may ask for.
        on_command: called with what a button asked for, in a thread of its own.
        on_end: called with its exit code if the view ends before it is closed: 0 if somebody
            closed a window, else it died.
    """

    def __init__(
        self,
        subject: Subject,
        kind: Kind = "web",
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        takes: Path = Path("takes"),
        commands: Collection[Command] = (),
        on_command: Callable[[Command], None] = lambda name: None,
        on_end: Callable[[int], None] = lambda code: None,
    ) -> None:
        self._on_command, self._on_end = on_command, on_end
        self._commands = frozenset(commands)
        self._answer: dict[str, Any] = {}
        self._answered = threading.Event()
        self._is_closing = False
        with contextlib.ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="localreg-view-")))
            write_subject(subject, folder / "subject.toml")
            setup = {
                "kind": kind,
                "host": host,
                "port": port,
                "subject": str(folder / "subject.toml"),
                "trackers": list(subject.trackers),
                "folder": str(takes),
                "commands": [name for name in COMMANDS if name in self._commands],
            }
            self._frames, frames_fd = Slot.create(glimpse_size(len(subject.trackers)))
            stack.callback(self._frames.close)
            stack.callback(os.close, frames_fd)
            self._about, about_fd = Slot.create(ABOUT_SIZE)
            stack.callback(self._about.close)
            stack.callback(os.close, about_fd)
            ours, theirs = socket.socketpair()
            stack.callback(ours.close)
            fds = (frames_fd, about_fd, theirs.fileno())
            with theirs:
                environment = {k: v for k, v in os.environ.items() if k not in _UNWANTED}
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "localreg.view.child", *map(str, fds)],
                    pass_fds=fds,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                )
            self._line = ours
            ours.sendall(json.dumps(setup).encode() + b"\n")
            self._thread = threading.Thread(target=self._listen, name="view", daemon=True)
            self._thread.start()
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def wait(self) -> tuple[str, bool]:
        """Until it can be seen.

        Returns:
            Where, and whether other machines can see it, too.

        Raises:
            LocalregError: it cannot be shown, in one sentence.
        """
        if not self._answered.wait(_BEGIN):
            raise LocalregError(
                f"the view did not begin within {_BEGIN:g} s; go on without it: --view none"
            )
        if "ready" in self._answer:
            return self._answer["ready"], self._answer["open"]
        raise LocalregError(
            self._answer.get("failed", "the view ended at once; go on without it: --view none")
        )

    def show(self, glimpse: Glimpse) -> None:
        """Put a frame in place of the one before; at once."""
        self._frames.write(pack(glimpse))

    def tell(self, about: About) -> None:
        """Put what changes slowly in place of what was said before; at once."""
        self._about.write(about.to_bytes())

    def join(self, timeout: float) -> None:
        """Wait until the view has ended by itself, at most so long [s]."""
        self._thread.join(timeout)

    def close(self) -> None:
        """End the view. Doing so twice is no error."""
        self._is_closing = True
        with contextlib.suppress(OSError):
            self._line.shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(_END)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._thread.join(_END)
        self._stack.close()

    def _listen(self) -> None:
        """Hear answers and buttons until the process ends."""
        with contextlib.suppress(OSError), self._line.makefile("r", encoding="utf-8") as lines:
            for line in lines:
                message = json.loads(line)
                if "do" in message:
                    if message["do"] in self._commands:
                        self._on_command(message["do"])
                elif not self._answered.is_set():
                    self._answer = message
                    self._answered.set()
        was_seen = "ready" in self._answer
        self._answered.set()
        if was_seen and not self._is_closing:
            self._on_end(self._process.wait())
