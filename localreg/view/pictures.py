"""Pictures and videos of footage without a display, one body or several side by side.

Graphics are chosen by trying (`localreg.drawing.offscreen`); without any the bodies are
drawn as plain sticks, and `Drawing.note` names the packages to install.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, Final, Self, cast

import av
import numpy as np
from av.error import FFmpegError
from jaxtyping import Float, UInt8
from numpy import ndarray
from PIL import Image

from localreg.drawing.ground import standing_height
from localreg.drawing.looks import show_look
from localreg.drawing.offscreen import Camera, Drawing, open_canvas
from localreg.drawing.scene import BLUE, Color
from localreg.errors import LocalregError
from localreg.motion.formats.atomic import written_at_once
from localreg.view.cameras import Preset, followed, look_from
from localreg.view.footage import Footage, Reel
from localreg.view.labels import write_names
from localreg.view.moment import TRAIL_SECONDS, Moment
from localreg.view.scene import Style, build_stage, draw, marks

MOST_VIDEO_RATE: Final = 40.0
"""Pictures a second of videos at most, unless asked for more [Hz]."""

Progress = Callable[[int, int, str], None]
"""Told how many pictures are done, of how many, and what is being done."""

_GAP: Final = 4  # of white between pictures side by side [pixels]
_LEAST_SIZE: Final = 64


@dataclass(frozen=True)
class Shot:
    """How pictures are taken.

    Attributes:
        width: of the whole picture, all bodies side by side [pixels].
        height: of the picture [pixels].
        camera: from where.
        style: what is seen.
        words: whether title and time are written on it.
    """

    width: int = 1280
    height: int = 720
    camera: Preset = "follow"
    style: Style = field(default_factory=Style)
    words: bool = True

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            # Videos store color for every second pixel only.
            if getattr(self, name) < _LEAST_SIZE or getattr(self, name) % 2:
                raise LocalregError(
                    f"a picture cannot be {self.width} x {self.height} pixels large; give even "
                    f"numbers from {_LEAST_SIZE} on"
                )


@dataclass(frozen=True, eq=False)
class Feature:
    """One of the bodies of a picture.

    Attributes:
        footage: what is seen.
        color: of the body.
        caption: written above it; by default the footage's title.
    """

    footage: Footage
    color: Color = BLUE
    caption: str | None = None


class Studio:
    """Takes pictures of footage. Use it in a `with`.

    Several features are shown side by side at the same time from the same direction; the
    one that ends first stays as it is.

    Args:
        features: the bodies; at least one.
        shot: how they are seen.
    """

    def __init__(self, features: Sequence[Feature], shot: Shot | None = None) -> None:
        if not features:
            raise LocalregError("there is nobody to take a picture of")
        self.shot = shot or Shot()
        self._height = max(standing_height(f.footage.motion.subject) for f in features)
        self._views: list[_View] = []
        self._stack = ExitStack()
        gaps = _GAP * (len(features) - 1)
        width = (self.shot.width - gaps) // len(features)
        with ExitStack() as stack:
            for feature in features:
                view = _View(feature, width, self.shot)
                stack.callback(view.close)
                self._views.append(view)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def drawing(self) -> Drawing:
        """Which graphics draw, and advice if better ones could be had."""
        return self._views[0].drawing

    @property
    def seconds(self) -> float:
        """Duration of the longest motion [s]."""
        return max(view.seconds for view in self._views)

    def picture(self, time: float) -> UInt8[ndarray, "height width 3"]:
        """What is to be seen at a time [s].

        The camera goes after the body from picture to picture; when time runs backwards or
        jumps it is put in place anew.
        """
        camera = self._views[0].aim(time, self._height)
        pictures = [view.picture(time, camera) for view in self._views]
        whole = np.full((self.shot.height, self.shot.width, 3), 255, dtype=np.uint8)
        left = 0
        for picture in pictures:
            whole[:, left : left + picture.shape[1]] = picture
            left += picture.shape[1] + _GAP
        return whole


def video_rate(footage: Footage, most: float = MOST_VIDEO_RATE) -> float:
    """Pictures a second of a video that shows every frame, or every n-th, evenly [Hz]."""
    rate = footage.motion.rate
    return rate / math.ceil(rate / most - 1e-6)


def video_times(seconds: float, rate: float) -> Float[ndarray, " pictures"]:
    """Times of the pictures of a video, from the first frame to the last [s]."""
    return np.arange(math.floor(seconds * rate + 1e-6) + 1) / rate


def write_png(picture: UInt8[ndarray, "height width 3"], path: Path) -> None:
    """Write a picture.

    Raises:
        LocalregError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(picture).save(path, format="png", optimize=True)
    except OSError as error:
        raise LocalregError(f"cannot write {path}: {error.strerror or error}") from error


def write_video(studio: Studio, path: Path, rate: float, progress: Progress | None = None) -> int:
    """Write everything that a studio's footage shows as H.264 in MP4.

    Args:
        studio: takes the pictures.
        path: the file; appears when it is complete.
        rate: pictures a second [Hz].
        progress: is told how far it is.

    Returns:
        How many pictures there are.

    Raises:
        LocalregError: it cannot be written.
    """
    times = video_times(studio.seconds, rate)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_at_once(path) as part, _encoder(part, studio.shot, rate) as encode:
            for done, time in enumerate(times):
                if progress is not None:
                    progress(done, len(times), "")
                encode(studio.picture(float(time)))
    except (OSError, FFmpegError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise LocalregError(f"cannot write {path}: {reason}; choose another place") from error
    return len(times)


@contextmanager
def _encoder(path: Path, shot: Shot, rate: float) -> Iterator[Callable[[ndarray], None]]:
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as container:
        exact = Fraction(rate).limit_denominator(1000)
        stream = cast(Any, container.add_stream("libx264", rate=exact))
        stream.width, stream.height = shot.width, shot.height
        # What every player and browser understands; the quality of a good still.
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "20", "preset": "veryfast"}

        def encode(picture: ndarray) -> None:
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            container.mux(stream.encode(frame))

        yield encode
        container.mux(stream.encode(None))


class _View:
    """One body of the picture on a canvas of its own."""

    def __init__(self, feature: Feature, width: int, shot: Shot) -> None:
        footage = feature.footage
        self._shot, self._feature = shot, feature
        self._reel = Reel(footage, TRAIL_SECONDS if shot.style.trails else 0.0)
        ghost = None if footage.ghost is None else footage.ghost.subject
        self._stage = build_stage(footage.motion.subject, ghost, color=feature.color)
        self._canvas = open_canvas(self._stage.scene, width, shot.height)
        show_look(self._canvas.option, shot.style.look)
        self._camera: Camera | None = None
        self._time = 0.0

    @property
    def drawing(self) -> Drawing:
        return self._canvas.drawing

    @property
    def seconds(self) -> float:
        return self._feature.footage.motion.seconds

    def close(self) -> None:
        self._canvas.close()

    def aim(self, time: float, height: float) -> Camera:
        """The camera at a time, for every view of the picture, with bodies so high [m]."""
        shot, qpos = self._shot, self._qpos(time)
        elapsed = time - self._time
        if self._camera is None or not 0.0 <= elapsed <= 0.5:
            aspect = self._canvas.width / self._canvas.height
            self._camera = look_from(shot.camera, qpos, aspect=aspect, height=height)
        else:
            turning = shot.camera == "follow"
            self._camera = followed(self._camera, qpos, elapsed, turning=turning, height=height)
        self._time = time
        return self._camera

    def picture(self, time: float, camera: Camera) -> UInt8[ndarray, "height width 3"]:
        style = self._shot.style
        moment = self._reel.moment(self._index(time))
        self._stage.place(self._canvas.data, moment, style)
        # Names are written afterwards, where none covers another.
        found = marks(moment, replace(style, labels=False))
        picture = self._canvas.picture(camera, lambda scene: draw(scene, found))
        anchors = self._anchors(moment, camera) if style.labels else {}
        if not self._shot.words:
            return write_names(picture, anchors) if anchors else picture
        caption = self._feature.caption
        title = self._feature.footage.title if caption is None else caption
        return write_names(picture, anchors, title=title, subtitle=_clock(moment))

    def _anchors(self, moment: Moment, camera: Camera) -> dict[str, tuple[float, float]]:
        names = [tracker.name for tracker in moment.trackers]
        places = [
            tracker.position if tracker.has_position else tracker.predicted_position
            for tracker in moment.trackers
        ]
        if not names:
            return {}
        pixels, depth = camera.project(np.array(places), self._canvas.width, self._canvas.height)
        return {
            name: (float(x), float(y))
            for name, (x, y), far in zip(names, pixels, depth, strict=True)
            if far > 0.0
        }

    def _index(self, time: float) -> int:
        motion = self._feature.footage.motion
        return min(math.floor(time * motion.rate + 1e-6), len(motion) - 1)

    def _qpos(self, time: float) -> Float[ndarray, "63"]:
        return self._feature.footage.motion.qpos[self._index(time)]


def _clock(moment: Moment) -> str:
    words = f"{moment.time:.2f} s"
    if np.isfinite(moment.confidence):
        words += f"   confidence {100 * moment.confidence:.0f} %"
    return words + ("   held" if moment.is_held else "")
