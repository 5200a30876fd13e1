"""`localreg demo`: real walks through a real serial line, synthesized live."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from localreg.commands.view_arguments import PageHost, PagePort, View

if TYPE_CHECKING:
    from localreg.live.compiling import Compiling
    from localreg.live.demo.run import DemoConfig
    from localreg.live.view_options import ViewOptions

_EPILOG = """Examples: `localreg demo`, `localreg demo --seconds 20 --json demo.json`,
`localreg demo --seconds 20 --faults`."""


def demo(
    seconds: Annotated[
        float | None,
        typer.Option(
            help="Play so long [s], over and over if need be; default: every walk once.",
            show_default=False,
        ),
    ] = None,
    view: Annotated[
        View | None,
        typer.Option(
            help="Watch live: a page for browsers on this machine, or a window; default: a window "
            "where there is a display, else a page.",
            show_default=False,
        ),
    ] = None,
    host: PageHost = "127.0.0.1",
    view_port: PagePort = None,
    json: Annotated[
        Path | None,
        typer.Option(help="Also write the figures to this JSON file.", show_default=False),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Folder for the motion (BVH) and the picture (PNG).")
    ] = Path("out/demo"),
    seed: Annotated[int, typer.Option(help="Of the noise and faults.")] = 0,
    noise_position: Annotated[
        float, typer.Option(help="Standard deviation of the trackers on each axis [m].")
    ] = 0.003,
    noise_orientation: Annotated[
        float, typer.Option(help="Standard deviation about each axis [deg].")
    ] = 0.5,
    faults: Annotated[
        bool,
        typer.Option(
            "--faults", help="Play with line noise: junk, truncation, silence, a jumping tracker."
        ),
    ] = False,
) -> None:
    """Play real walks as six trackers on a serial line and synthesize the body live.

    An emulated IS-900 in a process of its own sends noisy tracker poses at 40 Hz over a
    pseudo terminal; the driver, the database and the synthesizer are the real ones. Each
    walk is left out of the database while it plays. At the end come accuracy, latency and
    late frames, the synthesized motion as BVH and a picture of it.
    """
    from localreg.live.compiling import Compiling

    # The first start begins to compile before all that takes long to import.
    with Compiling() as compiling:
        from localreg.live.demo.run import DemoConfig
        from localreg.live.view_options import ViewOptions, usual_kind

        config = DemoConfig(
            seconds=seconds,
            seed=seed,
            noise_position=noise_position,
            noise_orientation=noise_orientation,
            faults=faults,
        )
        kind = usual_kind() if view is None else view.value
        seen = ViewOptions(kind, host, view_port, out, falls_back=view is None)
        _play(config, seen, out, json, compiling)


def _play(
    config: "DemoConfig",
    seen: "ViewOptions",
    out: Path,
    json: Path | None,
    compiling: "Compiling",
) -> None:
    from rich.console import Console

    from localreg.errors import LocalregError
    from localreg.evaluation.results import write_json
    from localreg.live.demo.run import PICTURE, run_demo
    from localreg.live.demo.show import results_table
    from localreg.motion.sources import read_sources

    says = Console(stderr=True)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot make the folder {out}: {reason}; give another --out") from None
    with says.status("reading the sample set"):
        motions, _ = read_sources(["sample"])
    run = run_demo(motions, config, out, says, seen, compiling)
    title = f"Live demo, {run.score.truth.seconds:.1f} s at {run.score.truth.rate:g} Hz"
    output = Console()
    output.print(results_table(run.score, run.session, title))
    if json is not None:
        write_json(run.score.to_json(), json)
        output.print(f"figures: {json}", highlight=False, soft_wrap=True)
    output.print(f"motion: {run.motion_file}", highlight=False, soft_wrap=True)
    with says.status("drawing"):
        from localreg.drawing.filmstrip import filmstrip

        drawing = filmstrip(
            run.score.truth,
            run.score.synthesis,
            out / PICTURE,
            mpjpe=run.score.mpjpe,
            angle_error=run.score.joint_angle_error,
            title=title,
        )
    output.print(f"picture: {out / PICTURE}", highlight=False, soft_wrap=True)
    if drawing.note:
        says.print(drawing.note, highlight=False)


demo.epilog = _EPILOG  # type: ignore[attr-defined]
