"""Overrides: what a person knows about motion files that the files do not say.

An overrides file is TOML with one table `[[file]]` for every rule:

    version = 1

    [[file]]
    match = "u_acrobat88/*.amc"    # as in a shell, against the end of the path
    rate = 60                      # frames a second

    [[file]]
    match = "martial/*.bvh"
    up = "z"                       # y or z, the axis that points up
    skeleton_map = "my.toml"       # which joints are which bones; beside this file
    unit = "cm"                    # m, cm, mm, inch, cmu, or metres a unit as a number
    drop_first = 5                 # frames to drop at the head
    drop_last = 0                  # and at the tail
    ignore_dofs = ["lfingers*"]    # joint angles (DOF names) to set to zero
    activity = "martial arts"
    subject = "135"
    trial = "135_06"               # the same for all copies of a recording
    skip = "a reason"              # leave the file out

Where several rules match a file, later ones win, setting by setting.
"""

import tomllib
from fnmatch import fnmatchcase
from pathlib import Path, PurePosixPath
from typing import Annotated, Final, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from localreg.body.skeleton import DOF_NAMES
from localreg.errors import MotionError
from localreg.motion.formats.axes import CMU_UNIT, INCH

UNITS: Final = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": INCH, "cmu": CMU_UNIT}
"""Metres in the length units that have a name."""

_Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
_Count = Annotated[int, Field(ge=0)]


class Settings(BaseModel):
    """What is laid down for one file; None leaves it to the file and the general rules.

    Attributes:
        rate: frames a second [Hz].
        unit: a name of `UNITS`, or metres in a unit [m].
        up: the axis that points up in the file, y or z.
        skeleton_map: a TOML file that says which joints are which bones.
        drop_first: frames to drop at the head.
        drop_last: frames to drop at the tail.
        ignore_dofs: shell patterns of joint angles to set to zero.
        activity: what is done.
        subject: id of the person.
        trial: id of the recording.
        skip: why the file is left out.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    rate: _Positive | None = None
    unit: Literal["m", "cm", "mm", "inch", "cmu"] | _Positive | None = None
    up: Literal["y", "z"] | None = None
    skeleton_map: Path | None = None
    drop_first: _Count | None = None
    drop_last: _Count | None = None
    ignore_dofs: tuple[str, ...] | None = None
    activity: str | None = None
    subject: str | None = None
    trial: str | None = None
    skip: str | None = None

    @field_validator("ignore_dofs")
    @classmethod
    def _check_dofs(cls, patterns: tuple[str, ...] | None) -> tuple[str, ...] | None:
        for pattern in patterns or ():
            if not any(fnmatchcase(name, pattern) for name in DOF_NAMES):
                raise ValueError(f"{pattern!r} matches no joint angle such as 'lfemurrz'")
        return patterns

    @property
    def metres_per_unit(self) -> float | None:
        """Metres in a length unit of the file [m], if laid down."""
        return UNITS[self.unit] if isinstance(self.unit, str) else self.unit

    @property
    def ignored(self) -> tuple[int, ...]:
        """Indices into `DOF_NAMES` of the joint angles to set to zero."""
        patterns = self.ignore_dofs or ()
        return tuple(
            i for i, name in enumerate(DOF_NAMES) if any(fnmatchcase(name, p) for p in patterns)
        )


class Rule(Settings):
    """Settings for all files that a pattern matches.

    Attributes:
        match: shell pattern, compared with the end of the path, `/` between folders.
    """

    match: Annotated[str, Field(min_length=1)]

    def matches(self, path: Path) -> bool:
        """Whether the pattern fits as many last parts of the path as it has itself."""
        pattern = PurePosixPath(self.match).parts
        parts = path.parts[-len(pattern) :]
        return len(parts) == len(pattern) and all(map(fnmatchcase, parts, pattern))


class Overrides(BaseModel):
    """All rules of an overrides file, in their order."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    version: Literal[1] = 1
    file: tuple[Rule, ...] = ()

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read an overrides file.

        Raises:
            MotionError: the file cannot be read or has an entry that is not understood.
        """
        try:
            document = tomllib.loads(path.read_text(encoding="utf-8"))
            return cls.model_validate(document)._beside(path.parent)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise MotionError(f"cannot read overrides file {path}: {reason}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise MotionError(f"{path} is not a TOML file: {error}; correct it") from error
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"])
            raise MotionError(f"{path}: {place}: {first['msg']}; correct this entry") from error

    def _beside(self, folder: Path) -> Self:
        """The same rules with the paths of skeleton maps counted from a folder."""
        rules = [
            rule
            if rule.skeleton_map is None
            else rule.model_copy(update={"skeleton_map": folder / rule.skeleton_map})
            for rule in self.file
        ]
        return self.model_copy(update={"file": tuple(rules)})

    def settings(self, path: Path) -> Settings:
        """What is laid down for one file."""
        merged = {}
        for rule in self.file:
            if rule.matches(path):
                merged |= rule.model_dump(exclude_none=True, exclude={"match"})
        return Settings(**merged)
