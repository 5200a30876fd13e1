"""Six 6-DoF trackers in, a whole-body motion out."""
