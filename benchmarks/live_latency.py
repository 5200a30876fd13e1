"""How late and how steady: the whole live way, for minutes.

    python -m benchmarks.live_latency --minutes 10 --json live.json

An emulated IS-900 in a process of its own plays real walks at 40 Hz on a pseudo terminal;
`localreg run` in another reads them and sends VMC datagrams over the loopback to this one,
which counts them. Latency is the daemon's own: from the last byte of a frame's newest sample
to the pose in all outputs. Memory is the daemon's resident set once a second; its growth is
the slope of a line through the second half of the run.
"""

import socket
import tempfile
import threading
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray

from benchmarks.daemon import running_daemon
from localreg.commands.console import notes, output, progress_bar
from localreg.evaluation.results import program_version, write_json
from localreg.live.demo.playlist import Playlist
from localreg.motion.sources import SAMPLE, read_sources
from sensors.emulators.process import EmulatorProcess

RATE = 40.0
"""Frames a second [Hz]."""

_CONFIG = """
[[devices]]
driver = "is900"
port = "{port}"
stations = {{ head = 1, torso = 2, lhand = 3, rhand = 4, lankle = 5, rankle = 6 }}

[synthesis]
method = "{method}"

[[outputs]]
protocol = "vmc"
port = {vmc}
"""


class VmcReceiver:
    """Counts VMC frames on the loopback.

    Attributes:
        port: where they are to be sent.
        arrivals: host's monotonic time of each frame's first datagram [s].
    """

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port: int = self._socket.getsockname()[1]
        self.arrivals: list[float] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while data := self._socket.recv(65536):
            # Every frame begins with a bundle that says that the sender is well.
            if b"/VMC/Ext/OK" in data[:40]:
                self.arrivals.append(time.monotonic())

    def close(self) -> None:
        """End the thread."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as last:
            last.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join()
        self._socket.close()


def measure(minutes: float, method: str, record: bool) -> dict[str, Any]:
    """Run the whole way and return the figures.

    Args:
        minutes: how long, after the first frame [min].
        method: the daemon's.
        record: whether the daemon also records everything.

    Raises:
        RuntimeError: the daemon did not start, or ended early.
    """
    motions, _ = read_sources([SAMPLE])
    receiver = VmcReceiver()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        walks = folder / "walks.npz"
        Playlist.of(motions, RATE).playback().save(walks)
        noise = ["--noise-position", "0.003", "--noise-orientation", "0.5"]
        with EmulatorProcess(walks, ["--at-end", "loop", *noise]) as emulator:
            config = folder / "bench.toml"
            config.write_text(
                _CONFIG.format(port=emulator.address, method=method, vmc=receiver.port),
                encoding="utf-8",
            )
            arguments = ["--record", str(folder / "take.mcap")] if record else []
            states = _watch(config, arguments, 60.0 * minutes)
        receiver.close()
    return figures_of(states, receiver.arrivals, method, record)


def _watch(config: Path, arguments: list[str], seconds: float) -> list[dict[str, Any]]:
    """The daemon's state, once a second from its first frame on."""
    with running_daemon(config, arguments) as daemon:
        states = [daemon.until_published(1)]
        with progress_bar("measuring") as bar:
            begun = time.monotonic()
            for second in range(1, round(seconds) + 1):
                time.sleep(max(0.0, begun + second - time.monotonic()))
                states.append(daemon.state())
                bar(second, round(seconds), f"{states[-1]['late_frames']} late")
    return states


def figures_of(
    states: list[dict[str, Any]], arrivals: list[float], method: str, record: bool
) -> dict[str, Any]:
    """The figures of a run from looks a second apart and the times that frames arrived."""
    first, last = states[0], states[-1]
    seconds = last["uptime_s"] - first["uptime_s"]
    frames = last["frames"] - first["frames"]
    late = last["late_frames"] - first["late_frames"]
    memory = np.array([state["memory_mb"] for state in states])
    gaps = np.diff(arrivals)
    return {
        "schema": 1,
        "settings": {
            "rate_hz": RATE,
            "method": method,
            "record": record,
            "seconds": round(seconds, 1),
            "version": program_version(),
        },
        "frames": frames,
        "late_frames": late,
        "late_percent": 100.0 * late / max(1, frames),
        "held_frames": last["held_frames"] - first["held_frames"],
        "dropped_samples": last["dropped_samples"] - first["dropped_samples"],
        "received_frames": len(arrivals),
        "latency_p50_ms": float(np.median([state["latency_p50_ms"] for state in states[1:]])),
        "latency_p99_ms": float(np.median([state["latency_p99_ms"] for state in states[1:]])),
        "latency_p99_worst_ms": max(state["latency_p99_ms"] for state in states[1:]),
        "gap_p99_ms": 1e3 * float(np.percentile(gaps, 99.0)),
        "gap_max_ms": 1e3 * float(gaps.max()),
        "memory_begin_mb": float(memory[0]),
        "memory_end_mb": float(memory[-1]),
        "memory_growth_mb_per_hour": memory_growth(memory),
    }


def memory_growth(memory: Float[ndarray, " looks"]) -> float:
    """Slope of memory over the second half of looks a second apart, in its unit an hour.

    The first half is left to caches and pools, which fill once.
    """
    late = memory[len(memory) // 2 :]
    if len(late) < 2:
        return 0.0
    return float(3600.0 * np.polyfit(np.arange(len(late)), late, 1)[0])


def line(figures: dict[str, Any]) -> str:
    """The figures in one line for people."""
    return (
        f"{figures['settings']['seconds'] / 60.0:.1f} min at {RATE:g} Hz: "
        f"{figures['late_percent']:.2f} % of {figures['frames']} frames late, latency "
        f"{figures['latency_p50_ms']:.1f} ms (99 %: {figures['latency_p99_ms']:.1f} ms), memory "
        f"{figures['memory_end_mb']:.0f} MB, growing by "
        f"{figures['memory_growth_mb_per_hour']:.1f} MB an hour"
    )


def main(
    minutes: Annotated[float, typer.Option(min=0.02, help="How long to measure [min].")] = 10.0,
    method: Annotated[str, typer.Option(help="The method.")] = "localreg",
    record: Annotated[bool, typer.Option("--record", help="Record everything, too.")] = False,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
) -> None:
    """Measure lateness, latency and memory of `localreg run` over a serial line."""
    notes().print(f"one run of {minutes:g} min; other work on this machine shows in the figures")
    figures = measure(minutes, method, record)
    if json is not None:
        write_json(figures, json)
    output().print_json(data=figures)
    output().print(line(figures), soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
