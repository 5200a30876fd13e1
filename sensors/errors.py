"""Everything that can go wrong with sensors, under one base class.

Messages say what to do. Bad *data* never raises out of this package while running: it is
counted and skipped. These errors are for settings, files, ports and programming.
"""


class SensorError(Exception):
    """Base class of all errors this package raises on purpose."""


class ConfigurationError(SensorError):
    """A setting has no valid meaning; the message lists what is valid."""


class ProtocolError(SensorError):
    """A request that the wire format cannot express, such as an unknown item number."""


class MalformedRecordError(ProtocolError):
    """Bytes that have the shape of a record but cannot be one."""


class ConnectionFailedError(SensorError):
    """A port or address could not be opened, or the device behind it does not answer."""


class LinkLostError(ConnectionFailedError):
    """An open line failed: unplugged, hung up, or taking no bytes."""


class PlaybackError(SensorError):
    """A playback file that cannot be used."""


class RecordingError(SensorError):
    """A recording that cannot be made, or a file that is none."""
