"""Playing a file in a window or on a page."""

import time
from collections.abc import Callable

from localreg.view.footage import Footage, Reel
from localreg.view.moment import Moment
from localreg.view.source import Source
from localreg.view.transport import Deck, Playhead


class FileSource(Source):
    """Plays footage in real time, or as its transport says.

    Args:
        footage: what is played.
        is_looping: whether it begins anew at its end.
        now: the clock by which it is played [s].
    """

    def __init__(
        self,
        footage: Footage,
        *,
        is_looping: bool = False,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        motion = footage.motion
        self.subject = motion.subject
        self.ghost = None if footage.ghost is None else footage.ghost.subject
        self._deck = Deck(Playhead(len(motion), motion.rate, is_looping=is_looping))
        self.transport = self._deck
        self._reel = Reel(footage)
        self._now = now
        self._shown: Moment | None = None

    def newest(self) -> Moment:
        """The moment where the transport stands now."""
        index = self._deck.tick(self._now())
        if self._shown is None or self._shown.index != index:
            self._shown = self._reel.moment(index)
        return self._shown
