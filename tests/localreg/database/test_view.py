"""What a subject sees of a database: worked out once, kept, and never stale."""

import os
from pathlib import Path

import numpy as np
import pytest

from localreg.body.chain import chain_of
from localreg.body.subject import Subject, canonical_subject
from localreg.database import PoseDatabase, view
from localreg.database.cache import FOLDER, cached_arrays, digest
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Metric, Query
from localreg.database.view import SubjectView, subject_view
from tests.localreg.database.made_motion import make_motion
from tests.localreg.database.plain_search import PlainSearch


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv(FOLDER, str(tmp_path / "cache"))
    monkeypatch.setattr(view, "_WORTH_KEEPING", 10)
    return tmp_path / "cache"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("databases") / "db"
    PoseDatabase.build(make_motion(i, 300) for i in range(3)).save(folder)
    return folder


def look(folder: Path, subject: Subject, weight: float = 1.0) -> tuple[SubjectView, list[str]]:
    """The view, and what had to be worked out for it."""
    layout, told = FeatureLayout.of(subject), []
    metric = Metric(np.array([0.3, 0.2, 0.1]), np.full(layout.size, weight))
    database = PoseDatabase.load(folder)
    chain = chain_of(subject)
    seen = subject_view(database, layout, chain, metric, lambda *args: told.append(args[2]))
    return seen, told


def test_the_second_time_it_is_mapped(folder: Path, cache: Path) -> None:
    first, told = look(folder, canonical_subject())
    assert set(told) == {"placing trackers", "indexing"}
    second, told = look(folder, canonical_subject())
    assert told == []
    assert isinstance(second.features.base, np.memmap)
    np.testing.assert_array_equal(first.features, second.features)
    assert len(list(cache.iterdir())) == 1


def test_other_trackers_metrics_or_databases_are_worked_out(
    folder: Path, cache: Path, tmp_path: Path
) -> None:
    look(folder, canonical_subject())
    fewer = canonical_subject().with_trackers(("head", "torso", "lhand"))
    other = PoseDatabase.build(make_motion(i, 300) for i in range(1, 4))
    other.save(tmp_path / "other")
    for place, subject, weight in (
        (folder, fewer, 1.0),
        (folder, canonical_subject(), 2.0),
        (tmp_path / "other", canonical_subject(), 1.0),
    ):
        assert look(place, subject, weight)[1]
    assert len(list(cache.iterdir())) == 4


def test_a_damaged_entry_is_made_again(folder: Path, cache: Path) -> None:
    good = np.array(look(folder, canonical_subject())[0].features)
    (entry,) = cache.iterdir()
    path = entry / "features.npy"
    path.write_bytes(path.read_bytes()[:-9])
    seen, told = look(folder, canonical_subject())
    assert told
    np.testing.assert_array_equal(seen.features, good)
    assert look(folder, canonical_subject())[1] == []


def test_where_nothing_can_be_kept_it_works_all_the_same(
    folder: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(FOLDER, str(tmp_path / "file" / "cache"))
    for _ in range(2):
        seen, told = look(folder, canonical_subject())
        assert told
        assert len(seen.features) == len(seen.database)


def test_databases_in_memory_leave_nothing_behind(cache: Path) -> None:
    database = PoseDatabase.build([make_motion(1, 300)])
    layout = FeatureLayout.of(canonical_subject())
    metric = Metric(np.ones(3), np.ones(layout.size))
    subject_view(database, layout, chain_of(canonical_subject()), metric)
    assert not cache.exists()


def test_searches_see_what_is_allowed(folder: Path, cache: Path) -> None:
    seen, _ = look(folder, canonical_subject())
    allowed = seen.database.exclude(clip="made-1")
    row = int(np.flatnonzero(seen.targets & allowed)[7])
    past = seen.database.angles[row - np.arange(1, 4)].astype(float)
    query = Query(past, np.ones(3, bool), seen.features[row].astype(float), np.ones(64))
    for mask in (None, allowed):
        search = seen.search(mask)
        assert seen.search(mask, exact=True).is_exact
        targets = seen.targets if mask is None else seen.targets & mask
        plain = PlainSearch(seen.database.angles, np.asarray(seen.features), targets, seen.metric)
        expected = plain.search(query, 50).squared_distances
        np.testing.assert_allclose(
            search.search(query, 50).squared_distances, expected, rtol=2e-4, atol=2e-4
        )


def test_the_least_recently_used_make_room(tmp_path: Path) -> None:
    """Three entries fit."""

    def keep(name: str) -> None:
        cached_arrays(name, lambda: {"a": np.zeros(1000)}, tmp_path, most_bytes=28_000)

    for age, name in enumerate("abc"):
        keep(name)
        os.utime(tmp_path / name, (1000.0 + age, 1000.0 + age))
    keep("a")
    keep("d")
    assert {path.name for path in tmp_path.iterdir()} == {"a", "c", "d"}


def test_digests_tell_values_shapes_and_types_apart() -> None:
    values = [
        digest("a", "b"), digest("ab"), digest(1.0), digest(1),
        digest(np.zeros(4)), digest(np.zeros((2, 2))), digest(np.zeros(4, np.float32)),
    ]  # fmt: skip
    assert len(set(values)) == len(values)
    assert digest(1.5, np.arange(3)) == digest(1.5, np.arange(3))
