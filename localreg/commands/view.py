"""`localreg view`: a motion in a window, in a browser, as a picture or a video."""

import contextlib
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from localreg.commands.view_arguments import PageHost, PagePort

if TYPE_CHECKING:
    from localreg.view.footage import Footage
    from localreg.view.pictures import Studio


class Look(StrEnum):
    """How bodies look."""

    CAPSULES = "capsules"
    STICKS = "sticks"
    DIAMONDS = "diamonds"


class Camera(StrEnum):
    """Where a body is seen from."""

    FOLLOW = "follow"
    FRONT = "front"
    BACK = "back"
    LEFT = "left"
    RIGHT = "right"
    TOP = "top"


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg view walk.amc

localreg view take1.mcap --web

localreg view sample --clip 16_22 --png walk.png --look diamonds

localreg view truth.bvh --beside synthesis.bvh --video both.mp4

In a window: 1 to 6 choose the camera, 7 the look, space plays and pauses, the arrows step and
change the speed; 0 shows all keys."""
)
def view(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE",
            help="A motion file (BVH, AMC with its ASF beside it), a take of localreg run "
            "(.mcap), or sample.",
        ),
    ],
    web: Annotated[
        bool,
        typer.Option("--web", help="In a browser; what happens anyway where there is no display."),
    ] = False,
    host: PageHost = "127.0.0.1",
    port: PagePort = None,
    video: Annotated[
        Path | None,
        typer.Option(metavar="OUT.mp4", help="Write a video instead.", show_default=False),
    ] = None,
    png: Annotated[
        Path | None,
        typer.Option(metavar="OUT.png", help="Write a picture instead.", show_default=False),
    ] = None,
    beside: Annotated[
        str | None,
        typer.Option(
            metavar="FILE2",
            help="Another motion beside it in pictures and videos, for example a synthesis "
            "beside the truth.",
            show_default=False,
        ),
    ] = None,
    ghost: Annotated[
        str | None,
        typer.Option(
            metavar="FILE2",
            help="Another motion in the same place, translucent green.",
            show_default=False,
        ),
    ] = None,
    clip: Annotated[
        str | None,
        typer.Option(help="Which clip, where FILE holds several.", show_default=False),
    ] = None,
    look: Annotated[Look, typer.Option(help="How bodies look.")] = Look.CAPSULES,
    camera: Annotated[
        Camera, typer.Option(help="From where; follow turns with the body.")
    ] = Camera.FOLLOW,
    size: Annotated[
        str, typer.Option(metavar="WxH", help="Of pictures and videos [pixels].")
    ] = "1280x720",
    frame: Annotated[
        int | None,
        typer.Option(
            min=0, help="The frame of the picture, from 0; default: the middle.", show_default=False
        ),
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(
            min=0.1,
            max=240.0,
            help="Pictures a second of the video; default: the motion's rate, or the half, a "
            "third of it and so on, below 40.",
            show_default=False,
        ),
    ] = None,
    trackers: Annotated[
        bool, typer.Option(help="Show the trackers, measured (thick) and predicted (thin).")
    ] = True,
    trails: Annotated[bool, typer.Option(help="Show where the trackers have been.")] = True,
    labels: Annotated[bool, typer.Option(help="Write the trackers' names on pictures.")] = False,
    loop: Annotated[bool, typer.Option("--loop", help="Begin anew at the end.")] = False,
    source_rate: Annotated[
        float | None,
        typer.Option(
            help="Frames a second of files that carry no rate (AMC) [Hz]; 120 by default.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """See a motion: in a window, in a browser, as a picture or a video.

    Of a take the measured trackers are shown beside where the body carries them, with a line
    for the error between, and in gray while nothing was measured. Of a motion file the
    trackers are shown where the body wears them. Pictures and videos need no display.
    """
    from localreg.view.scene import Style

    style = Style(
        look=look.value, measured=trackers, predicted=trackers, errors=trackers,
        trails=trails, labels=labels,
    )  # fmt: skip
    for option, path, ending in (("--video", video, ".mp4"), ("--png", png, ".png")):
        if path is not None and path.suffix.lower() != ending:
            raise typer.BadParameter(f"{path} must end in {ending}", param_hint=option)
    if beside is not None and video is None and png is None:
        raise typer.BadParameter(
            "bodies stand side by side in pictures only: add --png or --video; --ghost shows "
            "both in one place",
            param_hint="--beside",
        )
    footage = _footage(source, ghost, clip, source_rate)
    if video is not None or png is not None:
        other = None if beside is None else _footage(beside, None, None, source_rate)
        _write(footage, other, style, camera.value, _size(size), video, png, frame, fps)
    elif web:
        _serve(footage, style, camera.value, host, port, loop)
    else:
        _show(footage, style, camera.value, host, port, loop)


def _footage(
    source: str, ghost: str | None, clip: str | None, source_rate: float | None
) -> "Footage":
    from dataclasses import replace

    from localreg.commands.view_files import read_footage

    footage = read_footage(source, clip, source_rate)
    if ghost is None:
        return footage
    other = read_footage(ghost, clip if ghost == source else None, source_rate)
    return replace(footage, ghost=other.motion, ghost_name=other.title)


def _write(
    footage: "Footage",
    beside: "Footage | None",
    style: Any,
    camera: Any,
    size: tuple[int, int],
    video: Path | None,
    png: Path | None,
    frame: int | None,
    fps: float | None,
) -> None:
    from localreg.commands.console import notes
    from localreg.drawing.scene import BLUE, GREEN
    from localreg.view.pictures import Feature, Shot, Studio

    width, height = size
    shot = Shot(width, height, camera, style)
    features = [Feature(footage, BLUE if beside is None else GREEN)]
    if beside is not None:
        features.append(Feature(beside, BLUE))
    with Studio(features, shot) as studio:
        if studio.drawing.note:
            notes().print(studio.drawing.note, soft_wrap=True)
        if png is not None:
            _write_png(studio, footage, png, frame)
        if video is not None:
            _write_video(studio, footage, video, fps)


def _write_png(studio: "Studio", footage: "Footage", png: Path, frame: int | None) -> None:
    from localreg.commands.console import output
    from localreg.view.pictures import write_png

    motion = footage.motion
    index = len(motion) // 2 if frame is None else frame
    if index >= len(motion):
        raise typer.BadParameter(
            f"{footage.title} has {len(motion)} frames, the last is {len(motion) - 1}",
            param_hint="--frame",
        )
    write_png(studio.picture(index / motion.rate), png)
    output().print(f"{png}: frame {index} of {footage.title}", soft_wrap=True)


def _write_video(studio: "Studio", footage: "Footage", video: Path, fps: float | None) -> None:
    from localreg.commands.console import output, progress_bar
    from localreg.view.pictures import video_rate, write_video

    rate = video_rate(footage) if fps is None else fps
    with progress_bar("drawing") as bar:
        count = write_video(studio, video, rate, bar)
    output().print(
        f"{video}: {count} pictures at {rate:g} Hz, {studio.seconds:.1f} s of {footage.title}, "
        f"drawn by {studio.drawing.backend}",
        soft_wrap=True,
    )


def _show(
    footage: "Footage", style: Any, camera: Any, host: str, port: int | None, loop: bool
) -> None:
    from localreg.live.view_options import usual_kind
    from localreg.view.controls import Controls
    from localreg.view.file_source import FileSource
    from localreg.view.native import show_native

    if usual_kind() == "web":
        _serve(footage, style, camera, host, port, loop)
        return
    source = FileSource(footage, is_looping=loop)
    # Ctrl-C in the terminal is a way to close a window, too.
    with contextlib.suppress(KeyboardInterrupt):
        show_native(source, controls=Controls(preset=camera, style=style))


def _serve(
    footage: "Footage", style: Any, camera: Any, host: str, port: int | None, loop: bool
) -> None:
    from localreg.commands.console import notes, output
    from localreg.view.file_source import FileSource
    from localreg.view.web_host import WebHost

    page = WebHost(FileSource(footage, is_looping=loop), host, port)
    page.desk.style, page.desk.camera = style, camera

    def ready() -> None:
        if page.guard.is_open:
            notes().print(
                "warning: everyone who can reach this machine can watch and press buttons; "
                "leave out --host to keep it to yourself",
                soft_wrap=True,
            )
        output().print(f"look at {footage.title} on {page.url} (Ctrl-C ends it)", soft_wrap=True)

    try:
        page.run(ready)
    except KeyboardInterrupt:
        page.close()


def _size(text: str) -> tuple[int, int]:
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdigit() and height.isdigit()):
        raise typer.BadParameter(f"{text} is no size; write it as 1280x720", param_hint="--size")
    return int(width), int(height)
