"""The database of poses: stored, checked, searched."""

from localreg.database.clips import Clip
from localreg.database.store import PoseDatabase

__all__ = ["Clip", "PoseDatabase"]
