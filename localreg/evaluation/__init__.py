"""Evaluation: simulated trackers, metrics, leave-one-out."""
