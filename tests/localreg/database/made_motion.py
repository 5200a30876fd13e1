"""Smooth motion that resembles no other: made of sines with seeded amplitudes."""

import numpy as np

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import canonical_subject
from localreg.motion.motion import Motion, Provenance

UPRIGHT = (0.5**0.5, 0.5**0.5, 0.0, 0.0)


def make_motion(
    seed: int,
    frames: int = 240,
    rate: float = 120.0,
    *,
    name: str | None = None,
    amplitude: float = 0.3,
    **provenance: str,
) -> Motion:
    rng = np.random.default_rng(seed)
    seconds = np.arange(frames)[:, None] / rate
    angles = np.zeros((frames, 56))
    for harmonic in (1, 2, 3):
        phase = rng.uniform(0.0, 2.0 * np.pi, 56) + 2.0 * np.pi * 0.8 * harmonic * seconds
        angles += rng.normal(size=56) * amplitude / harmonic * np.sin(phase)
    qpos = np.zeros((frames, QPOS_SIZE))
    qpos[:, 0:1] = seconds
    qpos[:, 2] = 1.0
    qpos[:, 3:7] = UPRIGHT
    qpos[:, 7:] = angles
    return Motion(qpos, rate, canonical_subject(), Provenance(name or f"made-{seed}", **provenance))
