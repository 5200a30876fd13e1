"""What an evaluation found, and the JSON that other programs rely on."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray

from localreg.errors import LocalregError
from localreg.evaluation.metrics import Comparison, Figures, mean_figures

SCHEMA: Final = 1
"""Version of the JSON contract."""


@dataclass(frozen=True, eq=False)
class ClipResult:
    """One method on one clip with one kind of signals.

    Attributes:
        name: the clip's.
        frames: how many were played, those that do not count included.
        method: the method's name.
        signals: `both`, `position` or `orientation`.
        comparison: the figures, and the errors frame by frame.
        step_ms: how long each step took [ms].
        subject: who moves; empty if unknown.
        activity: what is done; empty if unknown.
        recovery_s: how long errors outlast dropouts [s]; None without any.
        qpos: the synthesized poses, if they were to be kept.
    """

    name: str
    frames: int
    method: str
    signals: str
    comparison: Comparison
    step_ms: Float[ndarray, " steps"]
    subject: str = ""
    activity: str = ""
    recovery_s: float | None = None
    qpos: Float32[ndarray, "frames 63"] | None = None

    @property
    def figures(self) -> Figures:
        """The figures of the contract."""
        return self.comparison.figures


@dataclass(frozen=True, slots=True)
class Settings:
    """What the figures depend on, as the contract names it.

    Attributes:
        rate_hz: frames a second [Hz].
        seed: of the simulated noise.
        start: `cold` or `truth`.
        noise_position_m: standard deviation on each axis [m].
        noise_orientation_deg: standard deviation of each rotation component [deg].
        database: folder of the training set, or what was left out of the clips themselves.
        version: of this program.
    """

    rate_hz: float
    seed: int
    start: str
    noise_position_m: float
    noise_orientation_deg: float
    database: str
    version: str


@dataclass(frozen=True, slots=True)
class Timing:
    """How long a method takes for a frame.

    Attributes:
        p50_ms: median [ms].
        p99_ms: 99th percentile [ms].
        frames_per_s: frames a second of stepping, one after another.
    """

    p50_ms: float | None
    p99_ms: float | None
    frames_per_s: float | None

    @classmethod
    def of(cls, step_ms: Float[ndarray, " steps"]) -> "Timing":
        """The timing of some steps; nothing is known of none."""
        if not step_ms.size:
            return cls(None, None, None)
        p50, p99 = np.percentile(step_ms, [50, 99])
        return cls(float(p50), float(p99), float(1e3 / step_ms.mean()))


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All results, ordered by method, signals and clip.

    Attributes:
        settings: what they depend on.
        clips: one entry for every clip, method and kind of signals.
        too_short: names of clips that were no test.
        conditions: whatever else they depend on.
    """

    settings: Settings
    clips: tuple[ClipResult, ...]
    too_short: tuple[str, ...] = ()
    conditions: Mapping[str, Any] = field(default_factory=dict)

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods in their order."""
        return tuple(dict.fromkeys(clip.method for clip in self.clips))

    def of(self, method: str, signals: str | None = None) -> list[ClipResult]:
        """The results of one method, with one kind of signals or all."""
        return [
            clip for clip in self.clips if clip.method == method and signals in (None, clip.signals)
        ]

    def means(self) -> dict[str, dict[str, Figures]]:
        """Unweighted means over clips, by method and signals."""
        means: dict[str, dict[str, Figures]] = {}
        for method in self.methods:
            kinds = dict.fromkeys(clip.signals for clip in self.of(method))
            means[method] = {
                signals: mean_figures([clip.figures for clip in self.of(method, signals)])
                for signals in kinds
            }
        return means

    def timing(self) -> dict[str, Timing]:
        """Timing over all frames of a method."""
        return {
            method: Timing.of(np.concatenate([clip.step_ms for clip in self.of(method)]))
            for method in self.methods
        }

    def to_json(self) -> dict[str, Any]:
        """The contract: plain values, None where a figure could not be had.

        `summaries.to_json` adds what is worked out from these figures.
        """
        document = {
            "schema": SCHEMA,
            "settings": asdict(self.settings),
            "clips": [
                {
                    "name": clip.name,
                    "frames": clip.frames,
                    "method": clip.method,
                    "signals": clip.signals,
                    **asdict(clip.figures),
                    "subject": clip.subject,
                    "activity": clip.activity,
                    "true_jitter_m_s3": clip.comparison.true_jitter_m_s3,
                    "true_foot_skate_cm_s": clip.comparison.true_foot_skate_cm_s,
                    "standardized_error": clip.comparison.standardized_error,
                    "recovery_s": clip.recovery_s,
                }
                for clip in self.clips
            ],
            "mean": {
                method: {signals: asdict(figures) for signals, figures in kinds.items()}
                for method, kinds in self.means().items()
            },
            "timing": {method: asdict(timing) for method, timing in self.timing().items()},
            **({"conditions": self.conditions} if self.conditions else {}),
        }
        return without_nan(document)


def without_nan(value: Any) -> Any:
    """The same plain values with None for every number that is not finite."""
    if isinstance(value, Mapping):
        return {key: without_nan(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_nan(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(document: Mapping[str, Any], path: Path) -> None:
    """Write a JSON document; an older file stays until the new one is complete.

    Raises:
        LocalregError: the file cannot be written.
    """
    text = json.dumps(document, indent=1, allow_nan=False) + "\n"
    temporary = path.with_name(f".{path.name}.part")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write {path}: {reason}; choose another place") from error


def program_version() -> str:
    """The version of this program; `unknown` if it runs without being installed."""
    try:
        return version("localreg-mocap")
    except PackageNotFoundError:
        return "unknown"
