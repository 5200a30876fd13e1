"""Trackers in: protocols, devices, emulators, clocks and frames. Knows nothing of bodies."""
