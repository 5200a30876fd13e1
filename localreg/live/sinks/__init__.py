"""Listeners: each is handed every pose as it comes."""

from localreg.live.sinks.base import LivePose, Sink
from localreg.live.sinks.collector import Collector
from localreg.live.sinks.motion_file import MotionFile

__all__ = ["Collector", "LivePose", "MotionFile", "Sink"]
