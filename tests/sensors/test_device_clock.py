import numpy as np
import pytest

from sensors.clock import DeviceClock


def run(clock, device, arrival):
    return np.array(
        [clock.update(float(d), float(a)) for d, a in zip(device, arrival, strict=True)]
    )


@pytest.mark.parametrize("drift", [0.0, 5e-5, -2e-4])
def test_follows_drift_under_heavy_queueing(drift):
    rng = np.random.default_rng(1)
    true = np.arange(0.0, 200.0, 0.025)
    # Nine samples of ten wait in a queue of several milliseconds.
    delay = 0.002 + rng.exponential(0.006, len(true)) * (rng.random(len(true)) < 0.9)
    device = (true - 50.0) * (1.0 + drift) + 1234.0
    host = run(DeviceClock(), device, 1000.0 + true + delay)
    error = host - (1000.0 + true) - 0.002
    assert np.abs(error[true > 30.0]).max() < 5e-4
    assert np.abs(error).max() < 0.012


def test_drift_is_found():
    true = np.arange(0.0, 120.0, 0.025)
    clock = DeviceClock()
    run(clock, true * (1.0 - 1e-4), true + 0.001)
    assert clock.drift == pytest.approx(1e-4, rel=0.02)


def test_never_later_than_the_arrival():
    rng = np.random.default_rng(2)
    device = np.arange(0.0, 30.0, 0.025)
    arrival = device + 5.0 + rng.random(len(device)) * 0.01
    host = run(DeviceClock(), device, arrival)
    assert (host <= arrival).all()


@pytest.mark.parametrize("after", [0.0, 9999.0])
def test_a_clock_that_is_zeroed_or_set_starts_a_new_segment(after):
    true = np.arange(0.0, 40.0, 0.025)
    device = np.where(true < 20.0, true + 100.0, true - 20.0 + after)
    clock = DeviceClock()
    host = run(clock, device, true + 0.003)
    assert clock.resets == 1
    assert np.abs(host - true - 0.003).max() < 1e-3


def test_a_burst_from_a_full_buffer_is_not_a_reset():
    device = np.arange(0.0, 30.0, 0.025)
    arrival = device + 0.002
    held = (device > 10.0) & (device < 11.2)
    arrival[held] = 11.202
    clock = DeviceClock()
    host = run(clock, device, arrival)
    assert clock.resets == 0
    assert np.abs(host - device - 0.002).max() < 1e-3


def test_a_device_clock_that_stood_still_is_noticed():
    true = np.arange(0.0, 60.0, 0.025)
    device = np.where(true < 20.0, true, np.maximum(20.0, true - 3.0))
    clock = DeviceClock()
    host = run(clock, device, true + 0.002)
    assert clock.resets >= 1
    assert np.abs(host - true)[true > 36.0].max() < 0.005


def test_float32_milliseconds_after_ten_hours():
    true = np.arange(0.0, 60.0, 0.025)
    device = (np.float32((true + 36000.0) * 1e3)).astype(np.float64) * 1e-3
    host = run(DeviceClock(), device, true + 0.002)
    # float32 steps are 4 ms there: half of that up or down, and the line lies under all.
    assert np.abs(host - true).max() < 0.005


def test_memory_is_bounded():
    clock = DeviceClock(window=5.0)
    device = np.arange(0.0, 100.0, 0.1)
    run(clock, device, device + 0.001)
    assert len(clock._minima) <= 5
