"""Streams of single samples to frames: all trackers at one instant, at a fixed rate.

**The trade.** Let T be the frame period, Ts the sample period and d the delay allowed after
a frame's instant. To interpolate, a sample at or after the instant must have arrived, and
with a phase that nobody controls that takes up to Ts plus the transport: 25 ms at 40 Hz. A
delay of 12.5 ms would thus leave half of all phases to extrapolation, which amplifies noise
(half a period ahead: 1.6 times; a whole one: 2.2 times, against at most 1 inside).

So the assembler does three things instead of waiting:

1. *It locks the phase.* If the samples come at the rate of the frames, the grid of instants
   drifts, by at most 1 % of a period a frame, until it lies on the sample times. A frame is
   then complete when its last station has arrived, and interpolation has nothing to do. If
   the stations of one instant take longer than d to cross the line (six at 115200 baud:
   20 ms), the grid settles that much behind the samples, and a few milliseconds are
   extrapolated instead of a whole period lost. At any other rate (52 Hz, say) the phase of
   the samples turns, the lock sees that and leaves the grid alone; then Ts < T, and what
   remains to extrapolate is at most Ts plus the time on the line less d.
2. *It closes early.* A frame closes as soon as every living tracker has a sample at the
   instant or within `tolerance` before it; `delay` is only the worst case. No frame waits
   for a tracker that has been silent for longer than `stale_after`.
3. *It does not coast.* Beyond `max_extrapolation` from the newest sample a tracker is masked:
   the prior of the synthesis knows better than a straight line. The default, 95 % of a
   period, admits a full line (52 Hz, 17 ms on the way, d = 12.5 ms: at most 24 ms), but a
   lost sample of a 40 Hz stream is masked.

Outliers pass: telling them from motion is the business of the robust energy downstream. Two
trackers that exchange their places pass, too, but are reported.
The core is pure (`push`, `poll` with a given time), holds no thread and reads no clock.
"""

import cmath
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from sensors import rotation
from sensors.errors import ConfigurationError
from sensors.history import TrackerHistory
from sensors.placement import RoomTransform
from sensors.pose import PoseSample, TrackerFrame
from sensors.settings import Settings
from sensors.swaps import SwapDetector

_LOCK_SMOOTHING = 1.0 / 64.0
_LOCK_CONCENTRATION = 0.9
_LOCK_GAIN = 0.1
_LOCK_MAX_STEP = 0.01
_LAG_QUANTILE = 0.95
_LAG_STEP = 0.02
_LAG_MARGIN = 0.08


class AssemblerConfig(Settings):
    """Settings; times that are None follow from the rate.

    Attributes:
        rate: frames a second [Hz].
        delay: longest wait after a frame's instant for its samples [s].
        tolerance: a sample this little before the instant completes a frame [s]; default a
            tenth of a period.
        max_extrapolation: farthest from its newest sample a tracker is still reported [s];
            default 95 % of a period, at most one period.
        max_gap: longest pause between two samples that is still bridged [s]; default four
            periods.
        stale_after: a tracker silent for longer is not waited for [s]; default two and a
            half periods.
        max_skew: a sample this far in the future of its own arrival is refused [s].
        min_quality: samples of this quality or less are refused; 0 is a lost tracker.
        lock_phase: let the grid of instants settle on the sample times.
        max_backlog: if nobody polled for this many periods, older frames are skipped.
        swap_distance: two trackers that both jump farther than this, each to where the
            other was expected, are reported as swapped [m].

    Raises:
        ConfigurationError: a value that cannot be.
    """

    rate: float = Field(default=40.0, gt=0.0, le=1000.0)
    delay: float = Field(default=0.0125, ge=0.0, le=1.0)
    tolerance: float | None = Field(default=None, ge=0.0)
    max_extrapolation: float | None = Field(default=None, ge=0.0)
    max_gap: float | None = Field(default=None, gt=0.0)
    stale_after: float | None = Field(default=None, gt=0.0)
    max_skew: float = Field(default=0.1, ge=0.0)
    min_quality: float = Field(default=0.0, ge=0.0, lt=1.0)
    lock_phase: bool = True
    max_backlog: int = Field(default=8, ge=1)
    swap_distance: float = Field(default=0.15, gt=0.0)

    @classmethod
    def title_of(cls, values: Mapping[str, Any]) -> str:
        """The table of a configuration file."""
        return "assembler"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.max_extrapolation is not None and self.max_extrapolation > 1.0 / self.rate:
            raise ValueError(
                f"max_extrapolation is {self.max_extrapolation} s; give 0 to one period, "
                f"{1.0 / self.rate:.4g} s: longer pauses are masked, not coasted over"
            )
        return self


@dataclass(frozen=True, slots=True)
class AssembledFrame:
    """A frame and how it came about.

    Attributes:
        frame: all trackers at one instant.
        newest_arrival: when the newest sample that contributed had arrived [s], host clock;
            NaN if none did. Latency counts from here.
        closed_at: the `now` at which the frame was closed [s].
        index: number of the instant since the first; a gap is a skipped frame.
        swaps: pairs of trackers that seem to have changed places since the frame before.
    """

    frame: TrackerFrame
    newest_arrival: float
    closed_at: float
    index: int
    swaps: tuple[tuple[str, str], ...] = ()

    def placed(self, transform: RoomTransform) -> "AssembledFrame":
        """The same frame in the room."""
        frame = self.frame
        positions, quaternions = transform.apply(frame.positions, frame.quaternions)
        return replace(self, frame=frame._replace(positions=positions, quaternions=quaternions))


@dataclass(slots=True)
class AssemblerCounters:
    """What became of samples and frames; only grows.

    Attributes:
        samples: accepted.
        late: accepted, but after the frame they belonged to had closed.
        out_of_order: accepted or not, older than the newest of their tracker.
        duplicates: refused, same tracker and time as one before.
        not_finite: refused, not a number, or no orientation.
        unknown: refused, no such tracker in the configuration.
        lost: refused, of no quality.
        skewed: refused, from the future or from before all memory.
        frames: closed.
        skipped_frames: never closed because nobody polled.
        interpolated: tracker entries between two samples, or on one.
        extrapolated: tracker entries past the newest sample by more than the tolerance.
        masked: tracker entries without a value.
        swaps: pairs of trackers that changed places.
    """

    samples: int = 0
    late: int = 0
    out_of_order: int = 0
    duplicates: int = 0
    not_finite: int = 0
    unknown: int = 0
    lost: int = 0
    skewed: int = 0
    frames: int = 0
    skipped_frames: int = 0
    interpolated: int = 0
    extrapolated: int = 0
    masked: int = 0
    swaps: int = 0

    @property
    def dropped(self) -> int:
        """Samples that were refused."""
        return self.duplicates + self.not_finite + self.unknown + self.lost + self.skewed


@dataclass(slots=True)
class _PhaseLock:
    """Where in the period the samples fall, and how long after it they arrive.

    The place is kept as the mean of unit phasors: its length tells a settled phase (1) from
    a turning one (0), its angle the place. The lag is a running 95 % quantile, for a single
    hiccup of the host must not move the grid. All in periods.
    """

    mean: complex = 0j
    count: int = 0
    lag: float = 0.0

    def observe(self, phase: float, lag: float) -> None:
        """Take one sample: its place after a grid instant, its arrival after its time."""
        self.count += 1
        weight = max(_LOCK_SMOOTHING, 1.0 / self.count)
        self.mean += weight * (cmath.exp(2j * math.pi * phase) - self.mean)
        self.lag += _LAG_STEP * (_LAG_QUANTILE if lag > self.lag else _LAG_QUANTILE - 1.0)

    def offset(self, delay: float) -> float:
        """How far behind its sample an instant should lie so that the sample makes it."""
        if abs(self.mean) < _LOCK_CONCENTRATION:
            return 0.0
        return min(0.5, max(0.0, self.lag + _LAG_MARGIN - delay))

    def step(self, delay: float) -> float:
        """How far to move the grid now; 0 while the phase turns."""
        if abs(self.mean) < _LOCK_CONCENTRATION:
            return 0.0
        error = cmath.phase(self.mean) / (2.0 * math.pi) + self.offset(delay)
        error -= round(error)
        shift = min(_LOCK_MAX_STEP, max(-_LOCK_MAX_STEP, _LOCK_GAIN * error))
        self.mean *= cmath.exp(-2j * math.pi * shift)
        return shift


@dataclass(slots=True)
class _Grid:
    """Instants of the frames. `next` is the instant of the frame to close next."""

    period: float
    next: float = math.nan
    index: int = 0
    lock: _PhaseLock = field(default_factory=_PhaseLock)


class FrameAssembler:
    """Assembles samples of J trackers into frames.

    Args:
        trackers: names in the order of the frame's rows.
        config: settings.

    Raises:
        ConfigurationError: if names are missing or repeated.
    """

    def __init__(self, trackers: Sequence[str], config: AssemblerConfig | None = None) -> None:
        self.config = config or AssemblerConfig()
        self.trackers = tuple(trackers)
        self.counters = AssemblerCounters()
        if not self.trackers or len(set(self.trackers)) != len(self.trackers):
            raise ConfigurationError(
                f"trackers are {', '.join(self.trackers) or 'none'}; name each exactly once"
            )
        c, T = self.config, 1.0 / self.config.rate
        self.period = T
        self._tolerance = 0.1 * T if c.tolerance is None else c.tolerance
        self._max_extrapolation = 0.95 * T if c.max_extrapolation is None else c.max_extrapolation
        self._max_gap = 4.0 * T if c.max_gap is None else c.max_gap
        self._stale_after = 2.5 * T if c.stale_after is None else c.stale_after
        self._rows = {name: j for j, name in enumerate(self.trackers)}
        self._histories = [TrackerHistory() for _ in self.trackers]
        self._grid = _Grid(T)
        self._swaps = SwapDetector(self.trackers, c.swap_distance)
        J = len(self.trackers)
        self._positions = np.zeros((J, 3))
        self._quaternions = np.tile(rotation.IDENTITY, (J, 1))

    @property
    def deadline(self) -> float:
        """When the next frame closes at the latest [s]; infinite before the first sample."""
        return math.inf if math.isnan(self._grid.next) else self._grid.next + self.config.delay

    def newest(self, tracker: str) -> float:
        """Time of the newest sample of a tracker [s], -inf before the first."""
        return self._histories[self._rows[tracker]].newest

    def push(self, sample: PoseSample, arrival: float | None = None) -> bool:
        """Take one sample.

        Args:
            sample: a pose of one tracker, in any order.
            arrival: when the host had its last byte [s]; default its own time.

        Returns:
            Whether it was accepted; the counters say why not.
        """
        arrived = sample.time if arrival is None else arrival
        row = self._rows.get(sample.tracker)
        if row is None:
            self.counters.unknown += 1
            return False
        norm = float(np.linalg.norm(sample.quaternion))
        if not (
            math.isfinite(sample.time)
            and bool(np.isfinite(sample.position).all())
            and math.isfinite(norm)
            and norm > 1e-6
        ):
            self.counters.not_finite += 1
            return False
        if sample.quality <= self.config.min_quality:
            self.counters.lost += 1
            return False
        history, grid = self._histories[row], self._grid
        if sample.time > arrived + self.config.max_skew:
            self.counters.skewed += 1
            return False
        if sample.time < history.newest:
            self.counters.out_of_order += 1
        inserted = history.insert(sample.time, sample.position, sample.quaternion / norm, arrived)
        if inserted == "duplicate":
            self.counters.duplicates += 1
            return False
        if inserted == "forgotten":
            self.counters.skewed += 1
            return False
        self.counters.samples += 1
        if math.isnan(grid.next):
            grid.next = sample.time
        elif sample.time <= grid.next - self.period and grid.index > 0:
            self.counters.late += 1
        if self.config.lock_phase:
            phase = (sample.time - grid.next) / self.period
            grid.lock.observe(phase, (arrived - sample.time) / self.period)
        return True

    def poll(self, now: float) -> list[AssembledFrame]:
        """Close the frames that are complete or due.

        Args:
            now: the host's monotonic time [s].

        Returns:
            Closed frames, oldest first; usually none or one, at most `max_backlog`.
        """
        grid, closed = self._grid, []
        if math.isnan(grid.next):
            return closed
        overdue = math.floor((now - self.deadline) / self.period) - self.config.max_backlog + 1
        if overdue > 0:
            self.counters.skipped_frames += overdue
            grid.index += overdue
            grid.next += overdue * self.period
        while len(closed) < self.config.max_backlog and (
            now >= self.deadline or self._is_complete(now)
        ):
            closed.append(self._close(now))
        return closed

    def _is_complete(self, now: float) -> bool:
        # A frame whose instant lies well ahead of now is never complete: its samples
        # carry a wrong clock.
        instant = self._grid.next
        if instant > now + self.config.max_skew:
            return False
        # Before the first frame nobody is known to be absent: give all of them `delay`.
        if self._grid.index == 0 and not all(map(len, self._histories)):
            return False
        alive = [h.newest for h in self._histories if h.newest >= instant - self._stale_after]
        offset = self._grid.lock.offset(self.config.delay / self.period) * self.period
        return bool(alive) and min(alive) >= instant - self._tolerance - offset

    def _close(self, now: float) -> AssembledFrame:
        grid, counters = self._grid, self.counters
        t, J = grid.next, len(self.trackers)
        mask: NDArray[np.bool_] = np.zeros(J, dtype=np.bool_)
        newest_arrival = -math.inf
        p_older, p_newer = self._positions.copy(), self._positions.copy()
        q_older, q_newer = self._quaternions.copy(), self._quaternions.copy()
        fractions = np.zeros(J)
        for j, history in enumerate(self._histories):
            bracket = history.at(t, self._tolerance, self._max_extrapolation, self._max_gap)
            if bracket is None:
                counters.masked += 1
                continue
            p_older[j], q_older[j] = bracket.older
            p_newer[j], q_newer[j] = bracket.newer
            fractions[j] = bracket.fraction
            mask[j] = True
            newest_arrival = max(newest_arrival, bracket.arrival)
            if t - history.newest > self._tolerance:
                counters.extrapolated += 1
            else:
                counters.interpolated += 1
        f = fractions[:, None]
        self._positions = (1.0 - f) * p_older + f * p_newer
        self._quaternions = rotation.slerp(q_older, q_newer, fractions)
        # Copies: the frame is the caller's, ours hold the last value for masked entries.
        frame = TrackerFrame(t, self._positions.copy(), self._quaternions.copy(), mask, mask.copy())
        swaps = self._swaps.observe(t, self._positions, mask)
        assembled = AssembledFrame(
            frame, newest_arrival if mask.any() else math.nan, now, grid.index, swaps
        )
        counters.frames += 1
        counters.swaps += len(swaps)
        grid.index += 1
        shift = grid.lock.step(self.config.delay / self.period) if self.config.lock_phase else 0.0
        grid.next = t + (1.0 + shift) * self.period
        return assembled
