"""A bad day of the line, for trying out what the session does about it."""

from localreg.errors import LocalregError

SHORTEST = 10.0
"""Time that all the faults need [s]."""

_SILENCE = 3.0
_JUMP = 1.0


def bad_day(seconds: float) -> tuple[str, ...]:
    """Faults over a run, as the emulator reads them.

    From a tenth to three tenths of the time junk bytes and truncated records; at 0.35 the
    third tracker is off by 30 cm for a second; at 0.5 the line is silent for 3 s.

    Args:
        seconds: duration of the run [s].

    Raises:
        LocalregError: it is too short for them.
    """
    if seconds < SHORTEST:
        raise LocalregError(f"line noise needs {SHORTEST:g} s to show; give --seconds {SHORTEST:g}")
    noisy = f"start={0.1 * seconds:.3f},duration={0.2 * seconds:.3f}"
    return (
        f"junk,{noisy},probability=0.1",
        f"truncation,{noisy},probability=0.05",
        f"jump,station=3,start={0.35 * seconds:.3f},duration={_JUMP:g},dz=0.3",
        f"silence,start={0.5 * seconds:.3f},duration={_SILENCE:g}",
    )
