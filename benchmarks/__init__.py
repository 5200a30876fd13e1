"""Benchmarks: figures beyond the evaluation's own, each by one command."""
