"""Which module reads or writes which kind of file, found by suffix.

A format module has `read(path, options) -> list[Motion]` or `write(motion, path)` or both,
and is imported when the first such file is met. Where joints may go by several families of
names, it is `write(motion, path, names)`.
"""

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Final

import numpy as np

from localreg.body.subject import Subject
from localreg.errors import MotionError
from localreg.motion.formats.atomic import written_at_once
from localreg.motion.motion import Motion

DEFAULT_RATE: Final = 120.0
"""Frames a second of files that do not say it: the rate at which CMU recorded [Hz]."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What a reader is told beyond the file; None leaves it to the file.

    Attributes:
        rate: frames a second, whatever the file says [Hz].
        source_rate: frames a second of files that do not say it [Hz].
        metres_per_unit: length of the file's unit [m].
        subject: whose bones move, instead of those that the file brings.
        up: the axis that points up in the file, `"y"` or `"z"`.
        skeleton_map: a TOML file that says which joints are which bones, see
            `localreg.motion.skeleton_maps`.
    """

    rate: float | None = None
    source_rate: float | None = None
    metres_per_unit: float | None = None
    subject: Subject | None = None
    up: str | None = None
    skeleton_map: Path | None = None

    def __post_init__(self) -> None:
        for name in ("rate", "source_rate", "metres_per_unit"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < float("inf"):
                raise MotionError(f"{name} is {value}; it must be a positive number")

    def rate_without_file(self) -> float:
        """The rate of a motion whose file carries none [Hz]."""
        return self.rate or self.source_rate or DEFAULT_RATE


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of motion file.

    Attributes:
        name: what people call it.
        suffixes: the file name endings it goes by, in lower case.
        module: the module that knows it.
        reads: whether it can be read.
        writes: whether it can be written.
        carries_rate: whether its files say their rate.
        writer: the module that writes it, if that is another one.
        families: the families of names that joints can be written with, first the usual one.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    reads: bool = True
    writes: bool = True
    carries_rate: bool = True
    writer: str = ""
    families: tuple[str, ...] = ()


_FAMILIES: Final = ("cmu", "mixamo", "vrm")  # `joint_trees.FAMILIES`, without importing it

_POINTS: Final = "localreg.motion.formats.markers_read"
_OPENSIM: Final = "localreg.motion.formats.opensim_tables"

FORMATS: Final = (
    Format("Acclaim", (".amc",), "localreg.motion.formats.asf_amc", carries_rate=False),
    Format(
        "Biovision",
        (".bvh",),
        "localreg.motion.formats.bvh",
        writer="localreg.motion.formats.bvh_names",
        families=_FAMILIES,
    ),
    Format("glTF", (".glb",), "localreg.motion.formats.gltf", reads=False, families=_FAMILIES),
    Format("C3D", (".c3d",), _POINTS, writer="localreg.motion.formats.c3d_write"),
    Format("OpenSim markers", (".trc",), _POINTS, writer=_OPENSIM),
    Format("OpenSim", (".mot",), "localreg.motion.formats.opensim_read", writer=_OPENSIM),
    Format("SMPL", (".npz",), "localreg.motion.formats.smpl_npz", writes=False),
    Format("MVNX", (".mvnx",), "localreg.motion.formats.mvnx", writes=False),
    Format("recording", (".mcap",), "localreg.motion.formats.recording", writes=False),
    Format("OpenSim model", (".osim",), "localreg.motion.formats.opensim_model", reads=False),
    Format("table", (".csv", ".parquet"), "localreg.motion.formats.angle_tables", reads=False),
)
"""All kinds of motion files."""


def readable_suffixes() -> tuple[str, ...]:
    """Endings of the files that can be read."""
    return tuple(suffix for f in FORMATS if f.reads for suffix in f.suffixes)


def writable_suffixes() -> tuple[str, ...]:
    """Endings of the files that can be written."""
    return tuple(suffix for f in FORMATS if f.writes for suffix in f.suffixes)


def format_of(path: Path) -> Format | None:
    """The kind of a file by its ending, whether it exists or not."""
    return next((f for f in FORMATS if path.suffix.lower() in f.suffixes), None)


def rate_rule(path: Path, options: ReadOptions) -> str:
    """In a few words, which rule gives the rate of the motion in a file."""
    if options.rate is not None:
        return "override"
    form = format_of(path)
    if form is not None and form.carries_rate:
        return "file"
    return "source rate" if options.source_rate is not None else f"default {DEFAULT_RATE:g} Hz"


def read_motion(path: Path | str, options: ReadOptions | None = None) -> list[Motion]:
    """The motions in a file; most kinds hold one.

    Args:
        path: the file; its ending tells the kind.
        options: what to assume beyond the file.

    Raises:
        MotionError: the kind is unknown, or the file cannot be read as it; names the line.
    """
    path = Path(path)
    form = format_of(path)
    if form is None or not form.reads:
        raise MotionError(
            f"cannot read {path}: files ending in {path.suffix or 'nothing'} are not known, "
            f"only {', '.join(readable_suffixes())}"
        )
    return import_module(form.module).read(path, options or ReadOptions())


def write_motion(motion: Motion, path: Path | str, *, names: str | None = None) -> None:
    """Write a motion as the kind of file that the ending tells.

    The file, and those that go with it, take their places only when all are complete, so
    that a failure leaves what was there before.

    Args:
        motion: what to write.
        path: the file; its ending tells the kind.
        names: the family of names that joints go by, of those that the kind knows.

    Raises:
        MotionError: the kind or the family of names is unknown, there is nothing to write,
            or the file cannot be written.
    """
    path = Path(path)
    form = format_of(path)
    if form is None or not form.writes:
        raise MotionError(
            f"cannot write {path}: files ending in {path.suffix or 'nothing'} are not known, "
            f"only {', '.join(writable_suffixes())}"
        )
    if names is not None and names not in form.families:
        known = f"those of {', '.join(form.families)}" if form.families else "names of their own"
        raise MotionError(f"cannot write {path} with names of {names}: such files have {known}")
    name = motion.provenance.name
    if not len(motion):
        raise MotionError(f"motion {name} has no frames; there is none to write")
    bad = np.flatnonzero(~np.isfinite(motion.qpos).all(axis=1))
    if bad.size:
        raise MotionError(f"motion {name}: frame {bad[0]} has a number that is not finite; mend it")
    module = import_module(form.writer or form.module)
    try:
        with written_at_once(path) as temporary:
            if form.families:
                module.write(motion, temporary, names or form.families[0])
            else:
                module.write(motion, temporary)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise MotionError(f"cannot write {path}: {reason}; choose another place") from error
