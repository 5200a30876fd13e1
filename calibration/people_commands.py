"""What `localreg calibrate height` and `poses` do."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from calibration.anthropometry import NINE_BONES, length_of
from calibration.eigen_skeleton import (
    SkeletonPrior,
    bone_lengths,
    find_skeletons,
    learn,
    published_prior,
    subject_of,
)
from calibration.observability import expected_deviations, information
from calibration.pictures import draw_poses
from calibration.poses import EIGHT_POSES, NAIVE_POSES
from calibration.report import poses_table
from calibration.result import QUANTILE_90, relative_deviation
from localreg.body.subject import CalibrationRecord, Subject, write_subject
from localreg.commands.console import notes, output


def people(skeletons: Path | None, height: float | None = None) -> SkeletonPrior:
    """What lengths are likely: of the table, of files, at a height."""
    prior = published_prior() if skeletons is None else learn(find_skeletons(skeletons))
    return prior if height is None else prior.at_stature(height)


def height_only(metres: float, out: Path, skeletons: Path | None, name: str) -> None:
    """The likeliest person of a height, with honest deviations.

    Raises:
        LocalregError: nobody is so high, or the file cannot be written.
    """
    prior = people(skeletons, metres)
    subject = guessed_subject(prior, name)
    write_subject(subject, out)
    table = Table(title=f"guessed from a height of {metres:.2f} m", title_justify="left")
    table.add_column("")
    table.add_column("[cm]", justify="right")
    table.add_column("90 % within [cm]", justify="right")
    for label, parts in NINE_BONES.items():
        value = length_of(parts, prior.lengths)
        half = QUANTILE_90 * value * relative_deviation(parts, prior.lengths, prior.covariance)
        table.add_row(label, f"{100 * value:.1f}", f"{100 * half:.1f}")
    shown = output()
    shown.print(table)
    shown.print("tracker mounts are the default ones; eight poses would find them")
    shown.print(f"subject: {out}", soft_wrap=True)


def guessed_subject(prior: SkeletonPrior, name: str) -> Subject:
    """The average person of a prior, with its deviations on record."""
    deviations = prior.lengths * np.sqrt(np.diag(prior.covariance))
    record = CalibrationRecord(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        method="height",
        lengths_from=prior.sources,
        length_sd=bone_lengths(deviations),
    )
    return replace(subject_of(name, prior.lengths), calibration=record)


def show_poses(png: Path | None, with_information: bool, skeletons: Path | None) -> None:
    """The poses in words, as pictures, or as information.

    Raises:
        LocalregError: a picture cannot be written.
    """
    shown = output()
    shown.print(poses_table(EIGHT_POSES))
    if png is not None:
        with notes().status("drawing"):
            files, note = draw_poses(EIGHT_POSES, png)
        for file in files:
            shown.print(str(file), soft_wrap=True)
        if note:
            typer.echo(note, err=True)
    if with_information:
        with notes().status("linearizing"):
            table = information_table(people(skeletons))
        shown.print(table)


def information_table(prior: SkeletonPrior) -> Table:
    """Expected deviations of the nine lengths: beforehand, after each pose, and naively."""
    told, believed = information(EIGHT_POSES, prior)
    naive, _ = information(NAIVE_POSES, prior)
    table = Table(title="expected standard deviations [%]", title_justify="left")
    table.add_column("after")
    for bone in NINE_BONES:
        table.add_column(bone, justify="right")
    table.add_column("mean", justify="right")

    def add(name: str, matrix: np.ndarray) -> None:
        values = 100.0 * expected_deviations(matrix, prior)
        table.add_row(name, *(f"{value:.1f}" for value in values), f"{values.mean():.1f}")

    add("nothing", believed)
    known = believed.copy()
    for number, (pose, more) in enumerate(zip(EIGHT_POSES, told, strict=True), start=1):
        known = known + more
        add(f"{number} {pose.name}", known)
    add("eight naive poses", believed + naive.sum(axis=0))
    return table
