"""How well a person's lengths and mounts are known together: what a refinement starts from.

A subject file says how well each number is known by itself. But a shank that comes out too long
brings a tracker's place along, and which sums and differences are known well is half of what a
calibration has found. So the whole covariance goes into a small file beside the subject's.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.anthropometry import GROUP_COUNT, group_of_bone
from calibration.eigen_skeleton import SkeletonPrior, lengths_of
from calibration.model import TURN_UNIT, Beliefs, CalibrationModel, Start
from localreg.body.skeleton import BONE_NAMES
from localreg.body.subject import CalibrationRecord, Subject
from localreg.errors import LocalregError

SUFFIX: Final = ".known.json"
"""In place of a subject file's own: where the rest of what is known of it is."""

UNKNOWN_MOUNT: Final = (0.04, float(np.radians(20.0)))
"""How far off a mount may be of which nothing is said [m], [rad]."""

_VERSION: Final = 1
_SAME: Final = 1e-5


@dataclass(frozen=True, eq=False)
class Knowledge:
    """A Gaussian about a subject's numbers.

    Attributes:
        trackers: names, in the order of the mounts.
        covariance: of the logarithms of the lengths `GROUPS`, of the mounts' positions [m] and of
            their turns about the trackers' axes [rad], tracker by tracker.
    """

    trackers: tuple[str, ...]
    covariance: Float[ndarray, "k k"]

    @property
    def log_lengths(self) -> Float[ndarray, "18 18"]:
        """Covariance of the logarithms of the lengths."""
        return self.covariance[:GROUP_COUNT, :GROUP_COUNT]

    @property
    def position_sd(self) -> Float[ndarray, "J 3"]:
        """Of the mounts' positions in their bones' frames [m]."""
        return self._deviations()[: 3 * len(self.trackers)].reshape(-1, 3)

    @property
    def turn_sd(self) -> Float[ndarray, "J 3"]:
        """Of the mounts' turns about the trackers' axes [rad]."""
        return self._deviations()[3 * len(self.trackers) :].reshape(-1, 3)

    def _deviations(self) -> Float[ndarray, " m"]:
        return np.sqrt(np.diag(self.covariance)[GROUP_COUNT:])

    @classmethod
    def of_shared(
        cls,
        trackers: tuple[str, ...],
        covariance: Float[ndarray, "k k"],
        by_unknowns: Float[ndarray, "k k"],
    ) -> Self:
        """From the covariance of a model's shared unknowns, feet left out.

        Args:
            trackers: their names.
            covariance: of the unknowns.
            by_unknowns: `derivatives` there.
        """
        return cls(trackers, by_unknowns @ covariance @ by_unknowns.T)

    @classmethod
    def of_record(cls, subject: Subject, prior: SkeletonPrior) -> Self:
        """From a subject's record alone: deviations, and the proportions that people have."""
        record = subject.calibration or CalibrationRecord(date="")
        J = len(subject.mounts)
        covariance = np.zeros((GROUP_COUNT + 6 * J, GROUP_COUNT + 6 * J))
        usual = prior.covariance
        groups, lengths = group_of_bone(), lengths_of(subject)
        told = np.zeros(GROUP_COUNT)
        for bone, name in enumerate(BONE_NAMES):
            g = groups[bone]
            deviation = record.length_sd.get(name, np.inf) / lengths[g]
            told[g] = max(1.0 / max(deviation, 1e-4) ** 2 - 1.0 / usual[g, g], 0.0)
        covariance[:GROUP_COUNT, :GROUP_COUNT] = np.linalg.inv(np.linalg.inv(usual) + np.diag(told))
        for j, mount in enumerate(subject.mounts):
            places = record.position_sd.get(mount.tracker, (UNKNOWN_MOUNT[0],) * 3)
            turns = record.orientation_sd.get(mount.tracker, (UNKNOWN_MOUNT[1],) * 3)
            for axis in range(3):
                row = GROUP_COUNT + 3 * j + axis
                covariance[row, row] = max(places[axis], 1e-5) ** 2
                covariance[row + 3 * J, row + 3 * J] = max(turns[axis], 1e-5) ** 2
        return cls(subject.trackers, covariance)

    def without_mounts(self, trackers: set[str]) -> "Knowledge":
        """The same, but nothing known of these trackers' mounts."""
        J = len(self.trackers)
        covariance = self.covariance.copy()
        for j, name in enumerate(self.trackers):
            if name in trackers:
                for first, deviation in zip((3 * j, 3 * (J + j)), UNKNOWN_MOUNT, strict=True):
                    rows = slice(GROUP_COUNT + first, GROUP_COUNT + first + 3)
                    covariance[rows], covariance[:, rows] = 0.0, 0.0
                    covariance[rows, rows] = deviation**2 * np.eye(3)
        return Knowledge(self.trackers, covariance)


def derivatives(
    model: CalibrationModel, shared: Float[ndarray, " s"], beliefs: Beliefs, start: Start
) -> Float[ndarray, "k k"]:
    """Of log lengths, mount positions and turns by a model's shared unknowns, feet left out."""

    def numbers(own: jax.Array) -> jax.Array:
        found = model.outputs(jnp.concatenate([own, jnp.zeros(6)]), beliefs, start)
        return jnp.concatenate([jnp.log(found.lengths), found.positions.ravel()])

    own = jnp.asarray(shared[:-6])
    turns = len(own) - 3 * model.tracker_count
    below = np.zeros((3 * model.tracker_count, len(own)))
    below[:, turns:] = TURN_UNIT * np.eye(3 * model.tracker_count)
    return np.vstack([np.asarray(jax.jacfwd(numbers)(own)), below])


def known_file(subject: Path) -> Path:
    """Where the rest of what is known of a subject is kept."""
    return subject.with_suffix(SUFFIX)


def write_knowledge(knowledge: Knowledge, subject: Subject, path: Path) -> None:
    """Write what is known of a subject beside its file.

    Raises:
        LocalregError: it cannot be written.
    """
    document = {
        "version": _VERSION,
        "trackers": list(knowledge.trackers),
        "numbers": _numbers(subject).tolist(),
        "covariance": knowledge.covariance.tolist(),
    }
    try:
        path.write_text(json.dumps(document), encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write {path}: {reason}") from error


def read_knowledge(subject: Subject, path: Path) -> Knowledge | None:
    """What is known of a subject; None if there is no file, or it is of another subject.

    Raises:
        LocalregError: the file is damaged.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if document["version"] != _VERSION:
            raise ValueError(f"version {document['version']}")
        trackers = tuple(str(name) for name in document["trackers"])
        numbers = np.array(document["numbers"], dtype=float)
        covariance = np.array(document["covariance"], dtype=float)
        size = GROUP_COUNT + 6 * len(trackers)
        if covariance.shape != (size, size) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
            raise ValueError("its covariance is none")
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise LocalregError(
            f"{path} does not say how well a subject is known ({error}); delete it to go by "
            "the subject's own record"
        ) from error
    mine = _numbers(subject)
    if trackers != subject.trackers or mine.shape != numbers.shape:
        return None
    return Knowledge(trackers, covariance) if np.abs(mine - numbers).max() < _SAME else None


def _numbers(subject: Subject) -> Float[ndarray, " n"]:
    """What tells a subject from any other."""
    mounts = [[*mount.position, *mount.quaternion] for mount in subject.mounts]
    return np.concatenate([subject.lengths, np.array(mounts, dtype=float).ravel()])
