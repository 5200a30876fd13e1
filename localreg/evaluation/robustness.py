"""The same clips twice, undisturbed and disturbed: how much errors grow, and for how long."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from localreg.database import PoseDatabase
from localreg.errors import MotionError
from localreg.evaluation.execution import Run
from localreg.evaluation.leave_one_out import Progress, evaluate
from localreg.evaluation.metrics import SETTLING_FRAMES
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.recovery import frames_to_recover
from localreg.evaluation.results import ClipResult, Evaluation
from localreg.evaluation.trackers import Loss
from localreg.motion.motion import Motion

LOSS_BEGINS: Final = 1.0
"""When a tracker is lost, from the start of the clip [s]."""

LOSS_LASTS: Final = 1.0
"""How long it is lost [s]."""

_TO_SEE_IT_BACK: Final = 0.5  # what a clip must still have after the loss [s]


@dataclass(frozen=True, slots=True)
class RecoveryFrames:
    """Frames from the end of a disturbance until the MPJPE is within 110 % of the undisturbed.

    Attributes:
        of_means: of the mean over clips, frame by frame.
        half: within how many frames half of the clips are back.
        most: within how many 90 % of them are.
        slowest: of the slowest clip.
    """

    of_means: int
    half: int
    most: int
    slowest: int


@dataclass(frozen=True, slots=True)
class Growth:
    """Means over clips of one method with one kind of signals.

    Attributes:
        disturbance: what was done.
        method: the method's name.
        signals: what trackers measured.
        clips: how many.
        undisturbed_mpjpe_cm: in the frames that count [cm].
        disturbed_mpjpe_cm: in the same frames [cm].
        undisturbed_angle_deg: joint angle error [deg].
        disturbed_angle_deg: the same, disturbed [deg].
        worst_frame_cm: greatest MPJPE of any frame that counts [cm].
        recovery: how soon all is well again; None where the disturbance never ends.
    """

    disturbance: str
    method: str
    signals: str
    clips: int
    undisturbed_mpjpe_cm: float
    disturbed_mpjpe_cm: float
    undisturbed_angle_deg: float
    disturbed_angle_deg: float
    worst_frame_cm: float
    recovery: "RecoveryFrames | None" = None

    @property
    def mpjpe_growth(self) -> float:
        """Growth of the MPJPE as a share of the undisturbed one."""
        return self.disturbed_mpjpe_cm / self.undisturbed_mpjpe_cm - 1.0

    @property
    def angle_growth(self) -> float:
        """Growth of the joint angle error as a share of the undisturbed one."""
        return self.disturbed_angle_deg / self.undisturbed_angle_deg - 1.0


def outlier_growth(
    motions: Sequence[Motion],
    database: PoseDatabase,
    protocol: Protocol,
    run: Run,
    *,
    progress: Progress | None = None,
) -> list[Growth]:
    """What the outliers of a protocol's trackers cost.

    Args:
        motions: as for `evaluate`.
        database: as for `evaluate`.
        protocol: with outliers.
        run: where to run trials.
        progress: is told after every clip.
    """
    quality = protocol.quality
    calm, wild = (
        evaluate(motions, database, variant, run=run, progress=part_of(progress, part, 2))
        for part, variant in enumerate(
            (replace(protocol, quality=replace(quality, outliers=0.0)), protocol)
        )
    )
    name = f"{quality.outliers:.0%} outliers of {100 * quality.outlier_position:.0f} cm"
    return [growth_of(name, one, other, SETTLING_FRAMES, None) for one, other in _alike(calm, wild)]


def loss_growth(
    motions: Sequence[Motion],
    database: PoseDatabase,
    protocol: Protocol,
    run: Run,
    *,
    progress: Progress | None = None,
) -> list[Growth]:
    """What it costs to lose each tracker in turn, and how soon all is well again.

    Args:
        motions: as for `evaluate`; only clips long enough to see the tracker back count.
        database: as for `evaluate`.
        protocol: its trackers must be the same in all clips.
        run: where to run trials.
        progress: is told after every clip.

    Raises:
        MotionError: no clip is long enough.
    """
    least = LOSS_BEGINS + LOSS_LASTS + _TO_SEE_IT_BACK
    limit = np.inf if protocol.max_frames is None else protocol.max_frames / database.rate
    if limit < least:
        raise MotionError(
            f"{protocol.max_frames} frames are too few to lose a tracker and see it back; give "
            f"{int(np.ceil(least * database.rate))} or more"
        )
    long = [motion for motion in motions if motion.seconds >= least]
    if not long:
        raise MotionError(f"no clip lasts {least} s, so none can lose a tracker; give longer ones")
    names = protocol.trackers or long[0].subject.trackers
    calm = evaluate(
        long, database, protocol, run=run, progress=part_of(progress, 0, 1 + len(names))
    )
    begin = round(LOSS_BEGINS * database.rate)
    end = begin + round(LOSS_LASTS * database.rate)
    found = []
    for part, name in enumerate(names, start=1):
        quality = replace(protocol.quality, losses=(Loss(name, LOSS_BEGINS, LOSS_LASTS),))
        lossy = evaluate(
            long, database, replace(protocol, quality=quality),
            run=run, progress=part_of(progress, part, 1 + len(names)),
        )  # fmt: skip
        what = f"{name} lost for {LOSS_LASTS:g} s"
        found += [growth_of(what, one, other, begin, end) for one, other in _alike(calm, lossy)]
    return found


def part_of(progress: Progress | None, part: int, parts: int) -> Progress | None:
    """Progress of one of several evaluations that take about as long as one another."""
    if progress is None:
        return None
    return lambda done, total, what: progress(part * total + done, parts * total, what)


def _alike(
    calm: Evaluation, disturbed: Evaluation
) -> list[tuple[list[ClipResult], list[ClipResult]]]:
    """The clips of both evaluations by method and signals."""
    return [
        (calm.of(method, signals), disturbed.of(method, signals))
        for method, kinds in calm.means().items()
        for signals in kinds
    ]


def growth_of(
    name: str,
    calm: Sequence[ClipResult],
    disturbed: Sequence[ClipResult],
    begin: int,
    end: int | None,
) -> Growth:
    """What a disturbance costs.

    Args:
        name: what was done.
        calm: clips without it.
        disturbed: the same clips with it.
        begin: the first frame that counts.
        end: the first frame after the disturbance; None if it never ends.
    """
    counted = slice(begin, end)

    def mean(clips: Sequence[ClipResult], figure: str) -> float:
        return float(np.mean([getattr(c.comparison, figure)[counted].mean() for c in clips]))

    return Growth(
        disturbance=name,
        method=calm[0].method,
        signals=calm[0].signals,
        clips=len(calm),
        undisturbed_mpjpe_cm=mean(calm, "mpjpe_cm"),
        disturbed_mpjpe_cm=mean(disturbed, "mpjpe_cm"),
        undisturbed_angle_deg=mean(calm, "joint_angle_error_deg"),
        disturbed_angle_deg=mean(disturbed, "joint_angle_error_deg"),
        worst_frame_cm=max(float(c.comparison.mpjpe_cm[counted].max()) for c in disturbed),
        recovery=None if end is None else _recovery(calm, disturbed, end),
    )


def _recovery(
    calm: Sequence[ClipResult], disturbed: Sequence[ClipResult], end: int
) -> RecoveryFrames:
    before, after = ([clip.comparison.mpjpe_cm for clip in clips] for clips in (calm, disturbed))
    frames = [frames_to_recover(a, b, end) for a, b in zip(after, before, strict=True)]
    shortest = min(len(error) for error in before)
    half, most = (int(np.quantile(frames, share, method="inverted_cdf")) for share in (0.5, 0.9))
    return RecoveryFrames(
        of_means=frames_to_recover(
            np.mean([error[:shortest] for error in after], axis=0),
            np.mean([error[:shortest] for error in before], axis=0),
            end,
        ),
        half=half,
        most=most,
        slowest=max(frames),
    )
