"""Motion files: one module a format, found by suffix."""

from localreg.motion.formats.registry import ReadOptions as ReadOptions
from localreg.motion.formats.registry import read_motion as read_motion
from localreg.motion.formats.registry import readable_suffixes as readable_suffixes
from localreg.motion.formats.registry import writable_suffixes as writable_suffixes
from localreg.motion.formats.registry import write_motion as write_motion
