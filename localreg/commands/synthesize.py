"""`localreg synthesize`: trackers in, a motion file out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from localreg.motion.motion import Motion

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg synthesize walk.bvh --database walks.db --out synthesized.bvh

localreg synthesize sample --clip 16_22 --database walks.db --out 16_22.bvh"""
)
def synthesize(
    source: Annotated[
        str,
        typer.Argument(metavar="INPUT", help="A motion file, whose trackers are simulated."),
    ],
    database: Annotated[Path, typer.Option(metavar="DIR", help="The database to learn from.")],
    out: Annotated[Path, typer.Option(help="The motion file to write; its ending says the kind.")],
    subject: Annotated[
        Path | None,
        typer.Option(help="Subject file (TOML) of who moves and wears the trackers."),
    ] = None,
    clip: Annotated[
        str | None, typer.Option(help="Which clip, where the input holds several.")
    ] = None,
    method: Annotated[str, typer.Option(help="The method.")] = "localreg",
    noise_position: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation on each axis [m].")
    ] = 0.003,
    noise_orientation: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation of each rotation component [deg].")
    ] = 0.5,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    max_frames: Annotated[
        int | None, typer.Option(min=1, help="Only the first so many frames.")
    ] = None,
) -> None:
    """Synthesize the motion of a whole body from six trackers and write it to a file.

    The trackers are simulated from a motion file, with noise. How far the result is from
    that motion is printed.
    """
    from localreg.motion.formats import writable_suffixes

    if out.suffix.lower() not in writable_suffixes():
        raise typer.BadParameter(
            f"{out} cannot be written; files may end in {', '.join(writable_suffixes())}",
            param_hint="--out",
        )

    from dataclasses import replace

    import numpy as np

    from localreg.body.subject import read_subject
    from localreg.commands.console import notes, output, progress_bar
    from localreg.database import PoseDatabase
    from localreg.evaluation.metrics import compare
    from localreg.evaluation.playback import play
    from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
    from localreg.motion.formats import write_motion
    from localreg.motion.motion import Provenance
    from localreg.synthesis.methods import METHODS, build_estimator

    if method not in METHODS:
        raise typer.BadParameter(
            f"no method named {method}; choose among {', '.join(METHODS)}", param_hint="--method"
        )
    learned = PoseDatabase.load(database)
    truth = _choose(source, clip).resampled(learned.rate)
    if subject is not None:
        truth = replace(truth, subject=read_subject(subject))
    if not learned.exclude_motion(truth).all():
        notes().print(
            "the database holds a copy of this motion, so the errors will look better than they "
            "are; localreg evaluate leaves such copies out"
        )
    if max_frames is not None:
        truth = truth.first(max_frames)
    quality = TrackerQuality(noise_position, float(np.radians(noise_orientation)))
    trackers = simulate_trackers(truth, quality, seed=seed)
    estimator = build_estimator(method, truth.subject, learned)
    with progress_bar("synthesizing") as bar:
        playback = play(estimator, trackers, progress=bar)
    made = Provenance(
        name=truth.provenance.name,
        subject=truth.provenance.subject,
        activity=truth.provenance.activity,
        source=source,
        notes=(f"synthesized by {method} from {len(truth.subject.mounts)} trackers",),
    )
    write_motion(replace(truth, qpos=playback.qpos, provenance=made), out)
    figures = compare(truth, playback.qpos).figures
    console = output()
    console.print(
        f"{out}: {len(truth)} frames at {truth.rate:g} Hz of {made.name}, by {method}",
        soft_wrap=True,
    )
    if figures.joint_angle_error_deg is not None and figures.mpjpe_cm is not None:
        console.print(
            f"joint angles off by {figures.joint_angle_error_deg:.2f} deg, "
            f"bone ends by {figures.mpjpe_cm:.2f} cm"
        )


def _choose(source: str, clip: str | None) -> "Motion":
    from localreg.commands.reading import read
    from localreg.errors import MotionError

    motions, _ = read([source], None, None)
    if clip is None and len(motions) == 1:
        return motions[0]
    names = [motion.provenance.name for motion in motions]
    if clip is None:
        raise MotionError(f"{source} holds {len(motions)} clips; name one by --clip {names[0]}")
    if clip not in names:
        raise MotionError(f"{source} holds no clip {clip}; it has {', '.join(names)}")
    return motions[names.index(clip)]
