"""A recording as the motion of an emulator."""

from pathlib import Path

import numpy as np

from sensors import rotation
from sensors.emulators.source import Playback
from sensors.errors import PlaybackError
from sensors.recording import schemas
from sensors.recording.reader import read_recording
from sensors.recording.replay import read_configuration


def load_motion(path: Path) -> Playback:
    """A playback file, or the frames of a recording (`.mcap`).

    Where a tracker was masked it stays where it was, for an emulator has faults of its own.

    Raises:
        PlaybackError: if there is nothing to play.
        RecordingError: if the recording cannot be read.
    """
    if path.suffix != ".mcap":
        return Playback.load(path)
    names = read_configuration(path).trackers
    frames = [m.data for m in read_recording(path, (schemas.FRAMES,))]
    # Masked entries of a frame hold what was seen last; before that, nothing of use.
    if not frames:
        raise PlaybackError(f"{path} holds no frames to play")
    quaternions = np.array([f["quaternions"] for f in frames], dtype=np.float64)
    return Playback(
        np.array([f["time"] for f in frames], dtype=np.float64),
        np.array([f["positions"] for f in frames], dtype=np.float64),
        rotation.normalize(quaternions),
        names,
    )
