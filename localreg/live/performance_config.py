"""Settings of a performance; a module of its own, for reading them must not import JAX."""

from pydantic import Field

from sensors.settings import Settings


class PerformanceConfig(Settings):
    """When to step, when to hold, when to begin anew; see `localreg.live.performance`.

    Attributes:
        coast: longest time without any tracker that the estimator bridges by itself [s].
        patience: frames in a row that may fail before the body is found anew.
        min_trackers: so many trackers must be measured to find a body from one frame; all
            of them if a subject wears fewer.
        max_waiting: frames that may go by while a body is being found.
    """

    coast: float = Field(default=0.1, ge=0.0)
    patience: int = Field(default=8, ge=1)
    min_trackers: int = Field(default=3, ge=1)
    max_waiting: int = Field(default=4, ge=0)
