"""What rehearsal has taught, kept in the user's cache folder from one start to the next.

Only what was learned from a whole database is kept: with some of it left out, as when its
own clips are played, every run is another one.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.chain import Chain
from localreg.database.cache import cached_arrays, digest, touch
from localreg.synthesis import experience, halves, local_fit, rehearsal, windows
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import Experience, learn, learn_half
from localreg.synthesis.halves import Measured
from localreg.synthesis.settings import Settings
from localreg.synthesis.windows import Inputs, Steps, Windows

_INPUTS: Final = ("noise", "center", "onto")
_WORKED_OUT: Final = (*_INPUTS, "reduced", "unit")
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
    if not _is_whole(source):
        return learn(source, settings, feature_noise, chain)

    def make() -> dict[str, ndarray]:
        found = learn(source, settings, feature_noise, chain)
        step = _parts_of(found.step, "step", _WORKED_OUT)
        pose = _parts_of(found.pose, "pose", _WORKED_OUT)
        return pose | step | _lessons_of(found) | {"steps_root": found.steps.root}

    arrays = cached_arrays(_name(source, settings, chain, feature_noise), make)
    for part in ("pose_reduced", "step_reduced", "steps_root"):
        touch(arrays[part])
    posed = Windows.of(source.database, settings.history, source.features)
    moved = Windows.of(source.database, settings.history)
    return Experience(
        pose=Inputs(windows=posed, **_parts_in(arrays, "pose", _WORKED_OUT)),
        step=Inputs(windows=moved, **_parts_in(arrays, "step", _WORKED_OUT)),
        steps=Steps(arrays["steps_root"], source.angles),
        **_lessons_in(arrays),
    )


def half_over(
    whole: Experience, source: ExampleSource, settings: Settings, chain: Chain, measured: Measured
) -> Experience:
    """What `learn_half` gives, from the cache folder if it was given before."""
    if not _is_whole(source):
        return learn_half(whole, source, settings, chain, measured)

    def make() -> dict[str, ndarray]:
        found = learn_half(whole, source, settings, chain, measured)
        return _parts_of(found.pose, "pose", _INPUTS) | _lessons_of(found)

    facts = map(np.asarray, (whole.pose.noise, *measured))
    arrays = cached_arrays(_name(source, settings, chain, *facts), make)
    pose = Inputs(windows=whole.pose.windows, **_parts_in(arrays, "pose", _INPUTS))
    return replace(whole, pose=pose, **_lessons_in(arrays))


def _is_whole(source: ExampleSource) -> bool:
    """Whether it is a saved database of which nothing is left out."""
    return bool(source.view.name) and np.array_equal(source.targets, source.view.targets)


def _name(source: ExampleSource, settings: Settings, chain: Chain, *facts: ndarray) -> str:
    # Whatever changes the answer is part of the name: the code that gives it, too.
    parts = (experience, rehearsal, halves, windows, local_fit)
    code = [Path(str(part.__file__)).read_bytes() for part in parts]
    return digest(
        source.view.name, repr(settings), *facts, *map(np.asarray, chain),
        *(np.frombuffer(text, np.uint8) for text in code),
    )  # fmt: skip


def _parts_of(inputs: Inputs, kind: str, names: tuple[str, ...]) -> dict[str, ndarray]:
    return {f"{kind}_{name}": getattr(inputs, name) for name in names}


def _parts_in(arrays: dict[str, ndarray], kind: str, names: tuple[str, ...]) -> dict[str, Any]:
    found = {name: arrays[f"{kind}_{name}"] for name in names}
    return {name: part if part.ndim > 1 else part.copy() for name, part in found.items()}


def _lessons_of(found: Experience) -> dict[str, ndarray]:
    learned = {name: getattr(found, name) for name in _LEARNED}
    return learned | {name: np.array([getattr(found, name)]) for name in _NUMBERS}


def _lessons_in(arrays: dict[str, ndarray]) -> dict[str, Any]:
    # Copies, as learned: what is mapped cannot be written to, another type to compile for.
    numbers: dict[str, Any] = {name: float(arrays[name][0]) for name in _NUMBERS}
    return numbers | {name: arrays[name].copy() for name in _LEARNED}
