"""Every number of the method, with its unit and what it was chosen by.

Defaults were chosen on every sixth clip of the sample set (leave one clip out, from the
second), and on a collection of CMU files, of which every report holds all; benchmarks/README.md
says which on what.
"""

from dataclasses import dataclass, replace
from math import radians
from typing import Final

from localreg.errors import SynthesisError


@dataclass(frozen=True)
class Settings:
    """What an estimator is made with.

    Attributes:
        prior: `"localreg"` (the best known here), `"paper"` (the published method),
            `"joint"` (its variant with one decomposition for all outputs), `"lpcr"` and
            `"lpca"` (earlier published ones, see `baselines`) or `"ik"` (no database).
        neighbours: K, the examples of every frame.
        history: m, the past poses that a window holds.
        sigma_position: what a tracker's position is believed to be off by [m].
        sigma_orientation: the same for orientation [rad].
        lorentzian: c of the Lorentzian; larger is closer to plain squares.
        max_steps: cap of solver steps a frame.
        max_steps_acquire: cap where the pose is found from nothing.
        rank: r, the principal directions kept (paper, joint, lpcr, lpca).
        floor: least standard deviation of a predicted joint angle [rad].
        components: principal directions that regression inputs are reduced to.
        history_noise: what reconstructed joint angles are off by before rehearsal has told
            better [rad].
        feature_position_noise: what feature positions are off by [m].
        feature_rotation_noise: what entries of feature rotation matrices are off by.
        pose_information: share of the pose regression's information that is new in each
            frame; its errors last for about the inverse in frames.
        pose_ridge: of the pose regression, whose inputs are in units of their noise.
        step_ridge: of the step regression.
        step_noise: what the past's joint angles are off by, for the step [rad].
        drift_memory: share of the step regression's error that is still there a frame later.
        step_floor_position: least standard deviation of the root's step [m].
        step_floor_angle: least standard deviation of any angle's step [rad].
        strangeness: what a joint angle may be off by where neighbours are twice as far (squared)
            as those of nine in ten database poses, as a share of its anatomical range.
        rehearsals: database poses that trust in the regressions is learned from.
        bearable_surprise: squared distance of the neighbours, in units of the usual and as a
            running mean, beyond which another pose is sought beside the present one;
            if infinite, none is followed beside a first pose, either.
        bearable_strain: squared error of a tracker in units of its sigma beyond which, where it
            lasts, the tracker is heard again and the prior fades.
        metric_history: weight of each lag's joint angles in the search [1/rad].
        search_by_trackers: whether neighbours must agree with the present trackers, too;
            where there is no past they always must.
        metric_position: weight of feature positions in the search [1/m].
        metric_rotation: weight of feature rotation entries in the search.
        root_position: deviation of the root from constant velocity where no step is
            predicted [m].
        root_orientation: the same [rad].
        previous_pose: pull to the previous pose (ik) [rad].
        limit_softness: how far beyond a joint's range is one standard deviation [rad]; the
            range is anatomy's (ik) or the database's (localreg).
        smoothness: deviation of q_t - 2 q_(t-1) + q_(t-2) (lpca) [rad].
        solver: one of `localreg.synthesis.solver.SOLVERS`.
    """

    prior: str = "localreg"
    neighbours: int = 80
    history: int = 3
    sigma_position: float = 0.005
    sigma_orientation: float = radians(0.65)
    lorentzian: float = 9.0
    max_steps: int = 16
    max_steps_acquire: int = 40
    rank: int = 10
    floor: float = radians(1.0)
    components: int = 24
    history_noise: float = radians(2.0)
    feature_position_noise: float = 0.006
    feature_rotation_noise: float = 0.012
    pose_information: float = 0.15
    pose_ridge: float = 10.0
    step_ridge: float = 100.0
    step_noise: float = radians(2.0)
    drift_memory: float = 0.75
    step_floor_position: float = 0.001
    step_floor_angle: float = radians(0.05)
    strangeness: float = 0.055
    rehearsals: int = 1200
    bearable_surprise: float = 0.7
    bearable_strain: float = 9.0
    metric_history: tuple[float, ...] = (0.6, 0.3, 0.15)
    search_by_trackers: bool = True
    metric_position: float = 2.0
    metric_rotation: float = 0.5
    root_position: float = 0.1
    root_orientation: float = 0.3
    previous_pose: float = radians(6.0)
    limit_softness: float = radians(1.0)
    smoothness: float = radians(3.0)
    solver: str = "compiled"

    def __post_init__(self) -> None:
        if self.prior not in PRIORS:
            raise SynthesisError(
                f"there is no prior {self.prior!r}; choose one of {', '.join(PRIORS)}"
            )
        if len(self.metric_history) != self.history:
            raise SynthesisError(
                f"metric_history needs one weight for each of the {self.history} past poses"
            )


PRIORS: Final = ("localreg", "paper", "joint", "ik", "lpcr", "lpca")
"""Names of the priors."""

# What the rivals were tuned with.
_RIVAL: Final = replace(
    Settings(), sigma_position=0.004, sigma_orientation=radians(1.0), metric_position=3.0
)

_PUBLISHED: Final = replace(
    _RIVAL,
    metric_history=(1.0, 0.5, 0.25),
    search_by_trackers=False,
    neighbours=100,
    rank=6,
    floor=radians(8.0),
)

METHODS: Final[dict[str, Settings]] = {
    "localreg": Settings(),
    # What benchmarks/tune_baselines.py found best for walks and other motion together; what is
    # best for each alone is in benchmarks/rivals.toml.
    "paper": replace(_PUBLISHED, prior="paper"),
    "joint": replace(_PUBLISHED, prior="joint"),
    "lpcr": replace(_PUBLISHED, prior="lpcr", search_by_trackers=True),
    "lpca": replace(
        _PUBLISHED,
        prior="lpca",
        search_by_trackers=True,
        neighbours=400,
        rank=40,
        floor=radians(0.5),
        smoothness=radians(25.0),
    ),
    "ik": replace(
        _RIVAL,
        prior="ik",
        neighbours=0,
        limit_softness=radians(3.0),
        previous_pose=radians(12.0),
        root_position=0.02,
    ),
}
"""The settings of every method that can be asked for by name."""
