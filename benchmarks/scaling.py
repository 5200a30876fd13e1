"""Speed at two sizes of database, building one from files, and evaluating on all cores.

    LOCALREG_MOTIONS=... python -m benchmarks.scaling --work DIR [--gate] [--json FILE]

There is not enough free motion at hand for a million poses, so the real motion (the sample
set and what LOCALREG_MOTIONS names) is made larger (`benchmarks.larger`): good for time,
memory and recall, never for accuracy. Every twelfth recording is kept out and played. Each
size is measured in a process of its own, started twice: the second start is what counts.
"""

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import matplotlib as mpl
import typer

from benchmarks.larger import made_larger
from benchmarks.latency import played_clips
from benchmarks.marks import put_table
from benchmarks.measures import (
    CALIBRATION,
    STAGES,
    broken_bounds,
    calibration_ms,
    known,
    regressions,
    table,
)
from localreg.commands.console import notes, output
from localreg.commands.reading import read
from localreg.database import PoseDatabase
from localreg.evaluation.execution import processes
from localreg.evaluation.protocol import Protocol, plan_trials
from localreg.evaluation.results import write_json
from localreg.motion.formats import write_motion

SIZES: Final = (65_609, 1_100_000)
BASELINE: Final = Path(__file__).with_name("baseline.json")

_PLAYED_STRIDE: Final = 12
_PLAYED_TIMES: Final = 8  # that all clips are evaluated, so that the end of the work counts little
_FILES_RATE: Final = 40.0  # of files written to be built from


def make_databases(folder: Path, sizes: Sequence[int]) -> None:
    """Make what is not there yet: a database of each size, and the one that is played.

    Raises:
        MotionError: there is no motion.
    """
    wanted = [folder / str(size) for size in sizes] + [folder / "played"]
    if all(path.exists() for path in wanted):
        return
    learned, played = _motions()
    PoseDatabase.build(played, mirror=False).save(folder / "played")
    for size in sizes:
        notes().print(f"making a database of {size} poses")
        PoseDatabase.build(made_larger(learned, size, 40.0)).save(folder / str(size))


def _motions() -> tuple[list[Any], list[Any]]:
    """The real motion to learn from, and the recordings that are played."""
    sources = ["sample", *([named] if (named := os.environ.get("LOCALREG_MOTIONS")) else [])]
    motions, _ = read(sources, None, None)
    played = motions[3::_PLAYED_STRIDE]
    return [motion for motion in motions if motion not in played], played


def measure_size(folder: Path, size: int, frames: int) -> dict[str, float]:
    """Everything about one size, by key."""
    place = [str(folder / str(size)), str(folder / "played")]
    # The first start indexes and compiles; mink and exact search would count as memory.
    found = _run_latency([*place, "--frames", "30", "--exact"])
    timed = _run_latency([*place, "--frames", str(frames), *(["--mink"] if size < 200_000 else [])])
    found = {**timed, **{key: found[key] for key in found if key.startswith(("recall", "error_"))}}
    figures = {f"{size}.{key}": value for key, value in found.items()}
    if "mink_p50_ms" in found:
        figures["versus_mink"] = found["ours_p50_ms"] / found["mink_p50_ms"]
    return figures


def _run_latency(arguments: list[str]) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figures.json"
        command = [sys.executable, "-m", "benchmarks.latency", *arguments, "--json", str(file)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return json.loads(file.read_text(encoding="utf-8"))


def measure_offline(folder: Path, size: int, jobs: int) -> float:
    """Frames a second that an evaluation of the played clips gets through."""
    database = PoseDatabase.load(folder / str(size))
    protocol = Protocol(methods=("localreg",), signals=("both",), leave_out=None)
    trials, _ = plan_trials(played_clips(folder / "played"), database, protocol)
    trials = sorted(_PLAYED_TIMES * trials, key=lambda trial: len(trial.motion), reverse=True)
    with processes(database, jobs, folder / str(size)) as run:
        list(run(trials, protocol))  # compiles, and learns what is learned once
        begin = time.perf_counter()
        done = [clip for clips in run(trials, protocol) for clip in clips]
        return sum(clip.frames for clip in done) / (time.perf_counter() - begin)


def measure_build(folder: Path, poses: int) -> tuple[float, float]:
    """Time [s] and peak memory of all processes [MB] of building a database from files."""
    files = folder / f"files-{poses}"
    if not files.exists():
        notes().print(f"writing the motion files of {poses} poses")
        learned, _ = _motions()
        part = files.with_name(files.name + ".part")
        part.mkdir(parents=True, exist_ok=True)
        for number, motion in enumerate(made_larger(learned, poses, _FILES_RATE)):
            write_motion(motion, part / f"{number:05d}.bvh")
        part.rename(files)
    command = [sys.executable, "-m", "localreg", "db", "build", str(files), "--out"]
    with tempfile.TemporaryDirectory(dir=folder) as out:
        begin = time.perf_counter()
        with subprocess.Popen([*command, f"{out}/db"], stdout=subprocess.DEVNULL) as process:
            peak = _peak_memory(process)
        taken = time.perf_counter() - begin
        if process.returncode:
            raise RuntimeError("the build failed; see its message above")
        if len(PoseDatabase.load(Path(out) / "db", verify=False)) < poses - 1:
            raise RuntimeError("the build lost poses")
    return taken, peak


def _peak_memory(process: subprocess.Popen[bytes]) -> float:
    """Largest proportional memory of a process and its children until it ends [MB]."""
    peak, over = 0.0, threading.Event()
    while process.poll() is None:
        family, grown = {process.pid}, True
        parents = _parents()
        while grown:
            more = {pid for pid, parent in parents.items() if parent in family} - family
            family |= more
            grown = bool(more)
        peak = max(peak, sum(_memory(pid) for pid in family))
        over.wait(0.3)
    return peak


def _parents() -> dict[int, int]:
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            found[int(path.parent.name)] = int(path.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
    return found


def _memory(pid: int) -> float:
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
    except OSError:
        return 0.0
    return sum(int(line.split()[1]) for line in text.splitlines() if line.startswith("Pss:")) / 1e3


def plot(figures: dict[str, float], path: Path) -> None:
    """Draw the parts of a frame at every size."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    sizes = sorted(int(key.split(".")[0]) for key in figures if key.endswith(".frame_p50_ms"))
    names = [f"{size:,}" for size in sizes]
    figure, axes = plt.subplots(figsize=(6.0, 2.5), layout="constrained")
    left = [0.0] * len(sizes)
    for stage in STAGES:
        widths = [figures[f"{size}.{stage}_p50_ms"] for size in sizes]
        axes.barh(names, widths, left=left, label=stage)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    for name, size in zip(names, sizes, strict=True):
        axes.plot(figures[f"{size}.frame_p99_ms"], name, "k|", markersize=18)
    axes.set_xlabel("time of a frame [ms]; bars: medians of its parts, line: 99 %")
    axes.set_ylabel("poses")
    axes.legend(ncols=len(STAGES), fontsize="small", loc="upper center", bbox_to_anchor=(0.5, 1.3))
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main(
    work: Annotated[Path, typer.Option(help="Where databases are made and kept.")],
    sizes: Annotated[str, typer.Option(help="With commas.")] = ",".join(map(str, SIZES)),
    frames: Annotated[int, typer.Option(min=1, help="Frames to time at every size.")] = 2000,
    build: Annotated[bool, typer.Option(help="Also build the largest from files.")] = True,
    jobs: Annotated[int, typer.Option(min=1, help="Processes of the evaluation.")] = 2,
    gate: Annotated[
        bool, typer.Option("--gate", help="Fail where a figure is worse than the baseline.")
    ] = False,
    keep: Annotated[
        bool, typer.Option("--baseline", help="Make these figures the baseline.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write the figures here.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Also draw them here.")
    ] = None,
    readme: Annotated[
        Path | None, typer.Option(help="Put the table between this file's marks of it.")
    ] = None,
) -> None:
    """Measure speed at some sizes of database."""
    wanted = [int(size) for size in sizes.split(",")]
    work.mkdir(parents=True, exist_ok=True)
    make_databases(work, wanted)
    figures: dict[str, float] = {CALIBRATION: calibration_ms()}
    for size in wanted:
        notes().print(f"timing frames at {size} poses")
        figures |= measure_size(work, size, frames)
    if set(SIZES) <= set(wanted):
        small, large = (figures[f"{size}.frame_p50_ms"] for size in SIZES)
        figures["growth"] = large / small
    if SIZES[0] in wanted:
        notes().print("timing an evaluation")
        figures["offline_frames_per_s"] = measure_offline(work, SIZES[0], jobs)
    if build:
        notes().print("building a database from files")
        figures["build_s"], figures["build_memory_mb"] = measure_build(work, max(wanted))
    console = output()
    console.print(table(figures))
    if json_file is not None:
        write_json(figures, json_file)
    if picture is not None:
        plot(figures, picture)
    if readme is not None:
        put_table(readme, table(figures), "speed")
    if keep:
        write_json(known(figures), BASELINE)
    for line in broken_bounds(figures):
        console.print(f"not kept: {line}")
    if gate:
        worse = regressions(figures, json.loads(BASELINE.read_text(encoding="utf-8")))
        for line in worse:
            console.print(f"worse: {line}")
        if worse:
            raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
