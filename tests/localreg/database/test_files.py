"""Databases on disk: written whole or not at all, and refused when something is wrong."""

import errno
import json
from pathlib import Path

import numpy as np
import pytest

from localreg.database import PoseDatabase, files
from localreg.errors import DatabaseError
from tests.localreg.database.made_motion import make_motion

ARRAYS = ("angles", "roots", "clip_index", "offsets", "axis_frames")


@pytest.fixture(scope="module")
def small() -> PoseDatabase:
    return PoseDatabase.build([make_motion(1, 60, name="small")])


@pytest.fixture
def folder(small: PoseDatabase, tmp_path: Path) -> Path:
    small.save(tmp_path / "db")
    return tmp_path / "db"


def change_manifest(folder: Path, **changes: object) -> None:
    """Change a manifest the way a program would, with a checksum that fits."""
    manifest = json.loads((folder / files.MANIFEST).read_text())
    manifest.pop("blake2b")
    manifest.update(changes)
    manifest["blake2b"] = files._json_checksum(manifest)
    (folder / files.MANIFEST).write_text(json.dumps(manifest))


def test_a_new_database_replaces_an_old_one(folder: Path) -> None:
    PoseDatabase.build([make_motion(2, 90, name="other")]).save(folder)
    assert PoseDatabase.load(folder).clips[0].name == "other"
    assert [path.name for path in folder.parent.iterdir()] == ["db"]


def test_an_empty_folder_may_be_filled(small: PoseDatabase, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    small.save(tmp_path / "empty")
    assert len(PoseDatabase.load(tmp_path / "empty")) == len(small)


def test_a_foreign_folder_is_never_replaced(small: PoseDatabase, tmp_path: Path) -> None:
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.txt").write_text("years of work")
    with pytest.raises(DatabaseError, match="is not a pose database; give another folder"):
        small.save(tmp_path / "thesis")
    assert (tmp_path / "thesis" / "chapter.txt").read_text() == "years of work"
    with pytest.raises(DatabaseError, match="is not a pose database"):
        small.save(tmp_path / "thesis" / "chapter.txt")


@pytest.mark.parametrize("failing", ["save", "checksum", "rename"])
def test_a_failure_keeps_the_old_database(
    folder: Path, monkeypatch: pytest.MonkeyPatch, failing: str
) -> None:
    calls = 0

    def full(*_args: object, **_kwargs: object) -> None:
        nonlocal calls
        calls += 1
        if calls == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        return original(*_args, **_kwargs)

    place, name = {
        "save": (np, "save"),
        "checksum": (files, "_checksum"),
        "rename": (Path, "rename"),
    }[failing]
    original = getattr(place, name)
    with monkeypatch.context() as patch:
        patch.setattr(place, name, full)
        with pytest.raises(DatabaseError, match=r"No space left on device.*unchanged"):
            PoseDatabase.build([make_motion(2, 90)]).save(folder)
    assert calls >= 2
    assert PoseDatabase.load(folder, verify=True).clips[0].name == "small"
    assert [path.name for path in folder.parent.iterdir()] == ["db"]


def test_a_place_that_cannot_be_written(small: PoseDatabase, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DatabaseError, match="cannot write the database"):
        small.save(tmp_path / "file" / "db")


@pytest.mark.parametrize("name", ARRAYS)
def test_flipped_bits_are_found(folder: Path, name: str) -> None:
    path = folder / f"{name}.npy"
    data = bytearray(path.read_bytes())
    data[-3] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(DatabaseError, match=rf"damaged: the checksum of {name}\.npy"):
        PoseDatabase.load(folder)
    with pytest.raises(DatabaseError, match="checksum"):
        PoseDatabase.load(folder, verify=True)


@pytest.mark.parametrize("name", ARRAYS)
@pytest.mark.parametrize("verify", [True, False])
def test_truncated_and_missing_arrays_are_found(folder: Path, name: str, verify: bool) -> None:
    path = folder / f"{name}.npy"
    path.write_bytes(path.read_bytes()[:-7])
    with pytest.raises(DatabaseError, match=rf"{name}\.npy has \d+ bytes instead of \d+"):
        PoseDatabase.load(folder, verify=verify)
    path.unlink()
    with pytest.raises(DatabaseError, match=rf"{name}\.npy is missing"):
        PoseDatabase.load(folder, verify=verify)


def test_a_changed_manifest_is_found(folder: Path) -> None:
    path = folder / files.MANIFEST
    path.write_text(path.read_text().replace('"name": "small"', '"name": "Small"', 1))
    with pytest.raises(DatabaseError, match="the checksum of its manifest"):
        PoseDatabase.load(folder)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(DatabaseError, match="is not JSON"):
        PoseDatabase.load(folder)


def test_folders_that_are_no_database(tmp_path: Path) -> None:
    with pytest.raises(DatabaseError, match=r"there is no database at .*localreg db build"):
        PoseDatabase.load(tmp_path / "nowhere")
    with pytest.raises(DatabaseError, match=r"is not a pose database: it has no manifest\.json"):
        PoseDatabase.load(tmp_path)
    (tmp_path / files.MANIFEST).write_text('{"name": "a web app"}')
    with pytest.raises(DatabaseError, match="another program's"):
        PoseDatabase.load(tmp_path)
    (tmp_path / files.MANIFEST).write_text("[]")
    with pytest.raises(DatabaseError, match="another program's"):
        PoseDatabase.load(tmp_path)


def test_other_versions_are_told_apart_from_damage(folder: Path) -> None:
    change_manifest(folder, version=files.VERSION + 1)
    with pytest.raises(DatabaseError, match=r"newer than .* update localreg"):
        PoseDatabase.load(folder)
    change_manifest(folder, version="one")
    with pytest.raises(DatabaseError, match="build the database again"):
        PoseDatabase.load(folder)


def document_without(folder: Path, key: str) -> dict[str, object]:
    document = json.loads((folder / files.MANIFEST).read_text())["document"]
    del document[key]
    return document


@pytest.mark.parametrize("key", ["rate", "settings", "dofs", "clips", "skipped"])
def test_manifests_without_an_entry_are_refused(folder: Path, key: str) -> None:
    change_manifest(folder, document=document_without(folder, key))
    with pytest.raises(DatabaseError, match=f"lacks or garbles '{key}'"):
        PoseDatabase.load(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"start": 1}, "the starts of the clips"),
        ({"length": 19}, "angles, roots, clip_index"),
        ({"skeleton": 9}, "the skeletons"),
        ({"name": 3}, "clip field 'name'"),
        ({"color": "red"}, "color"),
    ],
)
def test_clip_tables_that_do_not_fit_are_refused(
    folder: Path, change: dict[str, object], message: str
) -> None:
    document = json.loads((folder / files.MANIFEST).read_text())["document"]
    document["clips"][0].update(change)
    change_manifest(folder, document=document)
    with pytest.raises(DatabaseError, match=message):
        PoseDatabase.load(folder)


def test_another_skeleton_is_refused(folder: Path) -> None:
    document = json.loads((folder / files.MANIFEST).read_text())["document"]
    document["dofs"] = document["dofs"][::-1]
    change_manifest(folder, document=document)
    with pytest.raises(DatabaseError, match="another skeleton"):
        PoseDatabase.load(folder)


def test_pickled_arrays_are_never_opened(folder: Path) -> None:
    path = folder / "offsets.npy"
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    manifest = json.loads((folder / files.MANIFEST).read_text())
    entry = manifest["arrays"]["offsets"]
    entry.update(bytes=path.stat().st_size, blake2b=files._checksum(path))
    change_manifest(folder, arrays=manifest["arrays"])
    with pytest.raises(DatabaseError, match="is not a plain NumPy array"):
        PoseDatabase.load(folder)


def test_big_databases_are_verified_on_demand(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = folder / "angles.npy"
    data = bytearray(path.read_bytes())
    data[-3] ^= 0x10
    path.write_bytes(data)
    monkeypatch.setattr(files, "SMALL", 1000)
    PoseDatabase.load(folder)
    with pytest.raises(DatabaseError, match="checksum"):
        PoseDatabase.load(folder, verify=True)
