"""What is to be seen until the first pose is live: the recorded clips, and how long it takes."""

import threading
import time
from collections.abc import Callable
from typing import Self

from localreg.errors import LocalregError
from localreg.live.demo.playlist import Playlist
from localreg.live.demo.view import DemoView

_SAY_EVERY = 0.5  # [s]


class Preview:
    """Plays the clips as they were recorded, in a thread, and says what is being waited for.

    A context manager; it ends with the block, for the loop must have the view for itself.

    Args:
        playlist: the clips.
        view: where they are shown, as soon as it is there; None for nowhere.
        progress: what is being waited for, in a few words.
        say: is told these words every half second.
    """

    def __init__(
        self,
        playlist: Playlist,
        view: DemoView | None,
        progress: Callable[[], str],
        say: Callable[[str], None],
    ) -> None:
        self._playlist, self._view = playlist, view
        self._progress, self._say = progress, say
        self._is_over = threading.Event()
        self._failure: LocalregError | None = None
        self._threads = [threading.Thread(target=self._talk, name="progress", daemon=True)]
        if view is not None:
            self._threads.append(
                threading.Thread(target=self._play, args=(view,), name="preview", daemon=True)
            )

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._is_over.set()
        if kind is not None:
            return  # the view is not waited for; it will be closed
        for thread in self._threads:
            thread.join()
        if self._view is not None:
            self._view.announce("the trackers begin to report")
        if self._failure is not None:
            raise self._failure

    def _talk(self) -> None:
        while not self._is_over.wait(_SAY_EVERY):
            words = self._progress()
            self._say(words)
            if self._view is not None:
                self._view.announce(f"{words}\nuntil then you see the walk as it was recorded")

    def _play(self, view: DemoView) -> None:
        try:
            view.wait()
        except LocalregError as error:
            self._failure = error
            return
        playlist, begun = self._playlist, time.monotonic()
        while not self._is_over.wait(1.0 / playlist.rate):
            now = time.monotonic()
            row = round((now - begun) * playlist.rate) % playlist.rows
            view.show(row, now, playlist.pose(row))
