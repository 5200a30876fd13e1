"""`localreg run --view web`, as a child process: what is served, and for how long."""

import http.client
import os
import re
import signal
from pathlib import Path

import numpy as np
import pytest
from websockets.sync.client import connect
from websockets.typing import Origin

from localreg.body.subject import canonical_subject
from localreg.live import viewing
from localreg.live.config_files import find_config
from localreg.live.view_options import ViewOptions, usual_kind
from localreg.live.viewing import LiveView
from tests.localreg.live.daemons import PATIENCE, daemon, eventually
from tests.localreg.view.sockets import family_of, ports_beyond_loopback

EVERYWHERE = "0.0.0.0"  # noqa: S104  (for a second, to see that it is warned of)


def test_a_run_is_seen_while_it_lasts(tmp_path: Path):
    pytest.importorskip("envpool_assets")
    config = tmp_path / "quiet.toml"
    demo = find_config("demo").read_text()
    config.write_text(demo[: demo.index("[[outputs]]")])
    with daemon(config, "--view", "web", "--view-port", "0") as running:
        port = eventually(
            lambda: next(
                (int(found[1]) for line in list(running.said)
                 if (found := re.search(r"view: http://127\.0\.0\.1:(\d+)/", line))), 0
            ) or running.has_ended,
            "the address of the page",
        )  # fmt: skip
        assert not running.has_ended, running.said
        address = f"http://127.0.0.1:{port}"
        page = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE)
        page.request("GET", "/")
        assert page.getresponse().status == 200
        page.close()
        with connect(f"ws://127.0.0.1:{port}/state?sid=a", origin=Origin(address)) as state:
            assert "viewers=1" in str(state.recv(PATIENCE))
        running.runs_on()
        family = family_of(running.process.pid)
        assert not set().union(*map(ports_beyond_loopback, family))
        assert running.stop(signal.SIGTERM) == 0
    for pid in family:
        assert (
            not Path(f"/proc/{pid}/cmdline").exists()
            or b"localreg" not in Path(f"/proc/{pid}/cmdline").read_bytes()
        )


@pytest.mark.parametrize(
    ("display", "wayland", "kind"),
    [("", "", "web"), (":0", "", "native"), ("", "wayland-0", "native")],
)
def test_a_window_needs_a_display(
    monkeypatch: pytest.MonkeyPatch, display: str, wayland: str, kind: str
):
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setenv("WAYLAND_DISPLAY", wayland)
    assert usual_kind() == kind


@pytest.mark.parametrize("host", ["127.0.0.1", EVERYWHERE])
def test_a_page_for_everybody_is_warned_of(host: str, tmp_path: Path):
    told: list[str] = []
    options = ViewOptions("web", host, 0, tmp_path)
    with LiveView(options, canonical_subject(), 40.0, told.append) as view:
        url = view.wait()
        assert url.startswith("http://127.0.0.1:")
        assert bool(ports_beyond_loopback(view.pid)) == (host == EVERYWHERE)
    assert told[0] == f"view: {url}"
    assert [words.startswith("warning: the view is open") for words in told[1:]] == (
        [True] if host == EVERYWHERE else []
    )


def test_a_view_that_is_killed_begins_again_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(viewing, "PAUSES", (0.1, 0.2))
    told: list[str] = []
    options = ViewOptions("web", "127.0.0.1", 0, tmp_path)
    with LiveView(options, canonical_subject(), 40.0, told.append) as view:
        url = view.wait()
        seen = [view.pid]
        for _ in viewing.PAUSES:
            os.kill(seen[-1], signal.SIGKILL)
            eventually(lambda: view.pid not in seen and answers(url), "the page")
            seen.append(view.pid)
            view.show(1, 0.0, np.zeros(63))
            view.announce("here again")
        os.kill(seen[-1], signal.SIGKILL)
        eventually(lambda: told[-1].startswith("the view died too often"), "the last word")
    assert not any(Path(f"/proc/{pid}").exists() for pid in seen)
    assert [words[:38] for words in told] == [
        f"view: {url}",
        *["the view died and begins again in 0.1 ", "the view died and begins again in 0.2 "],
        told[-1][:38],
    ]


def answers(url: str) -> bool:
    page = http.client.HTTPConnection(url.split("/")[2], timeout=PATIENCE)
    try:
        page.request("GET", "/")
        return page.getresponse().status == 200
    except OSError:
        return False
    finally:
        page.close()
