"""People's lengths: the table, learning from files, odd files, heights."""

import numpy as np
import pytest

from calibration.anthropometry import (
    GROUPS,
    NINE_BONES,
    SEGMENTS,
    group_of_bone,
    published_statistics,
    stature_statistics,
)
from calibration.eigen_skeleton import (
    Shrinkage,
    average_subject,
    choose_shrinkage,
    find_skeletons,
    learn,
    lengths_of,
    published_prior,
    stature,
    subject_of,
)
from localreg.body.skeleton import BONE_NAMES
from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.motion.formats.asf import format_asf


def crowd(count, seed=0):
    """People with one strong habit of their own: long legs go with short backs."""
    prior = published_prior()
    rng = np.random.default_rng(seed)
    rows = rng.multivariate_normal(prior.mean, 0.3 * prior.covariance, count)
    legs = [GROUPS.index(name) for name in ("femur", "tibia")]
    back = [GROUPS.index(name) for name in NINE_BONES["back"]]
    longer = rng.normal(scale=0.08, size=count)
    rows[:, legs] += longer[:, None]
    rows[:, back] -= longer[:, None]
    return {f"p{i}": np.exp(row) for i, row in enumerate(rows)}


def test_every_length_is_in_the_table_once():
    parts = [part for segment in SEGMENTS for part in segment.parts]
    assert sorted(parts) == sorted(GROUPS)
    mean, covariance = published_statistics()
    assert np.all(np.linalg.eigvalsh(covariance) > 0)
    assert 1.65 < stature(np.exp(mean)) < 1.75
    assert stature_statistics() == pytest.approx((1.6925, 0.0921), abs=1e-3)


def test_left_and_right_share_a_length():
    groups = group_of_bone()
    for index, name in enumerate(BONE_NAMES):
        assert name.endswith(GROUPS[groups[index]])
    subject = subject_of("x", np.arange(1.0, 19.0))
    np.testing.assert_allclose(lengths_of(subject), np.arange(1.0, 19.0))


def test_learning_predicts_new_people_better_than_the_table():
    people, others = crowd(24), crowd(30, seed=1)
    new = np.array(list(others.values()))
    assert learn(people).log_likelihood(new) > published_prior().log_likelihood(new) + 1.0


def test_few_files_do_no_harm():
    people, others = crowd(3), crowd(30, seed=1)
    new = np.array(list(others.values()))
    assert learn(people).log_likelihood(new) > published_prior().log_likelihood(new) - 0.5
    assert learn({}).sources == "published table"


def test_more_files_are_trusted_more():
    new = np.array(list(crowd(30, seed=1).values()))
    likelihoods = [learn(crowd(count)).log_likelihood(new) for count in (4, 24)]
    assert np.all(np.diff(likelihoods) > 0.0)


def test_the_choice_is_the_one_that_predicts_left_out_people_best():
    rows = np.log(np.array(list(crowd(10).values())))
    best = choose_shrinkage(rows)

    def score(shrinkage):
        names = [f"p{i}" for i in range(len(rows))]
        people = dict(zip(names, np.exp(rows), strict=True))
        return np.mean([
            learn({n: p for n, p in people.items() if n != out}, shrinkage).log_likelihood(
                people[out][None]
            )
            for out in names
        ])  # fmt: skip

    for other in (Shrinkage(1.0, 4.0, 1), Shrinkage(10.0, 160.0, 12)):
        assert score(best) > score(other) - 0.3


def test_an_odd_file_is_named_and_counts_for_little():
    people = crowd(12)
    clean = learn(people, Shrinkage(1.0, 10.0, 3))
    odd = next(iter(people.values())).copy()
    odd[GROUPS.index("femur")] *= 0.6
    odd[GROUPS.index("tibia")] *= 1.4
    spoiled = learn({**people, "odd": odd}, Shrinkage(1.0, 10.0, 3))
    assert "odd" in spoiled.odd
    assert "odd" not in clean.odd
    assert np.abs(spoiled.mean - clean.mean).max() < 0.01
    assert np.abs(spoiled.covariance - clean.covariance).max() < 0.15 * clean.covariance.max()


def test_eigenvectors_are_orthonormal_and_sorted():
    prior = learn(crowd(20))
    H = len(prior.variances)
    np.testing.assert_allclose(prior.vectors.T @ prior.vectors, np.eye(H), atol=1e-12)
    assert np.all(np.diff(prior.variances) <= 0)
    assert np.all(prior.residuals > 0)


@pytest.mark.parametrize("height", [1.5, 1.72, 1.95])
def test_a_known_height_is_kept(height):
    prior = published_prior()
    tall = prior.at_stature(height)
    assert stature(tall.lengths) == pytest.approx(height, abs=0.01)
    assert np.trace(tall.covariance) < np.trace(prior.covariance)
    assert np.all(np.linalg.eigvalsh(tall.covariance) > 0)


@pytest.mark.parametrize(
    ("height", "words"),
    [(178.0, "centimeters"), (1780.0, "millimeters"), (70.0, "inches"), (5.0, "nobody"),
     (float("nan"), "nobody"), (-1.0, "nobody")],
)  # fmt: skip
def test_a_height_in_another_unit_is_named(height, words):
    with pytest.raises(LocalregError, match=words):
        published_prior().at_stature(height)


def test_files_are_found_and_bad_ones_skipped(tmp_path):
    folder = tmp_path / "deep" / "er"
    folder.mkdir(parents=True)
    (folder / "07.asf").write_text(format_asf(canonical_subject()))
    (tmp_path / "bad.ASF").write_text("nothing")
    found = find_skeletons(tmp_path)
    assert list(found) == ["07"]
    np.testing.assert_allclose(found["07"], lengths_of(canonical_subject()), rtol=1e-6)
    with pytest.raises(LocalregError, match="no folder"):
        find_skeletons(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LocalregError, match="no ASF"):
        find_skeletons(tmp_path / "empty")


def test_real_files_are_predicted_better_than_by_the_table(motions_dir):
    people = find_skeletons(motions_dir)
    whole = learn(people)
    assert "u_pirouette05" in whole.odd
    gains = []
    for name in set(people) - set(whole.odd):
        rest = {other: row for other, row in people.items() if other != name}
        person = people[name][None]
        gains.append(learn(rest).log_likelihood(person) - published_prior().log_likelihood(person))
    assert np.mean(gains) > 3.0


def test_the_average_person_wears_default_trackers():
    average = average_subject(published_prior())
    assert average.trackers == canonical_subject().trackers
