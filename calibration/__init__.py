"""Calibration of a person: bone lengths and tracker mounts."""
