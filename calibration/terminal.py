"""The wizard in a terminal: what to do, a stick figure, a bar that fills while one holds."""

import contextlib
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from typing import Final

from rich.console import Console, Group
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from calibration import motion_step
from calibration.poses import TargetPose
from calibration.sticks import Sticks
from calibration.wizard_state import Event, Snapshot, State
from sensors.pose import TrackerFrame

_REFRESH: Final = 0.1
_WIDTH: Final = 76
_KEYS: Final = "space pause/go   b back   s skip   q leave"
_TITLES: Final = {
    State.READY: "press Enter or space, then go to your place",
    State.MOVING: "take the pose",
    State.HOLDING: "hold still",
    State.WALKING: "move about",
    State.DONE: "done",
}


class Keyboard:
    """Single keys from a terminal, without waiting; nothing where there is no terminal."""

    def __init__(self) -> None:
        self._terminal = sys.stdin.fileno() if sys.stdin.isatty() else None

    @property
    def is_there(self) -> bool:
        """Whether anybody can press a key."""
        return self._terminal is not None

    @contextlib.contextmanager
    def listening(self) -> Iterator[None]:
        """Keys come at once and unseen, until the end."""
        if self._terminal is None:
            yield
            return
        before = termios.tcgetattr(self._terminal)
        try:
            tty.setcbreak(self._terminal)
            yield
        finally:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, before)

    def key(self) -> str:
        """The newest key; empty if there is none."""
        if self._terminal is None:
            return ""
        pressed = b""
        while select.select([self._terminal], [], [], 0.0)[0]:
            more = os.read(self._terminal, 64)
            if not more:
                break
            pressed = more
        return pressed[-1:].decode("ascii", "ignore")


class TerminalView:
    """Draws the wizard; a context manager.

    On a terminal a panel that is drawn anew, elsewhere a line for everything that happens.

    Args:
        console: where to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._keyboard = Keyboard()
        self._live: Live | None = None
        self._stack = contextlib.ExitStack()
        self._drawn = 0.0
        self._sticks = Sticks()
        self._asked: str | None = None  # the pose of the snapshot before; empty for a walk

    @property
    def has_keys(self) -> bool:
        """Whether somebody can press a key to begin."""
        return self._keyboard.is_there

    def __enter__(self) -> "TerminalView":
        self._stack.enter_context(self._keyboard.listening())
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._stack.enter_context(self._live)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        self._live = None

    def key(self) -> str:
        """The newest key."""
        return self._keyboard.key()

    def show(self, snapshot: Snapshot, event: Event, frame: TrackerFrame | None) -> None:
        """Draw how things are; events also leave a line behind."""
        if event in (Event.RECORDED, Event.FINISHED):
            what = f"{len(snapshot.recorded)}: {self._asked}" if self._asked else motion_step.NAME
            self._say(f"recorded {what}")
            self._console.bell()
        elif event in (Event.REFUSED, Event.TIMED_OUT, Event.BLIND):
            self._say(snapshot.message)
            self._console.bell()
        if self._live is None:
            self._announce(snapshot, event)
        else:
            self._draw(self._live, snapshot, event)
        self._asked = "" if snapshot.pose is None else snapshot.pose.name

    def _draw(self, live: Live, snapshot: Snapshot, event: Event) -> None:
        now = time.monotonic()
        if now - self._drawn >= _REFRESH or event is not Event.NOTHING:
            self._drawn = now
            live.update(self._panel(snapshot), refresh=True)

    def _say(self, words: str) -> None:
        self._console.print(words, highlight=False, markup=False, soft_wrap=True)

    def _announce(self, snapshot: Snapshot, event: Event) -> None:
        """Without a terminal: every pose once, in words, and how far the walk is."""
        pose = snapshot.pose
        if snapshot.state is State.WALKING and self._asked != "":
            self._say(f"{motion_step.WORDS} {_left(snapshot)}")
        elif event is Event.COLLECTED:
            self._say(_left(snapshot))
        if pose is None or pose.name == self._asked:
            return
        words = " ".join(pose.words)
        self._say(f"pose {snapshot.number} of {snapshot.total}, {pose.name}: {words}")

    def _panel(self, snapshot: Snapshot) -> Panel:
        pose = snapshot.pose
        if pose is None and snapshot.state is not State.DONE:
            title = f"after {len(snapshot.recorded)} poses: {motion_step.NAME}"
            return Panel(_walk(snapshot), title=title, subtitle=_KEYS, width=_WIDTH)
        if pose is None:
            return Panel(Text(snapshot.message), width=_WIDTH)
        body = Table.grid(padding=(0, 2))
        body.add_column(width=28)
        body.add_column(width=_WIDTH - 36)
        body.add_row(Text(self._sticks.draw(pose), style="cyan"), _words(snapshot, pose))
        title = f"pose {snapshot.number} of {snapshot.total}: {pose.name}"
        return Panel(body, title=title, subtitle=_KEYS, width=_WIDTH)


def _words(snapshot: Snapshot, pose: TargetPose) -> Group:
    lines = [Text(f"{place:5s} {words}") for place, words in
             zip(("legs", "arms", "head"), pose.words, strict=True)]  # fmt: skip
    spaced: list[Text] = []
    for line in lines:
        spaced += [line, Text("")]
    return Group(*spaced, *_status(snapshot))


def _walk(snapshot: Snapshot) -> Group:
    return Group(Text(motion_step.WORDS), Text(""), *_status(snapshot), Text(_left(snapshot)))


def _left(snapshot: Snapshot) -> str:
    return motion_step.told(snapshot.left, snapshot.stiff)


def _status(snapshot: Snapshot) -> list[Text]:
    """What goes on, how far it is, and who is not seen."""
    is_recording = snapshot.state in (State.HOLDING, State.WALKING)
    return [
        Text(_TITLES[snapshot.state], style="bold green" if is_recording else "bold yellow"),
        _bar(snapshot.held),
        Text(snapshot.message, style="bold" if snapshot.message else ""),
        Text("trackers: all seen" if not snapshot.unseen
             else "not seen: " + ", ".join(snapshot.unseen),
             style="dim" if not snapshot.unseen else "bold red"),
    ]  # fmt: skip


def _bar(share: float) -> Text:
    width = _WIDTH - 40
    full = round(share * width)
    return Text.assemble(("━" * full, "green"), ("━" * (width - full), "dim"))
