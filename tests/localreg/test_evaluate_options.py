"""`localreg evaluate` beyond its tables: the report, disturbances, a cluster."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.commands.grids import Grid
from localreg.evaluation import worker
from localreg.motion.formats import write_motion
from localreg.motion.formats.sample import read_sample
from localreg.synthesis.settings import Settings
from tests.localreg.evaluation.standing import Builder

run = CliRunner().invoke
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three real walks, two of them too short to lose a tracker, as files."""
    pytest.importorskip("envpool_assets")
    folder = tmp_path_factory.mktemp("walks")
    motions = sorted(read_sample(), key=len)[-3:]
    for motion, frames in zip(motions, (40, 50, 100), strict=True):
        short = replace(motion, qpos=motion.qpos[:frames])
        write_motion(short, folder / f"{motion.provenance.name}.bvh")
    return folder


@pytest.fixture
def builder(monkeypatch: pytest.MonkeyPatch) -> Builder:
    builder = Builder()

    def build_squares(settings: Settings, *rest: object) -> object:
        assert settings.lorentzian > 1e9
        return builder(settings.prior, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(worker, "build_estimator", builder)
    monkeypatch.setattr(worker, "build_synthesizer", build_squares)
    return builder


class Page(HTMLParser):
    """What a page consists of."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.pictures: list[str] = []
        self.links: list[str] = []
        self.open: list[str] = []
        self.headings = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag == "img":
            self.pictures.append(values["src"] or "")
            assert values["alt"]
        elif tag not in ("meta", "br"):
            self.open.append(tag)
        self.headings += tag == "h2"
        self.links += [v for k, v in attrs if k in ("src", "href", "action") and v and tag != "img"]
        assert tag not in ("script", "link", "iframe")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_the_report_is_one_page_that_needs_nothing_else(
    walks: Path, builder: Builder, tmp_path: Path
) -> None:
    folder = tmp_path / "deep" / "report"
    result = run(
        app,
        ["evaluate", str(walks), "--methods", "localreg,ik,ik-truth", "--signals", "both",
         "--jobs", "1", "--max-frames", "24", "--report", str(folder)],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    assert [path.name for path in folder.iterdir()] == ["report.html"]
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert page.links == []
    assert "http" not in re.sub(r'src="data:[^"]*"', "", text)
    # Two of bars, one over time, three films, one by bone, five series.
    assert len(page.pictures) == 12
    for picture in page.pictures:
        head, _, data = picture.partition(",")
        assert head == "data:image/png;base64"
        content = base64.b64decode(data, validate=True)
        assert content.startswith(PNG)
        assert len(content) > 5000
    for words in ("Means over 3 clips", "worse than ik-truth", "localreg-squares", "no head",
                  "Database size", "3 clips, 72 frames at 40 Hz", "excludes zero"):  # fmt: skip
        assert words in text, words


def test_disturbances_are_a_table_and_a_document(
    walks: Path, builder: Builder, tmp_path: Path
) -> None:
    out = tmp_path / "lost.json"
    args = ["evaluate", str(walks), "--methods", "ik", "--signals", "both", "--jobs", "1"]
    result = run(app, [*args, "--disturb", "lost-tracker", "--json", str(out)])
    assert result.exit_code == 0, result.output
    for tracker in ("head", "torso", "lhand", "rhand", "lankle", "rankle"):
        assert f"{tracker} lost for 1 s" in result.stdout
    document = json.loads(out.read_text())
    assert document["disturbance"] == "lost-tracker"
    assert [entry["clips"] for entry in document["growth"]] == [1] * 6
    assert all(entry["mpjpe_growth"] > 0.0 for entry in document["growth"])
    assert "slowest" in result.stdout
    assert document["growth"][0]["recovery"] == {
        "of_means": 0, "half": 0, "most": 0, "slowest": 0,
    }  # fmt: skip
    result = run(app, [*args, "--disturb", "outliers", "--json", "-", "--max-frames", "20"])
    assert result.exit_code == 0, result.output
    (entry,) = json.loads(result.stdout)["growth"]
    assert entry["disturbance"] == "5% outliers of 30 cm"
    assert entry["recovery"] is None


def test_disturbing_options_reach_the_trackers(
    walks: Path, builder: Builder, tmp_path: Path
) -> None:
    out = tmp_path / "figures.json"
    result = run(
        app,
        ["evaluate", str(walks), "--methods", "ik", "--signals", "both", "--jobs", "1",
         "--max-frames", "40", "--json", str(out), "--outliers", "0.1", "--outlier-position", "0.5",
         "--outlier-orientation", "30", "--dropout", "0.2", "--dropout-seconds", "0.1",
         "--slip-position", "0.02", "--slip-orientation", "5", "--time-jitter", "4",
         "--trackers", "head,lhand", "--database-share", "0.5"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    document = json.loads(out.read_text())
    assert document["conditions"] == {
        "leave_out": "clip",
        "trackers": ["head", "lhand"],
        "max_frames": 40,
        "database_share": 0.5,
        "outliers": 0.1,
        "outlier_position": 0.5,
        "dropout": 0.2,
        "dropout_seconds": 0.1,
        "slip_position": 0.02,
        "time_jitter": 0.004,
        "losses": [],
        "outlier_orientation_deg": pytest.approx(30.0),
        "slip_orientation_deg": pytest.approx(5.0),
    }
    assert any(clip["recovery_s"] is not None for clip in document["clips"])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--methods", "magic"], "no method named magic"),
        (["--database-share", "0"], "give a share above 0"),
        (["--disturb", "outliers", "--report", "x"], "choose one"),
        (["--disturb", "earthquake"], "lost-tracker"),
        (["--report", __file__], "is a file; give a folder"),
    ],
)
def test_wrong_use_is_refused_at_once(walks: Path, options: list[str], words: str) -> None:
    result = run(app, ["evaluate", str(walks), *options], env={"COLUMNS": "400"})
    assert result.exit_code == 2
    assert words in result.output


def test_a_grid_is_the_same_everywhere() -> None:
    grid = Grid("Some <title>", ["who", "how\nmuch"], caption="a & b")
    grid.add_row("a<b", "1.5")
    grid.add_section()
    grid.add_row("c", "-")
    assert grid.rows == [("a<b", "1.5"), ("c", "-")]
    html = grid.to_html()
    assert html.count("<tbody>") == 2
    assert "how<br>much" in html
    assert "a&lt;b" in html
    assert "<title>" not in html
    assert Page(html).open == []
    assert grid.to_markdown().splitlines() == [
        "| who | how much |", "| --- | ---: |", "| a<b | 1.5 |", "| c | - |",
    ]  # fmt: skip
    assert [column.justify for column in grid.to_rich().columns] == ["left", "right"]
