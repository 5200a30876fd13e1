"""Recordings: raw bytes, samples, frames and whatever else, in one MCAP file."""

from sensors.recording.reader import RecordedMessage, read_recording
from sensors.recording.recorder import Channel, Recorder, RecorderCounters

__all__ = ["Channel", "RecordedMessage", "Recorder", "RecorderCounters", "read_recording"]
