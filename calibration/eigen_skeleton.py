"""What lengths people have: the eigen-skeleton, from a published table, ASF files, or both.

The logarithms s of a person's lengths follow

    s = e_0 + sum_h lambda_h e_h + r,   lambda_h ~ N(0, nu_h),   r_b ~ N(0, psi_b)

so that a calibration's penalty on lengths is the sum over `lambda_h^2 / nu_h` and
`r_b^2 / psi_b`, minimized over lambda in closed form. Logarithms, because people differ in
proportion: every length stays positive, and stature alone is one eigenvector.

Few files are shrunk towards the table as a normal-inverse-Wishart prior would, a file that
no person could be (some of CMU's put the knee far too high) counts for little, and how far to
shrink and how many eigenvectors to keep is what predicts left-out files best.
"""

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final, Self

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.anthropometry import (
    ANKLE_HEIGHT,
    CROWN,
    GROUP_COUNT,
    GROUPS,
    group_of_bone,
    published_statistics,
    rows_of,
)
from localreg.body.skeleton import BONE_NAMES
from localreg.body.subject import Subject, canonical_subject
from localreg.errors import LocalregError
from localreg.motion.formats.asf import read_asf

_OWN_SPREAD: Final = 0.01
"""Least spread of a length given all the others: what fits differ by, in logarithms."""

_MEAN_WEIGHTS: Final = (1.0, 3.0, 10.0)
_SPREAD_WEIGHTS: Final = (4.0, 10.0, 20.0, 40.0, 80.0, 160.0)
_VECTORS: Final = (1, 2, 3, 4, 6, 9, 12)

# Of Student's t that files are weighed by: large enough to let people differ.
_TAIL: Final = 5.0
_ODD: Final = 3.0
_ROUNDS: Final = 15
_HIP_DROP: Final = 0.69
"""How far below the root the hips are, as a share of the length of the hips' bone."""


@dataclass(frozen=True, eq=False)
class SkeletonPrior:
    """The distribution of people's lengths; see the module.

    Attributes:
        mean: e_0, mean logarithm of each of the lengths `GROUPS` [log m].
        vectors: e_h, orthonormal, one a column, the greatest variance first.
        variances: nu_h.
        residuals: psi_b, variance of each length beside the vectors.
        sources: what it was learned from, in words.
        odd: names of files that were found to be no person, and count for little.
    """

    mean: Float[ndarray, "18"]
    vectors: Float[ndarray, "18 H"]
    variances: Float[ndarray, " H"]
    residuals: Float[ndarray, "18"]
    sources: str = "published table"
    odd: tuple[str, ...] = ()

    @property
    def covariance(self) -> Float[ndarray, "18 18"]:
        """Of the logarithms of the lengths."""
        return (self.vectors * self.variances) @ self.vectors.T + np.diag(self.residuals)

    @property
    def lengths(self) -> Float[ndarray, "18"]:
        """Lengths of the average person [m]."""
        return np.exp(self.mean)

    @classmethod
    def from_covariance(
        cls,
        mean: Float[ndarray, "18"],
        covariance: Float[ndarray, "18 18"],
        vectors: int,
        sources: str,
        odd: tuple[str, ...] = (),
    ) -> Self:
        """Keep so many eigenvectors, and what is left of every length's own variance."""
        values, directions = np.linalg.eigh(covariance)
        values, directions = values[::-1][:vectors], directions[:, ::-1][:, :vectors]
        left = np.diag(covariance) - (directions**2) @ values
        return cls(mean, directions, values, np.maximum(left, _OWN_SPREAD**2), sources, odd)

    def log_likelihood(self, lengths: Float[ndarray, "n 18"]) -> float:
        """Mean log density of people's lengths [m], per person."""
        away = np.log(lengths) - self.mean
        covariance = self.covariance
        squared = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
        log_volume = np.linalg.slogdet(2.0 * np.pi * covariance)[1]
        return float(np.mean(-0.5 * (squared + log_volume)))

    def at_stature(self, height: float, deviation: float = 0.015) -> Self:
        """The same people, but only those of a height.

        Args:
            height: standing height without shoes [m].
            deviation: what it may be off by, posture included [m].

        Raises:
            LocalregError: nobody is so high.
        """
        check_height(height)
        mean, covariance = self.mean, self.covariance
        for _ in range(5):  # the height of logarithms is not quite linear
            gradient = stature_gradient(mean)
            gain = self.covariance @ gradient
            variance = float(gradient @ gain) + deviation**2
            guess = stature(np.exp(mean)) + float(gradient @ (self.mean - mean))
            mean = self.mean + gain * (height - guess) / variance
            covariance = self.covariance - np.outer(gain, gain) / variance
        sources = f"{self.sources}, {height:.3g} m high"
        return type(self).from_covariance(mean, covariance, GROUP_COUNT, sources, self.odd)


def check_height(height: float) -> None:
    """Refuse a height that is none, most often because of its unit.

    Raises:
        LocalregError: in words that name the likely unit.
    """
    if 1.0 <= height <= 2.5:
        return
    if np.isfinite(height):
        for unit, metres in (("centimeters", 0.01), ("millimeters", 0.001), ("inches", 0.0254)):
            if 1.3 <= height * metres <= 2.3:
                raise LocalregError(
                    f"a height of {height:g} looks like {unit}; give it in meters: "
                    f"{height * metres:.2f}"
                )
    raise LocalregError(f"a height of {height:g} m is nobody's; give it in meters, like 1.75")


def stature(lengths: Float[ndarray, "18"]) -> float:
    """Standing height that lengths make, soles and crown included [m]."""
    upright = float(_UPRIGHT @ lengths)
    return upright / (1.0 - ANKLE_HEIGHT - CROWN)


def stature_gradient(logarithms: Float[ndarray, "18"]) -> Float[ndarray, "18"]:
    """Derivative of `stature` by the logarithms of the lengths [m]."""
    return _UPRIGHT * np.exp(logarithms) / (1.0 - ANKLE_HEIGHT - CROWN)


def _upright() -> Float[ndarray, "18"]:
    weights: dict[str, float] = dict.fromkeys(
        ("femur", "tibia", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"),
        1.0,
    )
    weights["hipjoint"] = _HIP_DROP
    return np.array([weights.get(group, 0.0) for group in GROUPS])


_UPRIGHT: Final = _upright()


def lengths_of(subject: Subject) -> Float[ndarray, "18"]:
    """The lengths `GROUPS` of a subject: left and right by their geometric mean [m]."""
    groups = group_of_bone()
    logarithms = np.log(np.maximum(subject.lengths, 1e-3))
    sums = np.bincount(groups, logarithms, GROUP_COUNT)
    return np.exp(sums / np.bincount(groups, minlength=GROUP_COUNT))


def subject_of(name: str, lengths: Float[ndarray, "18"]) -> Subject:
    """A person of these lengths [m], default directions and default mounts."""
    default = canonical_subject()
    return Subject(name, lengths[group_of_bone()], default.directions, default.axis_frames)


def average_subject(prior: SkeletonPrior) -> Subject:
    """The average person."""
    return subject_of("average", prior.lengths)


def find_skeletons(folder: Path) -> dict[str, Float[ndarray, "18"]]:
    """The lengths of all ASF files below a folder, by file stem [m].

    Raises:
        LocalregError: there is no such folder, or no ASF file in it that can be read.
    """
    if not folder.is_dir():
        raise LocalregError(f"there is no folder {folder}; name one with ASF files")
    found: dict[str, Float[ndarray, 18]] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() == ".asf":
            try:
                found.setdefault(path.stem, lengths_of(read_asf(path).subject))
            except LocalregError:
                continue  # one file that is no skeleton of ours must not spoil the rest
    if not found:
        raise LocalregError(f"no ASF file in {folder} can be read; name a folder with some")
    return found


def published_prior() -> SkeletonPrior:
    """The eigen-skeleton of the table alone."""
    mean, covariance = published_statistics()
    return SkeletonPrior.from_covariance(mean, covariance, GROUP_COUNT, "published table")


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """How an eigen-skeleton is learned.

    Attributes:
        mean_weight: how many files the table's mean counts for.
        spread_weight: how many files the table's covariance counts for.
        vectors: H, eigenvectors kept.
    """

    mean_weight: float
    spread_weight: float
    vectors: int


def learn(
    people: dict[str, Float[ndarray, "18"]], shrinkage: Shrinkage | None = None
) -> SkeletonPrior:
    """The eigen-skeleton of the table and of people's lengths.

    Args:
        people: lengths [m] by name; none at all gives the table's.
        shrinkage: how far to trust either; by default what predicts left-out people best,
            at least three of them.
    """
    if not people:
        return published_prior()
    logarithms = np.log(np.array(list(people.values())))
    weights = _weights(logarithms)
    odd = tuple(name for name, d in zip(people, _distances(logarithms), strict=True) if d > _ODD)
    shrinkage = shrinkage or choose_shrinkage(logarithms, weights)
    mean, covariance = _combined(logarithms, weights, shrinkage)
    sources = f"published table and {len(people)} ASF files"
    return SkeletonPrior.from_covariance(mean, covariance, shrinkage.vectors, sources, odd)


def choose_shrinkage(
    logarithms: Float[ndarray, "n 18"], weights: Float[ndarray, " n"] | None = None
) -> Shrinkage:
    """The shrinkage under which every person is predicted best by the others."""
    weights = _weights(logarithms) if weights is None else weights
    choices = [
        Shrinkage(mean, spread, vectors)
        for mean, spread, vectors in product(_MEAN_WEIGHTS, _SPREAD_WEIGHTS, _VECTORS)
    ]
    if len(logarithms) < 3:
        return Shrinkage(_MEAN_WEIGHTS[1], _SPREAD_WEIGHTS[-1], 3)
    scores = np.zeros(len(choices))
    for left_out in range(len(logarithms)):
        kept = np.arange(len(logarithms)) != left_out
        for mean, spread in product(_MEAN_WEIGHTS, _SPREAD_WEIGHTS):
            rest = _combined(logarithms[kept], weights[kept], Shrinkage(mean, spread, 1))
            for index, choice in enumerate(choices):
                if (choice.mean_weight, choice.spread_weight) == (mean, spread):
                    prior = SkeletonPrior.from_covariance(*rest, choice.vectors, "")
                    likelihood = prior.log_likelihood(np.exp(logarithms[left_out])[None])
                    scores[index] += weights[left_out] * likelihood
    return choices[int(np.argmax(scores))]


def _combined(
    logarithms: Float[ndarray, "n 18"], weights: Float[ndarray, " n"], shrinkage: Shrinkage
) -> tuple[Float[ndarray, "18"], Float[ndarray, "18 18"]]:
    """Mean and predictive covariance under a normal-inverse-Wishart prior at the table."""
    table_mean, table_covariance = published_statistics()
    count, k, v = float(weights.sum()), shrinkage.mean_weight, shrinkage.spread_weight
    average = weights @ logarithms / count
    away = logarithms - average
    apart = average - table_mean
    scatter = (away * weights[:, None]).T @ away
    scatter += k * count / (k + count) * np.outer(apart, apart)
    mean = (k * table_mean + count * average) / (k + count)
    covariance = (v * table_covariance + scatter) / (v + count)
    # The mean itself is known only so well.
    return mean, covariance * (1.0 + 1.0 / (k + count))


def _distances(logarithms: Float[ndarray, "n 18"]) -> Float[ndarray, " n"]:
    """How far each person's proportions are off, in robust deviations of the worst length.

    Only the long bones are asked: hands and feet are fitted poorly in most files.
    """
    long_bones = rows_of(("femur", "tibia", "humerus", "radius"))
    inside = logarithms[:, long_bones]
    if len(inside) < 4:
        table_mean, table_covariance = published_statistics()
        away = inside - table_mean[long_bones]
        deviation = np.sqrt(np.diag(table_covariance)[long_bones])
        return np.abs(away / deviation).max(axis=1)
    middle = np.median(inside, axis=0)
    deviation = 1.4826 * np.median(np.abs(inside - middle), axis=0)
    return np.abs((inside - middle) / np.maximum(deviation, 0.02)).max(axis=1)


def _weights(logarithms: Float[ndarray, "n 18"]) -> Float[ndarray, " n"]:
    """Student-t weights over the whole skeleton, nearly none for files that are no person."""
    count = len(logarithms)
    weights = np.where(_distances(logarithms) > _ODD, 0.05, 1.0)
    if count < 4:
        return weights
    base = weights.copy()
    for _ in range(_ROUNDS):
        mean, covariance = _combined(logarithms, weights, Shrinkage(1.0, 10.0, 1))
        away = logarithms - mean
        squared = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away)
        weights = base * np.minimum(1.0, (_TAIL + GROUP_COUNT) / (_TAIL + squared))
    return weights


def bone_lengths(lengths: Float[ndarray, "18"]) -> dict[str, float]:
    """The 30 bones' lengths by name [m]."""
    return dict(zip(BONE_NAMES, lengths[group_of_bone()].tolist(), strict=True))
