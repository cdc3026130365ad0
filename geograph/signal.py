"""How well a signal tells its arrival: sigmas from signal-to-noise ratio, band and time.

For a stationary signal and noise with flat spectra over one band, received twice with the ratios
g1 and g2 of signal to noise power, the magnitude-squared coherence C gives

    C / (1 - C) = g1 g2 / (1 + g1 + g2),

and no estimate of the difference of arrival time has a variance below

    sigma^2 = [2 T integral (2 pi f)^2 C / (1 - C) df]^-1

over the band, integrated for the time T (C. H. Knapp, G. C. Carter, *The generalized correlation
method for estimation of time delay*, IEEE Trans. ASSP 24, 1976; its limits at high and low ratios:
A. H. Quazi, *An overview on the time delay estimate in active and passive systems for target
localization*, IEEE Trans. ASSP 29, 1981). That uses the phase of the carrier. Where its cycles
cannot be told apart, frequencies count from the middle of the band, which leaves the phase unknown;
with the effective ratio g = 2 g1 g2 / (1 + g1 + g2) that is 1 / (beta sqrt(B T g)) for the band B
and the radian bandwidth beta = pi B / sqrt(3), and the difference of frequency has

    sigma_f = 1 / (2 pi T_rms sqrt(B T g)),    T_rms = T / sqrt(12)

(S. Stein, *Algorithms for ambiguity function processing*, IEEE Trans. ASSP 29, 1981). A receiver
that knows the waveform compares with a copy free of noise: g2 is infinite, g = 2 g1, and B T g is
twice the energy over the noise density, 2 E / N0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from geograph.errors import InputError

if TYPE_CHECKING:
    from geograph.recording import Recording

# Half a cycle away lies the next one that fits as well: the envelope must tell it to this many
# sigmas (the threshold of A. J. Weiss, E. Weinstein, IEEE Trans. ASSP 31, 1983, in its simplest
# form).
_CYCLE_SIGMAS = 3.0

# Below this ratio after integration peaks of noise are taken for the signal's (Stein 1981).
_REACHABLE = 10.0


@dataclass(frozen=True, kw_only=True)
class Signal:
    """A signal as receivers get it.

    Parameters
    ----------
    snr_db
        Ratio of signal to noise power within the band, at the receiver, decibels.
    band_hz
        Lowest and highest frequency, hertz.
    integration_s
        How long each measurement integrates, seconds.
    snr_reference_db
        The ratio at the reference receiver; None: the same.
    coherent
        Whether the carrier's phase is used. None: where the envelope tells its cycles apart, three
        sigmas within half a cycle of the band's middle, as for sound or pulses at baseband.

    Raises
    ------
    InputError
        If a value is out of range, or the integration is shorter than one over the bandwidth.
    """

    snr_db: float
    band_hz: tuple[float, float]
    integration_s: float
    snr_reference_db: float | None = None
    coherent: bool | None = None

    def __post_init__(self) -> None:
        for name in ("snr_db", "snr_reference_db"):
            value = getattr(self, name)
            # 300 dB is beyond any receiver, and its square still a number.
            if value is not None and not -300.0 <= value <= 300.0:
                raise InputError(f"{name} is {value}; expected decibels from -300 to 300")
        low, high = self.band_hz
        if not 0.0 <= low < high < np.inf:
            raise InputError(
                f"band_hz is {low} to {high}; expected two frequencies in hertz, the lower first"
            )
        if not 0.0 < self.integration_s < np.inf:
            raise InputError(
                f"integration_s is {self.integration_s}; expected a finite number above 0 (seconds)"
            )
        if self.bandwidth_hz * self.integration_s < 1.0 - 1e-9:
            raise InputError(
                f"integration_s is {self.integration_s} and the band is {self.bandwidth_hz:.6g} Hz "
                f"wide; expected at least one over the bandwidth, {1.0 / self.bandwidth_hz:.6g} s"
            )

    @property
    def bandwidth_hz(self) -> float:
        """Width of the band."""
        return self.band_hz[1] - self.band_hz[0]

    @property
    def effective_snr(self) -> float:
        """Stein's effective ratio, 2 g1 g2 / (1 + g1 + g2), of a difference (not in decibels)."""
        return 2.0 * _coherence_ratio(self._snr, self._snr_reference)

    @property
    def reachable(self) -> bool:
        """Whether the ratio after integration, B T g, reaches 10: below, no estimator is close."""
        return self.bandwidth_hz * self.integration_s * self.effective_snr >= _REACHABLE

    @property
    def uses_phase(self) -> bool:
        """Whether the sigma of a time difference uses the carrier's phase."""
        return self._phase(self.effective_snr)

    def time_difference_sigma_s(self) -> float:
        """Return the least sigma of a difference of arrival time, waveform unknown, seconds."""
        return self._time_sigma_s(self.effective_snr)

    def frequency_difference_sigma_hz(self) -> float:
        """Return the least sigma of a difference of received frequency, hertz."""
        return self._frequency_sigma_hz(self.effective_snr)

    def arrival_sigma_s(self) -> float:
        """Return the least sigma of one receiver's arrival time, waveform known, seconds.

        It is 1 / (2 pi beta sqrt(2 E / N0)) with the root mean square bandwidth beta in hertz.
        """
        return self._time_sigma_s(2.0 * self._snr)

    @property
    def _snr(self) -> float:
        return float(10.0 ** (self.snr_db / 10.0))

    @property
    def _snr_reference(self) -> float:
        value = self.snr_reference_db
        return self._snr if value is None else float(10.0 ** (value / 10.0))

    def _phase(self, effective_snr: float) -> bool:
        if self.coherent is not None:
            return self.coherent
        envelope = self._time_sigma_s(effective_snr, coherent=False)
        middle = 0.5 * (self.band_hz[0] + self.band_hz[1])
        return _CYCLE_SIGMAS * envelope * middle < 0.5

    def _time_sigma_s(self, effective_snr: float, *, coherent: bool | None = None) -> float:
        """Return [2 T (2 pi)^2 (g / 2) integral f^2 df]^-1/2, f from zero or the band's middle."""
        used = self._phase(effective_snr) if coherent is None else coherent
        low, high = self.band_hz
        square = (high**3 - low**3) / 3.0 if used else (high - low) ** 3 / 12.0
        information = (2.0 * np.pi) ** 2 * self.integration_s * effective_snr * square
        return float(1.0 / np.sqrt(information))

    def _frequency_sigma_hz(self, effective_snr: float) -> float:
        rms_s = self.integration_s / np.sqrt(12.0)
        gathered = self.bandwidth_hz * self.integration_s * effective_snr
        return float(1.0 / (2.0 * np.pi * rms_s * np.sqrt(gathered)))


def _coherence_ratio(first: float, second: float) -> float:
    """Return C / (1 - C) of two ratios of signal to noise power."""
    return first * second / (1.0 + first + second)


def with_signal(recording: Recording, signal: Signal) -> Recording:
    """Return a recording whose arrival and frequency sigmas are those of a signal.

    Parameters
    ----------
    recording
        With arrivals, time differences or frequency differences; bearings keep their sigmas.
    signal
        As every receiver gets it. The share of a difference's variance that is common to all rows
        of one reference stays what it is.

    Raises
    ------
    InputError
        If there is nothing whose sigma a signal gives.
    """
    arrivals, times = recording.arrivals, recording.time_differences
    frequencies = recording.frequency_differences
    if arrivals is None and times is None and frequencies is None:
        raise InputError(
            f"recording {recording.name!r} has bearings only; a signal-to-noise ratio gives the "
            "sigmas of arrivals, time_differences and frequency_differences",
            path=recording.path,
        )
    if arrivals is not None:
        sigma = np.full_like(arrivals.sigma_s, signal.arrival_sigma_s())
        arrivals = replace(arrivals, sigma_s=sigma)
    if times is not None:
        factor = signal.time_difference_sigma_s() / times.sigma_s
        times = replace(
            times,
            sigma_s=factor * times.sigma_s,
            sigma_reference_s=factor * times.sigma_reference_s,
        )
    if frequencies is not None:
        factor = signal.frequency_difference_sigma_hz() / frequencies.sigma_hz
        frequencies = replace(
            frequencies,
            sigma_hz=factor * frequencies.sigma_hz,
            sigma_reference_hz=factor * frequencies.sigma_reference_hz,
        )
    return replace(
        recording, arrivals=arrivals, time_differences=times, frequency_differences=frequencies
    )
