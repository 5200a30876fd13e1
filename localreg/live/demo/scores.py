"""How good a live run was, clip by clip, in the terms of every evaluation."""

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.metrics import SETTLING_FRAMES, compare
from localreg.evaluation.results import ClipResult, Evaluation, Settings, Timing, without_nan
from localreg.live.demo.playlist import Playlist
from localreg.live.session import Session
from localreg.live.sinks import Collector
from localreg.motion.motion import Motion, Provenance


@dataclass(frozen=True, eq=False)
class LiveScore:
    """A run against the truth.

    Attributes:
        evaluation: clips in the order of playing, and their means.
        timing: of the estimator.
        live: the part of the JSON contract that only a live run has.
        truth: true poses at the instants of the frames.
        synthesis: what was shown at the same instants.
        joint_angle_error: frame by frame [rad]; NaN where a clip settles.
        mpjpe: frame by frame [m]; NaN where a clip settles.
        held: frames that showed an earlier pose.
    """

    evaluation: Evaluation
    timing: Timing
    live: dict[str, Any]
    truth: Motion
    synthesis: Motion
    joint_angle_error: Float[ndarray, " frames"]
    mpjpe: Float[ndarray, " frames"]
    held: Bool[ndarray, " frames"]

    def to_json(self) -> dict[str, Any]:
        """The contract: plain values, None where a figure could not be had."""
        document = self.evaluation.to_json()
        document["timing"] = dict.fromkeys(self.evaluation.methods, asdict(self.timing))
        return without_nan({**document, "live": self.live})


def score(
    playlist: Playlist, collected: Collector, zero: float, settings: Settings, method: str
) -> LiveScore:
    """Compare a run with what was played.

    Every instant from the first to the last counts, a frame that never came with the pose
    that stayed. The first frames of each clip count for time only.

    Args:
        playlist: what was played.
        collected: what was published; at least one pose.
        zero: host's monotonic time of the playlist's first row [s].
        settings: what the figures depend on.
        method: the estimator's name.
    """
    synthesis = collected.motion(playlist.subject, playlist.rate, "synthesis")
    rows = collected.rows_on_grid()
    instants = np.arange(len(rows)) + collected.indices[0]
    times = collected.times[rows] + (instants - collected.indices[rows]) / playlist.rate - zero
    clip_of = np.array([playlist.clip_at(t) for t in times])
    body = BodyPoints(playlist.subject)
    truth = np.empty_like(synthesis.qpos)
    angle_error, mpjpe = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
    results = []
    for clip in np.unique(clip_of):
        here = np.flatnonzero(clip_of == clip)
        truth[here] = playlist.truth(int(clip), times[here])
        played = playlist.clips[clip]
        comparison = compare(replace(played, qpos=truth[here]), synthesis.qpos[here], body=body)
        counted = here[SETTLING_FRAMES:]
        angle_error[counted] = np.radians(comparison.joint_angle_error_deg[SETTLING_FRAMES:])
        mpjpe[counted] = 0.01 * comparison.mpjpe_cm[SETTLING_FRAMES:]
        name = played.provenance.name
        results.append(ClipResult(name, len(here), method, "both", comparison, np.zeros(0)))
    return LiveScore(
        evaluation=Evaluation(settings, tuple(results)),
        timing=Timing(None, None, None),
        live={},
        truth=Motion(truth, playlist.rate, playlist.subject, Provenance("live demo")),
        synthesis=synthesis,
        joint_angle_error=angle_error,
        mpjpe=mpjpe,
        held=collected.held[rows],
    )


def with_counts(scored: LiveScore, session: Session) -> LiveScore:
    """The score with what the session counted and timed."""
    counters = session.counters
    live = {
        "frames": counters.frames,
        "late_frames": counters.late_frames,
        "dropped_samples": session.dropped_samples,
        "latency_p50_ms": 1e3 * counters.latency.percentile(50.0),
        "latency_p99_ms": 1e3 * counters.latency.percentile(99.0),
        "buffer_ms": 1e3 * session.buffer,
    }
    timing = Timing.of(1e3 * counters.compute.values)
    return replace(scored, live=live, timing=timing)
