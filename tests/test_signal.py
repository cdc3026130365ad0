"""Sigmas from signal-to-noise ratio, band and time: closed forms, and a real correlator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2

from geograph.errors import InputError
from geograph.measurements import Arrivals, Bearings, FrequencyDifferences, TimeDifferences
from geograph.recording import Recording
from geograph.sensors import Sensor
from geograph.signal import Signal, with_signal


def signal(**changes):
    given = {"snr_db": 3.0, "band_hz": (500.0, 4000.0), "integration_s": 0.5} | changes
    return Signal(**given)


@pytest.mark.parametrize(("first_db", "second_db"), [(10.0, 10.0), (0.0, -12.0), (-25.0, 30.0)])
def test_it_is_the_integral_of_knapp_and_carter(first_db, second_db):
    first, second = 10.0 ** (first_db / 10.0), 10.0 ** (second_db / 10.0)
    # Coherence of a common signal in two independent noises.
    coherence = (1.0 / np.sqrt((1.0 + 1.0 / first) * (1.0 + 1.0 / second))) ** 2
    integral, _ = quad(
        lambda f: (2.0 * np.pi * f) ** 2 * coherence / (1.0 - coherence), 500.0, 4000.0
    )
    given = signal(snr_db=first_db, snr_reference_db=second_db, coherent=True)
    expected = (2.0 * 0.5 * integral) ** -0.5
    assert given.time_difference_sigma_s() == pytest.approx(expected, rel=1e-12)


def test_high_and_low_ratios_reach_the_limits_of_quazi():
    cubes = 4000.0**3 - 500.0**3
    high = signal(snr_db=60.0, coherent=True).time_difference_sigma_s()
    assert high == pytest.approx(
        np.sqrt(3.0 / (4.0 * np.pi**2 * 0.5)) / np.sqrt(1e6 * cubes), rel=1e-6
    )
    low = signal(snr_db=-60.0, coherent=True).time_difference_sigma_s()
    assert low == pytest.approx(
        np.sqrt(3.0 / (8.0 * np.pi**2 * 0.5)) / (1e-6 * np.sqrt(cubes)), rel=2e-6
    )


def test_without_the_phase_it_is_the_form_of_stein():
    given = signal(snr_db=5.0, snr_reference_db=-2.0, coherent=False)
    first, second = 10.0**0.5, 10.0**-0.2
    effective = 2.0 / (1.0 / first + 1.0 / second + 1.0 / (first * second))
    band, time = 3500.0, 0.5
    root = np.sqrt(band * time * effective)
    assert given.effective_snr == pytest.approx(effective, rel=1e-12)
    # beta = pi B / sqrt(3), about 1.8 B, and T_e = pi T / sqrt(3), about 1.8 T.
    expected = np.sqrt(3.0) / (np.pi * band) / root
    assert given.time_difference_sigma_s() == pytest.approx(expected, rel=1e-12)
    expected = np.sqrt(3.0) / (np.pi * time) / root
    assert given.frequency_difference_sigma_hz() == pytest.approx(expected, rel=1e-12)


def test_a_known_waveform_is_a_reference_without_noise():
    given = signal(snr_db=-4.0, coherent=True)
    clean = replace(given, snr_reference_db=200.0)
    assert given.arrival_sigma_s() == pytest.approx(clean.time_difference_sigma_s(), rel=1e-12)
    # 1 / (2 pi beta sqrt(2 E / N0)), E = S T, N0 = N / B, beta^2 the mean square frequency.
    beta = np.sqrt((4000.0**3 - 500.0**3) / (3.0 * 3500.0))
    energy = 10.0**-0.4 * 3500.0 * 0.5
    expected = 1.0 / (2.0 * np.pi * beta * np.sqrt(2.0 * energy))
    assert given.arrival_sigma_s() == pytest.approx(expected, rel=1e-12)


def test_the_phase_of_a_carrier_counts_only_where_its_cycles_are_told_apart():
    sound = signal(snr_db=10.0)
    assert sound.uses_phase
    assert (
        sound.time_difference_sigma_s() < replace(sound, coherent=False).time_difference_sigma_s()
    )
    radio = signal(snr_db=10.0, band_hz=(433.0e6, 433.2e6), integration_s=0.01)
    assert not radio.uses_phase
    baseband = replace(radio, band_hz=(0.0, 0.2e6), coherent=False)
    assert radio.time_difference_sigma_s() == pytest.approx(
        baseband.time_difference_sigma_s(), rel=1e-6
    )


def test_what_no_estimator_reaches_is_told():
    assert signal(snr_db=10.0).reachable
    assert not signal(snr_db=-40.0).reachable


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"snr_db": float("nan")}, "snr_db is nan; expected decibels"),
        ({"snr_reference_db": 1e9}, "snr_reference_db is 1000000000.0; expected decibels"),
        ({"band_hz": (4000.0, 500.0)}, "band_hz is 4000.0 to 500.0; expected two frequencies"),
        ({"band_hz": (-1.0, 500.0)}, "band_hz is -1.0 to 500.0; expected two frequencies"),
        ({"integration_s": 0.0}, "integration_s is 0.0; expected a finite number above 0"),
        ({"integration_s": 1e-5}, "expected at least one over the bandwidth, 0.000285714 s"),
    ],
)
def test_what_is_not_a_signal_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        signal(**changes)


TRIALS = 1000
# Both bands hold a right ratio in 99 of 100 choices of the seed, and the seeds are fixed.
LOW, HIGH = chi2.ppf([0.005, 0.995], TRIALS) / TRIALS


def _pairs(rng, size, first, second):
    """Return spectra of a flat signal in two independent noises, over `size` frequencies."""
    signal_, one, two = rng.standard_normal((3, TRIALS, size, 2)) @ [1.0, 1.0j]
    return signal_ + one / np.sqrt(first), signal_ + two / np.sqrt(second)


def _peak(cross, phase, *, half_width, coherent):
    """Return where the sum of cross * exp(-i phase x) is greatest, for every trial.

    Its real part where coherent, otherwise its magnitude: found on a grid, refined by parabolas.
    """

    def value(turned):
        return turned.real if coherent else np.abs(turned) ** 2

    grid = np.linspace(-half_width, half_width, 161)
    best = grid[np.argmax(value(cross @ np.exp(-1j * np.outer(phase, grid))), axis=1)]
    step = grid[1] - grid[0]
    for _ in range(6):
        around = best[:, None] + step * np.array([-1.0, 0.0, 1.0])
        turned = np.exp(-1j * phase[None, :, None] * around[:, None, :])
        left, middle, right = value(np.einsum("tf,tfk->tk", cross, turned)).T
        best = best + 0.5 * step * (left - right) / (left - 2.0 * middle + right)
        step *= 0.1
    return best


RATIOS_DB = [(10.0, 10.0), (0.0, 3.0), (-6.0, 15.0)]


@pytest.mark.parametrize(("snr_db", "reference_db"), RATIOS_DB)
def test_a_correlator_of_sound_reaches_the_bound(snr_db, reference_db):
    band, time = (500.0, 4000.0), 0.2
    given = Signal(snr_db=snr_db, snr_reference_db=reference_db, band_hz=band, integration_s=time)
    assert given.uses_phase
    frequency = np.arange(round(band[0] * time), round(band[1] * time)) / time
    first, second = _pairs(
        np.random.default_rng(11), frequency.size, 10 ** (snr_db / 10), 10 ** (reference_db / 10)
    )
    delay = 37.3e-6
    cross = first * np.exp(-2j * np.pi * frequency * delay) * second.conj()
    # A delay turns by exp(-i w tau); the search has to turn it back.
    found = _peak(cross, -2.0 * np.pi * frequency, half_width=1e-3, coherent=True)
    ratio = np.mean((found - delay) ** 2) / given.time_difference_sigma_s() ** 2
    assert LOW < ratio < HIGH


@pytest.mark.parametrize(("snr_db", "reference_db"), RATIOS_DB)
def test_a_correlator_of_radio_reaches_the_bounds_of_time_and_frequency(snr_db, reference_db):
    band, time = (433.0e6, 433.2e6), 4e-3
    given = Signal(snr_db=snr_db, snr_reference_db=reference_db, band_hz=band, integration_s=time)
    assert not given.uses_phase
    size = round((band[1] - band[0]) * time)
    rng = np.random.default_rng(12)
    first, second = _pairs(rng, size, 10 ** (snr_db / 10), 10 ** (reference_db / 10))
    # A phase of its own in every trial, which neither search may use.
    cross = first * second.conj() * np.exp(2j * np.pi * rng.uniform(size=(TRIALS, 1)))

    # Taken as spectra: a delay over the band, counted from any frequency of it.
    frequency, delay = np.arange(size) / time, 0.7e-6
    late = cross * np.exp(-2j * np.pi * frequency * delay)
    found = _peak(late, -2.0 * np.pi * frequency, half_width=1e-5, coherent=False)
    assert LOW < np.mean((found - delay) ** 2) / given.time_difference_sigma_s() ** 2 < HIGH

    # Taken as samples of the band: a shift of frequency over the time.
    instant, shift = np.arange(size) / (band[1] - band[0]), 21.0
    moved = cross * np.exp(2j * np.pi * instant * shift)
    found = _peak(moved, 2.0 * np.pi * instant, half_width=300.0, coherent=False)
    assert LOW < np.mean((found - shift) ** 2) / given.frequency_difference_sigma_hz() ** 2 < HIGH


def _rows(**columns):
    return {name: np.array(column) for name, column in columns.items()}


def test_a_recording_takes_the_sigmas_of_a_signal():
    sensors = {name: Sensor(name=name, position_m=np.zeros(3)) for name in "AB"}
    pair = {"time_s": [0.0, 1.0], "sensor": [1, 0], "reference": [0, 1], "line": [2, 3]}
    recording = Recording(
        name="r",
        frame="local",
        sensors=sensors,
        arrivals=Arrivals(
            **_rows(
                emission=[0, 0], sensor=[0, 1], toa_s=[0.0, 0.1], sigma_s=[1.0, 2.0], line=[2, 3]
            )
        ),
        time_differences=TimeDifferences(
            **_rows(tdoa_s=[0.0, 0.1], sigma_s=[1.0, 2.0], sigma_reference_s=[0.5, 0.0], **pair)
        ),
        frequency_differences=FrequencyDifferences(
            **_rows(
                fdoa_hz=[0.0, 0.1],
                carrier_hz=[1e9, 1e9],
                sigma_hz=[1.0, 2.0],
                sigma_reference_hz=[0.5, 0.0],
                **pair,
            )
        ),
    )
    given = signal()
    found = with_signal(recording, given)
    assert found.arrivals.sigma_s == pytest.approx([given.arrival_sigma_s()] * 2)
    time, frequency = given.time_difference_sigma_s(), given.frequency_difference_sigma_hz()
    assert found.time_differences.sigma_s == pytest.approx([time] * 2)
    assert found.time_differences.sigma_reference_s == pytest.approx([0.5 * time, 0.0])
    assert found.frequency_differences.sigma_hz == pytest.approx([frequency] * 2)
    assert found.frequency_differences.sigma_reference_hz == pytest.approx([0.5 * frequency, 0.0])
    assert found.arrivals.toa_s is recording.arrivals.toa_s


def test_bearings_have_no_sigma_from_a_signal():
    empty = np.empty(0)
    table = Bearings(
        time_s=empty,
        sensor=np.empty(0, dtype=np.int64),
        azimuth_rad=empty,
        elevation_rad=empty,
        sigma_azimuth_rad=empty,
        sigma_elevation_rad=empty,
        isotropic=np.empty(0, dtype=bool),
        line=np.empty(0, dtype=np.int64),
    )
    recording = Recording(name="r", frame="local", sensors={}, bearings=table)
    with pytest.raises(InputError, match="has bearings only; a signal-to-noise ratio gives"):
        with_signal(recording, signal())
