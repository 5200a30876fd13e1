"""Where commands print: results to standard output, progress to standard error."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

PATIENCE: Final = 2.0
"""What takes no longer than this is not worth a progress bar [s]."""

_PIPED_WIDTH: Final = 160
_LINE_EVERY: Final = 10.0


def output() -> Console:
    """The console of results; wide where nobody's terminal bounds it."""
    return _console(stderr=False)


def notes() -> Console:
    """The console of everything that is no result: warnings and progress."""
    return _console(stderr=True)


def _console(*, stderr: bool) -> Console:
    # Without markup, which would take units such as [m] for styles.
    console = Console(stderr=stderr, highlight=False, markup=False)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = _PIPED_WIDTH
    return console


class ProgressBar:
    """Told how far something is; shows it once that has taken longer than `PATIENCE`.

    On a terminal it is a bar that goes away, elsewhere a line now and then.
    """

    def __init__(self, title: str) -> None:
        self._title = title
        self._console = notes()
        self._begin = self._said = time.monotonic()
        self._bar: Progress | None = None
        self._task: Any = None

    def __call__(self, done: int, total: int, what: str) -> None:
        """Show that so many steps are done of all, and what is being done."""
        now = time.monotonic()
        if now - self._begin < PATIENCE:
            return
        if not self._console.is_terminal:
            if now - self._said >= _LINE_EVERY:
                self._said = now
                share = 100 * done // max(total, 1)
                self._console.print(f"{self._title}: {share} % {what}")
            return
        if self._bar is None:
            self._bar = Progress(
                TextColumn(self._title),
                BarColumn(),
                TextColumn("{task.percentage:.0f} %"),
                TimeRemainingColumn(),
                TextColumn("{task.fields[what]}", markup=False),
                console=self._console,
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=total, what=what)
        self._bar.update(self._task, completed=done, total=total, what=what)

    def close(self) -> None:
        """Remove the bar."""
        if self._bar is not None:
            self._bar.stop()


@contextmanager
def progress_bar(title: str) -> Iterator[ProgressBar]:
    """A progress bar that is removed at the end, however that comes."""
    bar = ProgressBar(title)
    try:
        yield bar
    finally:
        bar.close()
