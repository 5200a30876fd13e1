"""The demo in a view: the body, and the truth as a ghost."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.database.store import PoseDatabase
from localreg.live.demo.playlist import Playlist
from localreg.live.session import Session
from localreg.live.sinks.base import LivePose
from localreg.live.view_options import ViewOptions
from localreg.live.viewing import LiveView
from sensors.devices.base import Device
from sensors.stream import FrameStream


class DemoView(LiveView):
    """A live view that knows what is played.

    Args:
        options: page or window, and where.
        playlist: what is played.
        tell: says one sentence to whoever started the demo.
    """

    def __init__(
        self, options: ViewOptions, playlist: Playlist, tell: Callable[[str], None]
    ) -> None:
        self._playlist = playlist
        self._zero: float | None = None
        self._allowed: dict[int, Bool[ndarray, " poses"]] = {}
        super().__init__(
            options, playlist.subject, playlist.rate, tell,
            ghost_at=self._truth, ghost_name="truth",
            capacity=playlist.rows + round(playlist.rate),
        )  # fmt: skip

    def begin(
        self,
        session: Session,
        stream: FrameStream,
        device: Device,
        database: PoseDatabase,
        zero: float,
    ) -> None:
        """Say what is to be told of, once the motion begins.

        Args:
            session: the loop.
            stream: where its frames come from.
            device: the driver.
            database: the poses that are learned from, all of them.
            zero: host's monotonic time of the list's first row [s].
        """
        self._zero = zero
        playlist = self._playlist

        def clip_at(time: float) -> int:
            return playlist.clip_at(time - zero)

        def allowed_at(time: float) -> Bool[ndarray, " poses"]:
            clip = clip_at(time)
            if clip not in self._allowed:
                name = playlist.clips[clip].provenance.name
                self._allowed[clip] = database.exclude(clip=name)
            return self._allowed[clip]

        def title_at(time: float) -> str:
            return playlist.clips[clip_at(time)].provenance.name

        self.watch(session, stream, (device,), database, title_at=title_at, allowed_at=allowed_at)

    def _truth(self, live: LivePose) -> Float[ndarray, "63"] | None:
        if self._zero is None:
            return None
        at = live.frame.time - self._zero
        return self._playlist.truth(self._playlist.clip_at(at), np.array([at]))[0]
