"""Waiting for what other threads do, without asserting how fast they are."""

import time
from collections.abc import Callable

import pytest

PATIENCE = 20.0


def eventually(condition: Callable[[], bool], what: str) -> None:
    give_up = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > give_up:
            pytest.fail(f"not within {PATIENCE} s: {what}")
        time.sleep(0.01)
