"""Simulated people whom the tests calibrate, and who they are."""

from functools import cache

import numpy as np

from calibration.eigen_skeleton import published_prior
from calibration.poses import EIGHT_POSES
from calibration.simulated import Habits, held, perform, random_person
from localreg.body.subject import canonical_subject

TRACKERS = canonical_subject().mounts
PRIOR = published_prior()

PERFECT = Habits(pose_error=1e-4, plant_error=3e-5, frames=320)
"""Nobody: joints as asked for, feet that never move, noisy trackers averaged over 8 s."""

USUAL = Habits()
"""Joints turned by 5 deg, feet that stay within 4 mm."""


def lengths(seed):
    """Lengths of somebody from the published table [m]."""
    rng = np.random.default_rng((seed, 7))
    return np.exp(rng.multivariate_normal(PRIOR.mean, PRIOR.covariance))


@cache
def somebody(seed, habits=USUAL):
    """A person, how they hold the eight poses, and what the trackers say."""
    rng = np.random.default_rng((seed, 8))
    person = random_person(lengths(seed), TRACKERS, habits.mount_spread, rng)
    qpos = perform(person, EIGHT_POSES, habits, rng)
    return person, qpos, tuple(held(person, EIGHT_POSES, qpos, habits, rng))
