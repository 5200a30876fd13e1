"""A small database of real walks, estimators over it, and one walk that it lacks."""

from collections.abc import Callable, Iterator

import jax
import pytest

from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.playback import play
from localreg.evaluation.trackers import SimulatedTrackers, simulate_trackers
from localreg.motion.motion import Motion
from localreg.motion.sources import read_sources
from localreg.synthesis.methods import build_estimator
from localreg.synthesis.synthesizer import Synthesizer
from tests.localreg.synthesis.sessions import RATE, Session

TEST_CLIP = "16_31"
KNOWN_CLIPS = ("16_22", "16_25", "16_28", "16_32", "16_34", "16_47", "69_01", "69_20")


@pytest.fixture(scope="session", autouse=True)
def compiled_code(request: pytest.FixtureRequest) -> Iterator[None]:
    """Estimators take a quarter of a minute each to compile: keep that between runs."""
    before = (
        jax.config.jax_compilation_cache_dir,
        jax.config.jax_persistent_cache_min_compile_time_secs,
    )
    cache = request.config.cache
    if cache is not None and before[0] is None:
        jax.config.update("jax_compilation_cache_dir", str(cache.mkdir("compiled")))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
    yield
    jax.config.update("jax_compilation_cache_dir", before[0])
    jax.config.update("jax_persistent_cache_min_compile_time_secs", before[1])


@pytest.fixture(scope="session")
def walks() -> dict[str, Motion]:
    motions, _ = read_sources(["sample"])
    return {motion.provenance.name: motion.resampled(RATE) for motion in motions}


@pytest.fixture(scope="session")
def database(walks: dict[str, Motion]) -> PoseDatabase:
    return PoseDatabase.build((walks[name] for name in KNOWN_CLIPS), rate=RATE)


@pytest.fixture(scope="session")
def walk(walks: dict[str, Motion]) -> Motion:
    """A walk that the database does not hold."""
    return walks[TEST_CLIP]


@pytest.fixture(scope="session")
def subject(walk: Motion) -> Subject:
    return walk.subject


@pytest.fixture(scope="session")
def body(subject: Subject) -> BodyPoints:
    return BodyPoints(subject)


@pytest.fixture(scope="session")
def trackers(walk: Motion, body: BodyPoints) -> SimulatedTrackers:
    """What its six trackers report, as noisy as in evaluations."""
    return simulate_trackers(walk, truth=body.tracker_poses(walk.qpos))


@pytest.fixture(scope="session")
def estimator_of(subject: Subject, database: PoseDatabase) -> Callable[[str], Synthesizer]:
    """Estimators by method, each built once."""
    known: dict[str, Synthesizer] = {}

    def get(method: str) -> Synthesizer:
        if method not in known:
            known[method] = build_estimator(method, subject, database)
        return known[method]

    return get


@pytest.fixture(scope="session")
def localreg(estimator_of: Callable[[str], Synthesizer]) -> Synthesizer:
    return estimator_of("localreg")


@pytest.fixture(scope="session")
def undisturbed(
    localreg: Synthesizer, walk: Motion, trackers: SimulatedTrackers, body: BodyPoints
) -> Session:
    """The walk synthesized from its first frame on, with nothing going wrong."""
    return Session(walk.qpos, body, play(localreg, trackers).poses)
