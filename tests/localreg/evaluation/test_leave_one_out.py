"""The protocol: what is kept from the database, what is played, and in which order."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from localreg.database import PoseDatabase
from localreg.errors import LocalregError, MotionError, SubjectError, SynthesisError
from localreg.evaluation import execution
from localreg.evaluation import worker as worker_module
from localreg.evaluation.leave_one_out import evaluate
from localreg.evaluation.metrics import FIGURES
from localreg.evaluation.protocol import SHORTEST, Protocol, plan_trials
from localreg.evaluation.results import Evaluation
from localreg.motion.motion import Motion
from tests.localreg.database.made_motion import make_motion
from tests.localreg.evaluation.standing import Builder, Standing


@pytest.fixture(scope="module")
def motions() -> list[Motion]:
    walk = make_motion(1, 150, name="walk", subject="01", trial="01_01", activity="walk")
    # The same recording in another file, cut and under another name.
    copy = make_motion(1, 150, name="copy", subject="09", activity="other")
    copy = replace(copy, qpos=copy.qpos[12:])
    run = make_motion(2, 120, name="run", subject="01", trial="01_02", activity="run")
    stroll = make_motion(3, 90, name="stroll", subject="02", trial="02_01", activity="walk")
    return [walk, copy, run, stroll]


@pytest.fixture(scope="module")
def database(motions: list[Motion]) -> PoseDatabase:
    return PoseDatabase.build(motions)


@pytest.fixture
def builder(monkeypatch: pytest.MonkeyPatch) -> Builder:
    builder = Builder()
    monkeypatch.setattr(worker_module, "build_estimator", builder)
    return builder


def seen(database: PoseDatabase, allowed: np.ndarray | None) -> set[str]:
    """Names of the clips of which any pose could be seen, mirror images under their own."""
    assert allowed is not None
    return {database.clips[i].name for i in np.unique(database.clip_index[allowed])}


def with_images(*names: str) -> set[str]:
    return {*names, *(name + "-mirrored" for name in names)}


@pytest.mark.parametrize(
    ("leave_out", "expected"),
    [
        ("clip", [{"run", "stroll"}, {"run", "stroll"}, {"walk", "copy", "stroll"},
                  {"walk", "copy", "run"}]),
        ("subject", [{"stroll"}, {"run", "stroll"}, {"stroll"}, {"walk", "copy", "run"}]),
        ("activity", [{"run"}, {"run", "stroll"}, {"walk", "copy", "stroll"}, {"run"}]),
    ],
)  # fmt: skip
def test_no_method_ever_sees_the_test_its_image_or_a_copy(
    motions: list[Motion],
    database: PoseDatabase,
    builder: Builder,
    leave_out: str,
    expected: list[set[str]],
) -> None:
    for motion, names in zip(motions, expected, strict=True):
        builder.asked.clear()
        protocol = Protocol(methods=("localreg", "paper"), leave_out=leave_out)  # type: ignore[arg-type]
        trials, _ = plan_trials([motion], database, protocol)
        worker_module.Worker(database).run(trials[0], protocol)
        assert {method for method, _, _ in builder.asked} == {"localreg", "paper"}
        for _, _, allowed in builder.asked:
            assert seen(database, allowed) == with_images(*names)


def test_masks_change_from_clip_to_clip(
    motions: list[Motion], database: PoseDatabase, builder: Builder
) -> None:
    evaluate(motions, database, Protocol(methods=("localreg",), signals=("both", "position")))
    assert builder.built == ["localreg"], "compiled once, then masked anew"
    masks = [seen(database, allowed) for _, what, allowed in builder.asked if what == "init"]
    # One for warming up, then two kinds of signals for each of four clips.
    assert len(masks) == 1 + 2 * 4
    assert {frozenset(mask) for mask in masks} == {
        frozenset(with_images("run", "stroll")),
        frozenset(with_images("walk", "copy", "stroll")),
        frozenset(with_images("walk", "copy", "run")),
    }


def test_copies_are_kept_out_of_a_database_of_its_own_too(
    motions: list[Motion], builder: Builder
) -> None:
    walk, copy, run, stroll = motions
    others = PoseDatabase.build([copy.mirrored(), stroll, run])
    evaluate([walk], others, Protocol(methods=("paper",), leave_out=None))
    for _, _, allowed in builder.asked:
        assert seen(others, allowed) == with_images("run", "stroll")
    unknown = make_motion(77, 100, name="unknown")
    builder.asked.clear()
    evaluate([unknown], others, Protocol(methods=("paper",), leave_out=None))
    assert builder.asked[0][2] is not None
    assert builder.asked[0][2].all()


@pytest.mark.parametrize(("start", "first"), [("cold", "init"), ("truth", "init_at")])
def test_methods_start_as_they_are_told(
    motions: list[Motion], database: PoseDatabase, builder: Builder, start: str, first: str
) -> None:
    protocol = Protocol(methods=("ik",), signals=("both",), start=start, max_frames=12)
    evaluate(motions[:1], database, protocol)
    what = [asked for _, asked, _ in builder.asked]
    warm, played = what[:3], what[3:]
    assert warm == ["init", "step 0", "step 1"]
    assert played[0] == first
    frames = played[1:]
    if start == "cold":
        # The pose of the first frame comes from a step that is then forgotten.
        assert frames[0] == "step 0"
        frames = frames[1:]
    assert frames == [f"step {i}" for i in range(11)]


def test_everything_is_in_its_order_and_of_its_length(
    motions: list[Motion], database: PoseDatabase, builder: Builder
) -> None:
    told: list[tuple[int, int, str]] = []
    evaluation = evaluate(
        motions,
        database,
        Protocol(methods=("paper", "ik"), signals=("position", "both"), seed=4),
        progress=lambda *state: told.append(state),
    )
    names = [motion.provenance.name for motion in motions]
    assert [(c.method, c.signals, c.name) for c in evaluation.clips] == [
        (method, signals, name)
        for method in ("paper", "ik")
        for signals in ("position", "both")
        for name in names
    ]
    lengths = {m.provenance.name: len(m.resampled(40.0)) for m in motions}
    assert all(clip.frames == lengths[clip.name] for clip in evaluation.clips)
    assert all(len(clip.step_ms) == clip.frames - 1 for clip in evaluation.clips)
    assert all(clip.comparison.mpjpe_cm.shape == (clip.frames,) for clip in evaluation.clips)
    assert [done for done, _, _ in told] == sorted(done for done, _, _ in told)
    assert told[-1][0] == told[-1][1] == 4 * sum(lengths.values())


def test_the_contract_key_by_key(
    motions: list[Motion], database: PoseDatabase, builder: Builder
) -> None:
    protocol = Protocol(methods=("localreg", "ik"), signals=("both", "orientation"), seed=3)
    document = evaluate(motions, database, protocol).to_json()
    assert list(document) == ["schema", "settings", "clips", "mean", "timing", "conditions"]
    assert document["schema"] == 1
    assert document["settings"] == {
        "rate_hz": 40.0,
        "seed": 3,
        "start": "cold",
        "noise_position_m": 0.003,
        "noise_orientation_deg": pytest.approx(0.5),
        "database": "leave-out clip",
        "version": document["settings"]["version"],
    }
    assert len(document["clips"]) == 2 * 2 * len(motions)
    for clip in document["clips"]:
        assert list(clip)[:11] == ["name", "frames", "method", "signals", *FIGURES]
        assert isinstance(clip["frames"], int)
        for name in FIGURES:
            assert clip[name] is None or np.isfinite(clip[name])
    assert list(document["mean"]) == list(document["timing"]) == ["localreg", "ik"]
    for method, kinds in document["mean"].items():
        assert list(kinds) == ["both", "orientation"]
        for signals, figures in kinds.items():
            assert list(figures) == list(FIGURES)
            clips = [
                c for c in document["clips"] if (c["method"], c["signals"]) == (method, signals)
            ]
            for name in FIGURES[:6]:
                assert figures[name] == pytest.approx(np.mean([c[name] for c in clips])), name
    for timing in document["timing"].values():
        assert list(timing) == ["p50_ms", "p99_ms", "frames_per_s"]
        assert 0.0 < timing["p50_ms"] <= timing["p99_ms"]
        assert timing["frames_per_s"] > 0.0


def test_what_is_not_a_number_is_null(
    motions: list[Motion], database: PoseDatabase, builder: Builder
) -> None:
    evaluation = evaluate(motions[:1], database, Protocol(methods=("ik",), signals=("both",)))
    clip = evaluation.clips[0]
    spoiled = replace(clip.comparison.figures, mpjpe_cm=float("nan"), foot_skate_cm_s=None)
    clip = replace(clip, comparison=replace(clip.comparison, figures=spoiled), step_ms=np.zeros(0))
    document = Evaluation(evaluation.settings, (clip,)).to_json()
    for figures in (document["clips"][0], document["mean"]["ik"]["both"]):
        assert figures["mpjpe_cm"] is None
        assert figures["foot_skate_cm_s"] is None
        assert figures["jitter_m_s3"] > 0.0
    assert set(document["timing"]["ik"].values()) == {None}


def test_short_clips_are_no_tests_but_may_be_learned_from(
    motions: list[Motion], builder: Builder
) -> None:
    short = make_motion(8, SHORTEST - 1, rate=40.0, name="short")
    database = PoseDatabase.build([*motions, short])
    protocol = Protocol(methods=("paper",), signals=("both",))
    evaluation = evaluate([*motions, short], database, protocol)
    assert evaluation.too_short == ("short",)
    assert {clip.name for clip in evaluation.clips} == {"walk", "copy", "run", "stroll"}
    assert any("short" in seen(database, allowed) for _, _, allowed in builder.asked)
    with pytest.raises(MotionError, match=f"no clip has the {SHORTEST} frames"):
        evaluate([short], database, protocol)


def test_fewer_trackers(motions: list[Motion], database: PoseDatabase, builder: Builder) -> None:
    protocol = Protocol(methods=("ik",), signals=("both",), trackers=("head", "rhand"))
    trials, _ = plan_trials(motions, database, protocol)
    assert all(trial.motion.subject.trackers == ("head", "rhand") for trial in trials)
    with pytest.raises(SubjectError, match="no tracker named tail"):
        plan_trials(motions, database, replace(protocol, trackers=("tail",)))


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        (lambda: Protocol(signals=("all",)), "choose among both, position, orientation"),
        (lambda: Protocol(start="warm"), "choose among cold, truth"),
        (lambda: Protocol(methods=("ik", "ik")), "every method once"),
        (lambda: Protocol(methods=()), "at least one"),
        (lambda: Protocol(seed=-1), "seed is -1"),
        (lambda: Protocol(max_frames=5), "give 9 or more"),
    ],
)
def test_impossible_protocols_are_refused(attempt: Callable[[], Protocol], message: str) -> None:
    with pytest.raises(SynthesisError, match=message):
        attempt()


def test_what_cannot_be_evaluated_says_why(motions: list[Motion], builder: Builder) -> None:
    lonely = PoseDatabase.build(motions[:1])
    with pytest.raises(SynthesisError, match="without clip walk nothing is left"):
        evaluate(motions[:1], lonely, Protocol(methods=("localreg",)))
    assert evaluate(motions[:1], lonely, Protocol(methods=("ik",))).clips
    nameless = make_motion(4, 100, name="nameless")
    database = PoseDatabase.build([*motions, nameless])
    with pytest.raises(MotionError, match="nameless does not say its subject"):
        evaluate([nameless], database, Protocol(methods=("localreg",), leave_out="subject"))
    with pytest.raises(SynthesisError, match="no method named magic; choose among localreg"):
        evaluate(motions, database, Protocol(methods=("magic",)))


def test_a_process_that_dies_is_reported(
    motions: list[Motion], database: PoseDatabase, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(execution, "_run_in_process", _die)
    with pytest.raises(LocalregError, match="a process of the evaluation died"):
        evaluate(motions, database, Protocol(methods=("ik",)), jobs=2)


def _die(*trial: object) -> None:
    import os

    os._exit(1)


def test_estimators_are_kept_for_clips_that_come_again(
    motions: list[Motion],
    database: PoseDatabase,
    builder: Builder,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    left_out: list[int] = []
    real = Standing.leave_out

    def count(self: Standing, allowed: np.ndarray) -> Standing:
        left_out.append(int(allowed.sum()))
        return real(self, allowed)

    monkeypatch.setattr(Standing, "leave_out", count)
    protocol = Protocol(methods=("paper",), signals=("both",), max_frames=12)
    trials, _ = plan_trials(motions, database, protocol)
    distinct = len({trial.left_out for trial in trials})
    worker = worker_module.Worker(database)
    for _ in range(3):
        for trial in trials:
            builder.asked.clear()
            worker.run(trial, protocol)
            assert builder.asked[-1][2] is not None
            np.testing.assert_array_equal(builder.asked[-1][2], trial.allowed(database))
    assert builder.built == ["paper"]
    assert len(left_out) == distinct - 1
    monkeypatch.setattr(worker_module, "_POSES_KEPT", 0)
    left_out.clear()
    worker = worker_module.Worker(database)
    for trial in [*trials, *trials]:
        worker.run(trial, protocol)
    assert len(left_out) > distinct, "of a large database only the last one is kept"
