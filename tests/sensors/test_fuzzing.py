"""Every parser against bytes nobody chose well; `make fuzz` does it for long."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sensors.errors import MalformedRecordError
from sensors.protocols import osc
from tests.sensors.fuzzing import SLOWEST, TARGETS, Target, fuzz, grows

WITH_RECORDS = [t for t in TARGETS if t.name not in ("is900 unit", "vrpn request")]
BY_NAME = [pytest.param(t, id=t.name) for t in TARGETS]


@pytest.mark.parametrize("target", BY_NAME)
def test_mutilated_data_does_no_harm(target: Target):
    assert fuzz(target, 200, np.random.default_rng(5)) < SLOWEST


@pytest.mark.parametrize("target", BY_NAME)
def test_memory_does_not_grow(target: Target):
    assert grows(target, 60, np.random.default_rng(6)) < 200_000


@pytest.mark.parametrize("target", [pytest.param(t, id=t.name) for t in WITH_RECORDS])
def test_clean_data_is_understood(target: Target):
    take = target.make()
    assert sum(take(piece) for piece in target.clean) >= 40


@pytest.mark.parametrize("target", BY_NAME)
@settings(deadline=None, max_examples=15)
@given(chunks=st.lists(st.binary(max_size=120), max_size=6))
def test_any_bytes_at_all_do_no_harm(target: Target, chunks: list[bytes]):
    take = target.make()
    for chunk in chunks:
        take(chunk)


def test_lengths_inside_a_bundle_are_not_trusted():
    head = b"#bundle\0" + b"\0" * 7 + b"\x01"
    for length in (b"\xff\xff\xff\xfc", b"\0\0\0\0", b"\x7f\xff\xff\xfc", b"\0\0\0\x03"):
        with pytest.raises(MalformedRecordError):
            osc.decode(head + length + b"/abc\0\0\0\0,\0\0\0")
    nested = b"/a\0\0,\0\0\0"
    for _ in range(20):
        nested = head + len(nested).to_bytes(4, "big") + nested
    with pytest.raises(MalformedRecordError, match="too deep"):
        osc.decode(nested)
