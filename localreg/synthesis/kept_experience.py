"""What rehearsal has taught, kept in the user's cache folder from one start to the next.

Only what was learned from a whole database is kept: with some of it left out, as when its
own clips are played, every run is another one.
"""

from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.chain import Chain
from localreg.database.cache import cached_arrays, digest, touch
from localreg.synthesis import experience, local_fit, windows
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import Experience, learn
from localreg.synthesis.settings import Settings
from localreg.synthesis.windows import Inputs, Raw, Steps, pose_reader, step_reader

_INPUTS: Final = ("noise", "center", "onto", "reduced", "unit")
_LEARNED: Final = (
    "pose_share", "step_share", "pose_growth", "step_growth", "feature_share", "history_share",
    "trust",
)  # fmt: skip
_NUMBERS: Final = ("caution", "usual")


def experience_over(
    source: ExampleSource,
    settings: Settings,
    feature_noise: Float[ndarray, " f"],
    chain: Chain,
) -> Experience:
    """What `learn` gives, from the cache folder if it was given before."""
    view = source.view
    if not view.name or not np.array_equal(source.targets, view.targets):
        return learn(source, settings, feature_noise, chain)
    # Whatever changes the answer is part of the name: the code that gives it, too.
    code = [Path(str(part.__file__)).read_bytes() for part in (experience, windows, local_fit)]
    name = digest(
        view.name, repr(settings), feature_noise, *map(np.asarray, chain),
        *(np.frombuffer(text, np.uint8) for text in code),
    )  # fmt: skip
    arrays = cached_arrays(name, lambda: _arrays_of(learn(source, settings, feature_noise, chain)))
    for part in ("pose_reduced", "step_reduced", "steps_root"):
        touch(arrays[part])
    return _experience_of(arrays, source, settings.history)


def _arrays_of(found: Experience) -> dict[str, ndarray]:
    parts = {
        f"{kind}_{name}": getattr(getattr(found, kind), name)
        for kind in ("pose", "step")
        for name in _INPUTS
    }
    learned = {name: getattr(found, name) for name in _LEARNED}
    numbers = {name: np.array([getattr(found, name)]) for name in _NUMBERS}
    return parts | learned | numbers | {"steps_root": found.steps.root}


def _experience_of(arrays: dict[str, ndarray], source: ExampleSource, history: int) -> Experience:
    database = source.database

    def inputs(kind: str, raw: Raw) -> Inputs:
        return Inputs(raw=raw, **{name: arrays[f"{kind}_{name}"] for name in _INPUTS})

    numbers: dict[str, Any] = {name: float(arrays[name][0]) for name in _NUMBERS}
    return Experience(
        pose=inputs("pose", pose_reader(database, source.features, history)),
        step=inputs("step", step_reader(database, history)),
        steps=Steps(arrays["steps_root"], source.angles),
        **{name: arrays[name] for name in _LEARNED},
        **numbers,
    )
