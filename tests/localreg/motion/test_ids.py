"""Names of people and recordings, and what an index or a folder says is done in them."""

import pytest

from localreg.errors import MotionError
from localreg.motion.ids import normal_subject, normal_trial, subject_of_trial
from localreg.motion.index import activity_of, read_index

HEAD = "subject\ttrial\tdescription\n"


@pytest.mark.parametrize(
    ("name", "trial", "subject"),
    [
        ("02_01", "02_01", "02"),
        ("2_1", "02_01", "02"),
        ("CMU_016_22", "16_22", "16"),
        ("cmu_135_06", "135_06", "135"),
        (" 002_001 ", "02_01", "02"),
        ("walking_1", "walking_1", ""),
        ("06", "06", ""),
        ("02_01_extra", "02_01_extra", ""),
        ("", "", ""),
    ],
)
def test_normal_forms_of_trials(name, trial, subject):
    assert normal_trial(name) == trial
    assert subject_of_trial(name) == subject
    assert normal_trial(trial) == trial


@pytest.mark.parametrize(
    ("name", "subject"),
    [("2", "02"), ("02", "02"), ("CMU_016", "16"), ("135", "135"), ("u_acrobat88", "u_acrobat88")],
)
def test_normal_forms_of_subjects(name, subject):
    assert normal_subject(name) == subject


def make_file(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


def test_an_index_above_tells_what_is_done(tmp_path):
    (tmp_path / "cmu-index.tsv").write_text(HEAD + "02\t01\twalk\n02\t02\t\n")
    path = make_file(tmp_path / "subjects/02/02_01.amc")
    assert activity_of(path, "02_01", path.parent) == "walk"
    assert activity_of(path, "02_02", path.parent) == ""
    assert activity_of(path, "02_09", path.parent) == ""


def test_a_folder_tells_what_is_done(tmp_path):
    path = make_file(tmp_path / "set/jumping/a.bvh")
    assert activity_of(path, "a", tmp_path) == "jumping"
    assert activity_of(path, "a", path.parent) == ""
    path = make_file(tmp_path / "set/jumping/jumping_1.bvh")
    assert activity_of(path, "jumping_1", path.parent) == "jumping"


@pytest.mark.parametrize("folder", ["02", "subjects", "u_zombie104", "data"])
def test_folders_that_sort_otherwise_tell_nothing(tmp_path, folder):
    path = make_file(tmp_path / folder / "x.amc")
    assert activity_of(path, "x", tmp_path, skeleton="u_zombie104") == ""


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: the columns must be subject, trial, description"),
        ("a\tb\tc\n", "line 1"),
        (HEAD + "02\t01\twalk\n02\n", "line 3: expected 3 columns"),
    ],
)
def test_a_faulty_index_is_an_error(tmp_path, text, message):
    (tmp_path / "cmu-index.tsv").write_text(text)
    with pytest.raises(MotionError, match=message):
        read_index(tmp_path / "cmu-index.tsv")
