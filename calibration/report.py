"""What a calibration found, as tables for people."""

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from calibration.poses import TargetPose
from calibration.result import QUANTILE_90, Calibration
from calibration.screening import Finding


def lengths_table(result: Calibration, truth: dict[str, float] | None = None) -> Table:
    """Lengths with their 90 % intervals.

    Args:
        result: the calibration.
        truth: true lengths by name [m], where a person is simulated.
    """
    table = Table(title="lengths", title_justify="left")
    table.add_column("")
    table.add_column("[cm]", justify="right")
    table.add_column("90 % interval [cm]", justify="right")
    table.add_column("told by")
    if truth:
        table.add_column("truth [cm]", justify="right")
    for length in result.lengths:
        half = QUANTILE_90 * length.deviation
        row = [
            length.name,
            f"{100 * length.value:.1f}",
            f"{100 * (length.value - half):.1f} to {100 * (length.value + half):.1f}",
            "trackers" if length.is_observable else "usual proportions",
        ]
        if truth:
            row.append(f"{100 * truth[length.name]:.1f}")
        table.add_row(*row)
    return table


def mounts_table(result: Calibration) -> Table:
    """Where the trackers sit, and how well that is known."""
    table = Table(title="trackers in their bones' frames", title_justify="left")
    for name in ("", "bone", "position [mm]", "90 % within [mm]", "turn within [deg]"):
        table.add_column(name, justify="left" if name in ("", "bone") else "right")
    worn = {mount.tracker: mount for mount in result.subject.mounts}
    for mount in result.mounts:
        position = 1e3 * np.array(worn[mount.tracker].position)
        half = 1e3 * QUANTILE_90 * np.array(mount.position_sd)
        turn = np.degrees(QUANTILE_90 * max(mount.orientation_sd))
        table.add_row(
            mount.tracker,
            mount.bone,
            " ".join(f"{value:.0f}" for value in position),
            " ".join(
                f"{value:.0f}" if told else f"({value:.0f})"
                for value, told in zip(half, mount.is_observable, strict=True)
            ),
            f"{turn:.1f}",
        )
    return table


def summary_lines(result: Calibration) -> list[str]:
    """What else is worth a line."""
    error = np.degrees(result.pose_sigma)
    lines = [f"joints were off by about {error:.1f} deg about each axis in the poses"]
    if any(not told for mount in result.mounts for told in mount.is_observable):
        lines.append("in brackets: along that axis the tracker's place and a length cannot be told "
                     "apart; usual proportions and straps decide")  # fmt: skip
    lines.append(f"another hold of pose {result.next_pose} would sharpen the result most")
    return lines


def findings_lines(findings: Sequence[Finding]) -> list[str]:
    """What was amiss, one line each."""
    return [f"{finding.kind.value}: {finding.text}" for finding in findings]


def motion_lines(result: Calibration, findings: Sequence[Finding]) -> list[str]:
    """What was noted of the person beyond what was amiss in the poses: what motion showed."""
    record = result.subject.calibration
    said = {finding.text for finding in findings}
    return [note for note in (record.notes if record else ()) if note not in said]


def poses_table(poses: Sequence[TargetPose]) -> Table:
    """The poses in words."""
    table = Table(title="the eight poses", title_justify="left", show_lines=True)
    for name in ("", "pose", "legs", "arms", "head"):
        table.add_column(name)
    for number, pose in enumerate(poses, start=1):
        table.add_row(str(number), pose.name, *pose.words)
    return table
