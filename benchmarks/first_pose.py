"""How soon `localreg run` gives its first pose, from the start of its process.

    python -m benchmarks.first_pose DATABASE [--starts 5] [--json FILE]

An emulated IS-900 plays real walks on a pseudo terminal all the while; the first pose is there
when its datagram has come over the loopback. The first start is told apart: on a machine new
to the program or to the database it compiles and indexes. Processor time is beside the time
that passes, since on a busy machine only the former says what the program is to blame for.
"""

import os
import socket
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from benchmarks.daemon import running_daemon
from benchmarks.live_latency import RATE
from localreg.commands.console import notes, output
from localreg.evaluation.results import write_json
from localreg.live.demo.playlist import Playlist
from localreg.motion.sources import SAMPLE, read_sources
from sensors.emulators.process import EmulatorProcess

_PATIENCE = 600.0  # for the first start at a million poses [s]
_TICKS = os.sysconf("SC_CLK_TCK")

_CONFIG = """
[[devices]]
driver = "is900"
port = "{port}"
stations = {{ head = 1, torso = 2, lhand = 3, rhand = 4, lankle = 5, rankle = 6 }}

[[outputs]]
protocol = "json"
port = {json}
"""


def measure(database: Path, starts: int) -> dict[str, Any]:
    """Start so many times and once more; times of the first start and of the others [s].

    Raises:
        RuntimeError: the daemon did not start.
        TimeoutError: no pose came.
    """
    motions, _ = read_sources([SAMPLE])
    with tempfile.TemporaryDirectory() as scratch:
        walks = Path(scratch) / "walks.npz"
        Playlist.of(motions, RATE).playback().save(walks)
        noise = ["--noise-position", "0.003", "--noise-orientation", "0.5"]
        with EmulatorProcess(walks, ["--at-end", "loop", *noise]) as emulator:
            config = Path(scratch) / "bench.toml"
            taken = [_start(config, emulator.address, database) for _ in range(starts + 1)]
    return {
        "first_start_s": taken[0][0],
        "first_start_cpu_s": taken[0][1],
        "first_pose_s": [passed for passed, _ in taken[1:]],
        "first_pose_cpu_s": [used for _, used in taken[1:]],
    }


def _start(config: Path, port: str, database: Path) -> tuple[float, float]:
    """Seconds until the first pose of one start: passed, and of the processor."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(_PATIENCE)
        text = _CONFIG.format(port=port, json=receiver.getsockname()[1])
        config.write_text(text, encoding="utf-8")
        begun = time.monotonic()
        with running_daemon(config, ["--database", str(database)]) as daemon:
            receiver.recv(65536)
            return time.monotonic() - begun, _processor_time(daemon.process.pid)


def _processor_time(pid: int) -> float:
    """What a process has used of the processor so far, all its threads together [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


def main(
    database: Annotated[Path, typer.Argument(metavar="DATABASE", help="What is learned from.")],
    starts: Annotated[int, typer.Option(min=1, help="How often, after the first.")] = 5,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
) -> None:
    """Time starts of `localreg run`."""
    notes().print(f"{starts + 1} starts; other work on this machine shows in the figures")
    figures = measure(database, starts)
    if json is not None:
        write_json(figures, json)
    output().print_json(data=figures)
    passed, used = figures["first_pose_s"], figures["first_pose_cpu_s"]
    output().print(
        f"first pose after {min(passed):.2f} to {max(passed):.2f} s, of which the program "
        f"computed {min(used):.2f} to {max(used):.2f} s; first start "
        f"{figures['first_start_s']:.1f} s",
        soft_wrap=True,
    )


if __name__ == "__main__":
    typer.run(main)
