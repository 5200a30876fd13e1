"""Topics and JSON schemas of what this package records itself.

Samples are `foxglove.FrameTransforms`, so that Foxglove draws the trackers in its 3D panel;
the numbers that a replay needs stand beside what the schema asks for, which JSON Schema
allows.
"""

from collections.abc import Mapping
from typing import Any

Schema = Mapping[str, Any]

SENSORS = "/sensors"
RAW = "/raw/"
SAMPLES = "/samples"
FRAMES = "/frames"
DROPPED = "/dropped"
ROOM = "/room"
LOST = "/recorder"

WORLD = "world"
"""Name of the frame of reference of all samples."""

_NUMBER: Schema = {"type": "number"}
_INTEGER: Schema = {"type": "integer"}
_TEXT: Schema = {"type": "string"}
_NUMBERS: Schema = {"type": "array", "items": _NUMBER}
_FLAGS: Schema = {"type": "array", "items": {"type": "boolean"}}
_ROWS: Schema = {"type": "array", "items": _NUMBERS}


def object_schema(title: str, description: str, **properties: Schema) -> Schema:
    """JSON schema of an object with these properties."""
    return {
        "title": title,
        "description": description,
        "type": "object",
        "properties": dict(properties),
    }


_TIME: Schema = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer"}},
}
_VECTOR: Schema = {
    "type": "object",
    "title": "foxglove.Vector3",
    "properties": dict.fromkeys("xyz", _NUMBER),
}
_QUATERNION: Schema = {
    "type": "object",
    "title": "foxglove.Quaternion",
    "properties": dict.fromkeys("xyzw", _NUMBER),
}

FRAME_TRANSFORMS: Schema = object_schema(
    "foxglove.FrameTransforms",
    "Where things are; time, arrival and quality are ours: the capture and the arrival on the "
    "host's monotonic clock in seconds, and 0 (lost) to 1 (perfect).",
    transforms={
        "type": "array",
        "items": object_schema(
            "foxglove.FrameTransform",
            "One tracker",
            timestamp=_TIME,
            parent_frame_id=_TEXT,
            child_frame_id=_TEXT,
            translation=_VECTOR,
            rotation=_QUATERNION,
            time=_NUMBER,
            arrival=_NUMBER,
            quality=_NUMBER,
        ),
    },
)

RAW_CHUNK = object_schema(
    "sensors.RawChunk",
    "What one read of a device gave. Or, with opening, the beginning of a new stream.",
    time={**_NUMBER, "description": "receive time, host's monotonic clock [s]"},
    data={**_TEXT, "contentEncoding": "base64"},
    source=_TEXT,
    opening={"type": ["object", "null"]},
)

CONFIGURATION = object_schema(
    "sensors.Configuration",
    "What was recorded, and how monotonic time relates to the calendar.",
    version=_INTEGER,
    unix_ns_at_monotonic_zero=_INTEGER,
    trackers={"type": "array", "items": _TEXT},
    devices={"type": "array", "items": {"type": "object"}},
    assembler={"type": "object"},
    room={"type": "object"},
)

FRAME = object_schema(
    "sensors.Frame",
    "All trackers at one instant, in the room; rows in the order of the trackers.",
    index=_INTEGER,
    time={**_NUMBER, "description": "the instant, host's monotonic clock [s]"},
    closed_at={**_NUMBER, "description": "when the frame was closed [s]"},
    taken={**_INTEGER, "description": "samples taken from the queue before"},
    newest_arrival={"type": ["number", "null"]},
    positions={**_ROWS, "description": "x y z [m]"},
    quaternions={**_ROWS, "description": "w x y z"},
    position_mask=_FLAGS,
    orientation_mask=_FLAGS,
    swaps={"type": "array", "items": {"type": "array", "items": _TEXT}},
)

DROPPED_SAMPLES = object_schema(
    "sensors.Dropped", "Samples that gave way in a full queue.", first=_INTEGER, count=_INTEGER
)

ROOM_PLACEMENT = object_schema(
    "sensors.Room",
    "The trackers' world in the room, for frames from now on.",
    yaw={**_NUMBER, "description": "about z [rad]"},
    translation={**_NUMBERS, "description": "x y z [m]"},
)

RECORDER = object_schema(
    "sensors.Recorder",
    "Messages that the recorder had to let go.",
    lost={**_INTEGER, "description": "since the beginning"},
)
