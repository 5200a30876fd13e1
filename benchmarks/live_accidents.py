"""What is lost when a recording daemon is killed, and how soon motion is back after a pulled plug.

    python -m benchmarks.live_accidents --kills 10 --pulls 3 --json accidents.json

The daemon, an emulated IS-900 on a pseudo terminal and the recording are the real ones. A kill
is SIGKILL at a random moment; what is missing is the time from it back to the newest raw bytes
in the file, which this project's reader and mcap's own stream reader must agree on. A pull
closes the pseudo terminal; the time counts from when it is there again to the next pose.
"""

import json as json_module
import random
import signal
import tempfile
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from benchmarks.daemon import running_daemon
from benchmarks.live_latency import RATE
from localreg.commands.console import notes, output, progress_bar
from localreg.evaluation.results import write_json
from localreg.live.demo.playlist import Playlist
from localreg.motion.sources import SAMPLE, read_sources
from sensors.emulators.endpoints import PtyEndpoint
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.source import Playback
from sensors.recording import read_recording

_CONFIG = """
[[devices]]
driver = "is900"
port = "{port}"
stations = {{ head = 1, torso = 2, lhand = 3, rhand = 4, lankle = 5, rankle = 6 }}
"""


def _plug(link: Path, playback: Playback) -> Is900Emulator:
    """An emulated tracker on a pseudo terminal that a fixed link names."""
    begun = time.monotonic()
    return Is900Emulator(
        lambda _: playback.pose_at((time.monotonic() - begun) % playback.duration),
        endpoint=PtyEndpoint(link),
        start="now",
    )


def kill(config: Path, link: Path, playback: Playback, take: Path, after: float) -> dict[str, Any]:
    """Kill a recording daemon so long after its first poses; what is missing of its take."""
    with _plug(link, playback), running_daemon(config, ["--record", str(take)]) as daemon:
        published = daemon.until_published(20)["published"]
        time.sleep(after)
        killed = time.monotonic()
        daemon.process.send_signal(signal.SIGKILL)
        daemon.process.wait()
    ours = [(m.topic, m.data) for m in read_recording(take)]
    newest = max(data["time"] for topic, data in ours if topic.startswith("/raw/"))
    return {
        "after_s": round(after, 3),
        "missing_ms": 1e3 * (killed - newest),
        "poses": sum(topic == "/poses" for topic, _ in ours),
        "published_before": published,
        "readers_agree": ours == _by_mcap(take),
    }


def _by_mcap(take: Path) -> list[tuple[str, Any]]:
    """What mcap's own reader makes of a file that ends anywhere."""
    topics, found = {}, []
    with take.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    found.append((topics[record.channel_id], json_module.loads(record.data)))
        except McapError:
            pass  # where the file ends
    return found


def pull(config: Path, link: Path, playback: Playback, away: float) -> dict[str, Any]:
    """Pull the plug for some seconds; how soon after its return there is a pose again."""
    with running_daemon(config) as daemon:
        with _plug(link, playback):
            daemon.until_published(40)
        time.sleep(away)
        with _plug(link, playback):
            back = time.monotonic()
            before = daemon.state()
            solved = before["published"] - before["held_frames"]
            while (state := daemon.state())["published"] - state["held_frames"] <= solved:
                time.sleep(0.005)
            return {"away_s": away, "poses_after_s": time.monotonic() - back}


def main(
    kills: Annotated[int, typer.Option(min=0, help="How often the daemon is killed.")] = 10,
    pulls: Annotated[int, typer.Option(min=0, help="How often the plug is pulled.")] = 3,
    away: Annotated[float, typer.Option(min=0.0, help="For how long it is away [s].")] = 5.0,
    seed: Annotated[int, typer.Option(help="Seed of the moments.")] = 0,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
) -> None:
    """Kill a recording daemon at random moments, and pull the plug of a running one."""
    moments = random.Random(seed)  # noqa: S311
    playback = Playlist.of(read_sources([SAMPLE])[0], RATE).playback()
    killed, pulled = [], []
    with tempfile.TemporaryDirectory() as scratch, progress_bar("accidents") as bar:
        folder = Path(scratch)
        config, link = folder / "run.toml", folder / "is900"
        config.write_text(_CONFIG.format(port=link), encoding="utf-8")
        for number in range(kills):
            take = folder / f"take{number}.mcap"
            killed.append(kill(config, link, playback, take, moments.uniform(0.05, 2.0)))
            bar(number + 1, kills + pulls, "killed")
        for number in range(pulls):
            pulled.append(pull(config, link, playback, away))
            bar(kills + number + 1, kills + pulls, "pulled")
    figures = {"schema": 1, "kills": killed, "pulls": pulled}
    if json is not None:
        write_json(figures, json)
    output().print_json(data=figures)
    if killed:
        missing = np.array([figure["missing_ms"] for figure in killed])
        agree = sum(figure["readers_agree"] for figure in killed)
        output().print(
            f"{len(killed)} kills: {missing.min():.0f} to {missing.max():.0f} ms missing; both "
            f"readers agree on {agree} of {len(killed)} files",
            soft_wrap=True,
        )
    if pulled:
        times = [figure["poses_after_s"] for figure in pulled]
        notes().print(f"plug away for {away:g} s; the longest of {len(pulled)} returns counts")
        output().print(f"poses again {max(times):.2f} s after the plug's return", soft_wrap=True)


if __name__ == "__main__":
    typer.run(main)
