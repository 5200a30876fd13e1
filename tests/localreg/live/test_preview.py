"""What the demo shows before the first pose is live."""

import threading
from pathlib import Path

import numpy as np
import pytest

from localreg.errors import LocalregError
from localreg.live.demo.playlist import Playlist
from localreg.live.demo.preview import Preview
from localreg.live.demo.view import DemoView
from localreg.live.view_options import ViewOptions
from localreg.motion.formats.sample import read_sample
from tests.localreg.live.daemons import PATIENCE


class Watched(DemoView):
    """A view on a page that writes down what it is given to show."""

    def __init__(self, options: ViewOptions, playlist: Playlist) -> None:
        self.rows: list[int] = []
        self.words: list[str] = []
        self.told: list[str] = []
        self.enough = threading.Event()
        super().__init__(options, playlist, self.told.append)

    def announce(self, words: str, title: str = "") -> None:
        super().announce(words, title)
        self.words.append(words)

    def show(self, index: int, at: float, qpos: np.ndarray) -> None:
        super().show(index, at, qpos)
        np.testing.assert_array_equal(qpos, self._playlist.pose(index))
        self.rows.append(index)
        if len(set(self.rows)) > 20 and self.words:
            self.enough.set()


@pytest.fixture(scope="module")
def playlist() -> Playlist:
    pytest.importorskip("envpool_assets")
    return Playlist.of(read_sample()[:2], 40.0, 1.0)


def test_the_recorded_walk_is_seen_until_the_first_pose(playlist: Playlist, tmp_path: Path) -> None:
    said: list[str] = []
    options = ViewOptions("web", "127.0.0.1", 0, tmp_path)
    with Watched(options, playlist) as view:
        with Preview(playlist, view, lambda: "compiling: 3", said.append):
            assert view.enough.wait(PATIENCE), view.told
        shown = len(view.rows)
        assert view.told[0].startswith("view: http://127.0.0.1:")
        assert view.words[0].startswith("compiling: 3\n")
        assert "as it was recorded" in view.words[0]
        assert "recorded" not in view.words[-1]
        assert len(view.rows) == shown
    assert set(said) == {"compiling: 3"}
    assert set(view.rows) <= set(range(playlist.rows))


def test_a_view_that_cannot_begin_ends_the_demo(playlist: Playlist, tmp_path: Path) -> None:
    options = ViewOptions("web", "203.0.113.9", 0, tmp_path)
    with (
        Watched(options, playlist) as view,
        pytest.raises(LocalregError, match="give --host an address"),
        Preview(playlist, view, lambda: "", lambda words: None),
    ):
        view._process.join(PATIENCE)


def test_poses_of_rows_are_those_of_their_instants(playlist: Playlist) -> None:
    for row in (0, playlist.rows // 2, playlist.rows - 1):
        at = row / playlist.rate
        truth = playlist.truth(playlist.clip_at(at), np.array([at]))[0]
        np.testing.assert_allclose(playlist.pose(row), truth, atol=1e-9)
