"""Motions: poses over time, and the files they come from and go to."""
