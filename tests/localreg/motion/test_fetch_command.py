"""`localreg data fetch`, from the command line to the files."""

import re

import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.motion.index import INDEX_NAME
from tests.localreg.motion.cmu_site import cmu_site
from tests.localreg.motion.test_fetch import ALL_FILES, there

run = CliRunner().invoke


@pytest.fixture
def site():
    with cmu_site() as running:
        yield running


def fetch(site, folder, *options):
    return run(app, ["data", "fetch", "cmu", "--site", site.address, "--to", str(folder), *options])


def test_people_are_fetched_and_a_database_made_of_them(site, tmp_path):
    folder = tmp_path / "cmu"
    result = fetch(site, folder, "--subjects", "2,60")
    assert result.exit_code == 0, result.output
    assert re.search(r"5 files fetched, 0\.\d MB; 0 were there", result.stdout)
    assert "NSF EIA-0196217" in result.stdout
    assert "--overrides" in result.stdout
    assert there(folder) == ALL_FILES
    again = fetch(site, folder, "--subjects", "2-60")
    assert "0 files fetched, 0.0 MB; 5 were there" in again.stdout
    again = fetch(site, folder, "--subjects", "02_01")
    assert "0 files fetched, 0.0 MB; 2 were there" in again.stdout
    built = run(
        app,
        ["db", "build", str(folder), "--out", str(tmp_path / "db"), "--overrides",
         str(folder / "cmu-rates.toml")],
    )  # fmt: skip
    assert built.exit_code == 0, built.output
    assert "salsa" in built.stdout


def test_activities_are_listed_without_fetching(site, tmp_path):
    result = fetch(site, tmp_path, "--activity", "SALSA", "--activity", "run", "--list")
    assert result.exit_code == 0, result.output
    assert "60_01" in result.stdout
    assert "02_02" in result.stdout
    assert "02_01" not in result.stdout
    assert "2 trials of 2 people" in result.stdout
    assert there(tmp_path) == []
    assert (tmp_path / INDEX_NAME).is_file()


def test_everything_comes_as_one_archive(site, tmp_path):
    result = fetch(site, tmp_path, "--all")
    assert result.exit_code == 0, result.output
    assert there(tmp_path) == ALL_FILES
    assert (tmp_path / INDEX_NAME).is_file()
    assert "60_01.amc" in (tmp_path / "cmu-rates.toml").read_text()


def test_what_cannot_be_had_is_one_sentence_and_a_failure(site, tmp_path):
    del site.files["/subjects/02/02_01.amc"]
    result = fetch(site, tmp_path, "--subjects", "02")
    assert result.exit_code == 1
    assert "404" in result.stdout
    assert "error: 1 of 3 files could not be had" in result.output
    assert there(tmp_path) == ["subjects/02/02.asf", "subjects/02/02_02.amc"]


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ([], 2, "choose by --subjects"),
        (["--all", "--subjects", "02"], 2, "stands alone"),
        (["--subjects", "7"], 1, "no subject 7"),
        (["--subjects", "02", "--connections", "99"], 1, "1 to 8"),
        (["--subjects", "02", "--index", "nowhere.tsv"], 1, "cannot read the index"),
    ],
)
def test_wrong_use_is_said(site, tmp_path, options, code, message):
    result = fetch(site, tmp_path, *options)
    assert result.exit_code == code
    assert message in re.sub(r"[\s│]+", " ", result.output)
