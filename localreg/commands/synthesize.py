"""`localreg synthesize`: trackers in, a motion file out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from localreg.motion.motion import Motion

RECORDING = ".mcap"

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg synthesize take1.mcap --out take1.bvh --smooth

localreg synthesize walk.bvh --database walks.db --out synthesized.bvh

localreg synthesize sample --clip 16_22 --database walks.db --out 16_22.bvh"""
)
def synthesize(
    source: Annotated[
        str,
        typer.Argument(
            metavar="INPUT",
            help="A recording (.mcap) of localreg run or localreg sensors record, or a motion "
            "file whose trackers are simulated.",
        ),
    ],
    out: Annotated[Path, typer.Option(help="The motion file to write; its ending says the kind.")],
    database: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="The database to learn from; a recording without one is solved with the sample "
            "set.",
            show_default=False,
        ),
    ] = None,
    subject: Annotated[
        Path | None,
        typer.Option(
            help="Subject file (TOML) of who moves and wears the trackers; default: as recorded, "
            "or as the motion file has it."
        ),
    ] = None,
    smooth: Annotated[
        bool,
        typer.Option("--smooth", help="Smooth a recording with look-ahead, which does not lag."),
    ] = False,
    cutoff: Annotated[
        float, typer.Option(help="Frequency of which --smooth keeps half [Hz].")
    ] = 10.0,
    clip: Annotated[
        str | None, typer.Option(help="Which clip, where the input holds several.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(help="The method; default: as recorded, else localreg.", show_default=False),
    ] = None,
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

    A recording of `localreg run` is solved again from its raw bytes: with the same method,
    subject and database to the very poses that were seen live, or with others, or smoother. A
    recording of trackers alone (`localreg sensors record`) is solved for the first time. Of a
    motion file the trackers are simulated, with noise, and how far the result is from
    that motion is printed.
    """
    from localreg.motion.formats import writable_suffixes

    if out.suffix.lower() not in writable_suffixes():
        raise typer.BadParameter(
            f"{out} cannot be written; files may end in {', '.join(writable_suffixes())}",
            param_hint="--out",
        )

    if Path(source).suffix.lower() == RECORDING:
        _synthesize_recording(
            Path(source), out, database, subject, method, cutoff if smooth else None
        )
        return
    if smooth:
        raise typer.BadParameter("only recordings are smoothed", param_hint="--smooth")
    if database is None:
        raise typer.BadParameter(
            "a motion file needs a database that does not hold it; localreg db build makes one",
            param_hint="--database",
        )
    method = method or "localreg"

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


def _synthesize_recording(
    source: Path,
    out: Path,
    database: Path | None,
    subject: Path | None,
    method: str | None,
    cutoff: float | None,
) -> None:
    from localreg.body.subject import read_subject
    from localreg.commands.console import notes, output, progress_bar
    from localreg.errors import LocalregError
    from localreg.live.database_choice import choose_database
    from localreg.live.retake import largest_difference, solve_again
    from localreg.live.take import NoTakeError, Take
    from localreg.motion.formats import write_motion
    from localreg.synthesis.methods import METHODS, build_synthesizer
    from sensors.recording.replay import replay_frames

    if method is not None and method not in METHODS:
        raise typer.BadParameter(
            f"no method named {method}; choose among {', '.join(METHODS)}", param_hint="--method"
        )
    chosen = choose_database(database)
    try:
        take = Take.read(source)
    except NoTakeError:
        wearer = chosen.subject if subject is None else read_subject(subject)
        take = Take.of_trackers(source, wearer)
    if chosen.poses.rate != take.database["rate"]:
        raise LocalregError(
            f"the recording is at {take.database['rate']:g} Hz and the database at "
            f"{chosen.poses.rate:g} Hz; name one of the recording's rate by --database"
        )
    wearer = take.subject
    if subject is not None:
        wearer = read_subject(subject).with_trackers(take.subject.trackers)
    settings = take.settings if method is None else METHODS[method]
    is_same_database = chosen.identity == take.database["identity"]
    is_repetition = is_same_database and subject is None and settings == take.settings
    if take.indices and not is_same_database:
        notes().print(
            f"the take was made with another database ({take.database['source']}, "
            f"{take.database['poses']} poses), so its poses will differ; name that one by "
            "--database to repeat them",
            soft_wrap=True,
        )
    estimator = build_synthesizer(settings, wearer, chosen.poses)
    with progress_bar("solving") as bar:
        retake = solve_again(
            replay_frames(source),
            estimator,
            take.performance,
            take.searches if is_repetition else None,
            take.frames,
            bar,
        )
    motion = retake.motion(take, wearer, source, cutoff)
    write_motion(motion, out)
    console = output()
    console.print(
        f"{out}: {len(motion)} frames at {motion.rate:g} Hz of {source.stem}, by "
        f"{method or take.method}{'' if cutoff is None else f', smoothed at {cutoff:g} Hz'}",
        soft_wrap=True,
    )
    if is_repetition and take.indices:
        difference = largest_difference(take, retake)
        console.print(
            "the solved poses are bit for bit those seen live"
            if difference == 0.0
            else f"the solved poses differ from those seen live by up to {difference:.3g}; the "
            "take was made by another version or kind of processor"
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
