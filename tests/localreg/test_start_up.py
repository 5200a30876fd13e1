"""What the way to the first pose loads: nothing that only other methods and commands need."""

import subprocess
import sys
from pathlib import Path

import pytest

from localreg.database import PoseDatabase
from localreg.motion.formats.sample import read_sample

UNWANTED = (
    "jax", "jaxlib", "equinox", "optimistix", "lineax", "matplotlib", "faiss", "pandas", "av",
    "pooch", "scipy.interpolate", "scipy.optimize", "scipy.stats",
)  # fmt: skip

FOLLOW = """
import sys
from dataclasses import replace
from pathlib import Path
{imports}
from localreg.live.database_choice import choose_database
from localreg.live.warm_up import masked, resting_frame, warm_up
from localreg.synthesis.methods import METHODS, build_synthesizer

chosen = choose_database(Path(sys.argv[1]))
quick = replace(METHODS["localreg"], rehearsals=20)
estimator = build_synthesizer(quick, chosen.subject, chosen.poses)
warm_up(estimator)
frame = resting_frame(estimator.subject)
state, pose = estimator.step(estimator.init(frame), frame)
assert pose.position_residuals.shape == (6,), pose
loaded = [name for name in {unwanted!r} if name in sys.modules]
assert not loaded, f"loaded without need: {{loaded}}"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("start") / "db"
    PoseDatabase.build([motion.first(240) for motion in read_sample()[:3]]).save(place)
    return place


def python(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


@pytest.mark.parametrize(
    "module",
    ["localreg.live.daemon", "localreg.live.demo.run", "localreg.evaluation.worker"],
)
def test_the_default_method_is_built_and_followed_without_jax(folder: Path, module: str) -> None:
    done = python(FOLLOW.format(imports=f"import {module}", unwanted=UNWANTED), str(folder))
    assert done.returncode == 0, done.stderr


def test_what_is_asked_for_by_name_loads_jax_in_double_precision() -> None:
    program = (
        "import sys\n"
        "from localreg.body.subject import canonical_subject\n"
        "from localreg.synthesis.methods import build_estimator\n"
        "from localreg.synthesis.solver import SOLVERS\n"
        "assert 'jax' not in sys.modules\n"
        "assert type(SOLVERS['optimistix']()).__name__ == 'ReferenceSolver'\n"
        "assert 'optimistix' in sys.modules\n"
        "starts = build_estimator('ik', canonical_subject()).prior.prior.starts\n"
        "assert starts.shape == (8, 56) and starts.dtype == 'float64', starts\n"
    )
    done = python(program)
    assert done.returncode == 0, done.stderr


def test_work_of_a_frame_stays_on_its_thread(folder: Path) -> None:
    program = FOLLOW.format(imports="", unwanted=()) + (
        "from threadpoolctl import threadpool_info\n"
        "pools = {pool['filepath']: pool['num_threads'] for pool in threadpool_info()}\n"
        "assert len(pools) > 1, pools\n"
        "assert set(pools.values()) == {1}, pools\n"
    )
    done = python(program, str(folder))
    assert done.returncode == 0, done.stderr
