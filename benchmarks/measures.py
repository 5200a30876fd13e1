"""What the speed benchmark measures: keys, units, which way is better, by how much it varies.

Times are compared across machines in units of a calibration kernel that does what a frame
does (small matrix products, and rows fetched from all over memory) and is timed in the same
run.
"""

import time
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np

CALIBRATION: Final = "calibration_ms"


class Measure(NamedTuple):
    """One figure.

    Attributes:
        key: its name in the JSON.
        meaning: in words.
        unit: of the value.
        more_is_better: or less is.
        tolerance: change for the worse that the gate passes, as a share of the baseline.
        is_time: compared in units of the calibration kernel.
        bound: what it must keep to; None if nothing was promised.
    """

    key: str
    meaning: str
    unit: str
    more_is_better: bool = False
    tolerance: float = 0.5
    is_time: bool = True
    bound: float | None = None


def _of_size(size: str, p50: float, p99: float, start: float) -> tuple[Measure, ...]:
    return (
        Measure(f"{size}.frame_p50_ms", f"whole frame, {size} poses, half within", "ms", bound=p50),
        Measure(
            f"{size}.frame_p99_ms", f"whole frame, {size} poses, 99 % within", "ms",
            tolerance=1.0, bound=p99,
        ),
        Measure(
            f"{size}.late_frame_p99_ms", "the same but for the first second after a start", "ms",
            tolerance=1.0,
        ),
        *(
            Measure(f"{size}.{stage}_p50_ms", f"of it {stage}, {size} poses", "ms", tolerance=0.6)
            for stage in STAGES
        ),
        Measure(
            f"{size}.first_pose_s", f"second start to first pose, {size} poses", "s",
            tolerance=1.0, bound=start,
        ),
        Measure(
            f"{size}.memory_mb", f"peak resident memory, mapped pages too, {size} poses", "MB",
            tolerance=0.15, is_time=False, bound=1200.0,
        ),
        Measure(
            f"{size}.recall", f"recall of the K nearest, {size} poses", "", more_is_better=True,
            tolerance=0.005, is_time=False, bound=0.99,
        ),
        Measure(
            f"{size}.recall_partial", f"the same where a tracker is not believed, {size} poses", "",
            more_is_better=True, tolerance=0.02, is_time=False,
        ),
        Measure(
            f"{size}.error_ratio", f"joint angle error by that of exact search, {size} poses", "",
            tolerance=0.01, is_time=False, bound=1.01,
        ),
    )  # fmt: skip


STAGES: Final = ("query", "search", "regression", "solver", "rest")
"""Parts of a frame; the belief is part of the regression."""

MEASURES: Final = (
    *_of_size("65609", 0.7, 2.0, 3.0),
    *_of_size("1100000", 1.0, 2.5, 5.0),
    Measure("growth", "frame at 1,100,000 poses by that at 65,609", "", is_time=False, bound=2.5),
    Measure("versus_mink", "frame at 65,609 poses by mink's, same frames", "", is_time=False,
            bound=1.0),
    Measure("offline_frames_per_s", "evaluated frames a second, two processes, 65,609 poses",
            "1/s", more_is_better=True, bound=3000.0),
    Measure("build_s", "database of 1,100,000 poses from motion files", "s", bound=300.0),
    Measure("build_memory_mb", "peak memory of that, all processes", "MB", tolerance=0.2,
            is_time=False, bound=2000.0),
)  # fmt: skip


def calibration_ms(rounds: int = 30) -> float:
    """Time of the calibration kernel: the median of some rounds [ms]."""
    rng = np.random.default_rng(0)
    small = rng.normal(size=(400, 48)).astype(np.float32)
    memory = rng.normal(size=(60_000, 64)).astype(np.float32)
    rows = rng.integers(len(memory), size=(rounds, 400))
    taken = []
    for some in rows:
        begin = time.perf_counter()
        for _ in range(20):
            moment = small.T @ small
            np.linalg.eigvalsh(moment.astype(float))
            memory[some].sum()
        taken.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(taken))


def broken_bounds(figures: Mapping[str, float]) -> list[str]:
    """The promises that figures do not keep, in words."""
    found = []
    for measure in MEASURES:
        value, bound = figures.get(measure.key), measure.bound
        if value is None or bound is None:
            continue
        if (value < bound) if measure.more_is_better else (value > bound):
            found.append(f"{measure.meaning}: {value:.4g} {measure.unit}, promised {bound:g}")
    return found


def regressions(figures: Mapping[str, float], baseline: Mapping[str, float]) -> list[str]:
    """The figures that are worse than a baseline by more than their tolerance, in words.

    Args:
        figures: by key; the calibration kernel's time among them.
        baseline: the same, perhaps of another machine.
    """
    speed = figures.get(CALIBRATION, 1.0) / baseline.get(CALIBRATION, 1.0)
    found = []
    for measure in MEASURES:
        value, before = figures.get(measure.key), baseline.get(measure.key)
        if value is None or before is None:
            continue
        if measure.is_time:
            before *= 1.0 / speed if measure.more_is_better else speed
        worse = before - value if measure.more_is_better else value - before
        if worse > measure.tolerance * abs(before):
            found.append(
                f"{measure.meaning}: {value:.4g} {measure.unit}, the baseline is worth "
                f"{before:.4g} on this machine"
            )
    return found


def table(figures: Mapping[str, float]) -> str:
    """The figures as a Markdown table."""
    lines = ["| | measured | promised |", "|---|---|---|"]
    for measure in MEASURES:
        value = figures.get(measure.key)
        if value is None:
            continue
        sign = "≥" if measure.more_is_better else "≤"
        bound = "" if measure.bound is None else f"{sign} {measure.bound:g} {measure.unit}"
        lines.append(f"| {measure.meaning} | {value:.4g} {measure.unit} | {bound.strip()} |")
    return "\n".join(lines)


def known(figures: Mapping[str, Any]) -> dict[str, float]:
    """Only what is measured here, and the calibration."""
    keys = {measure.key for measure in MEASURES} | {CALIBRATION}
    return {key: float(value) for key, value in figures.items() if key in keys}
