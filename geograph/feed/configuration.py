"""What a journal must agree with: sensors, settings, and the recording that is replayed."""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import json
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    from geograph.feed.rows import Row
    from geograph.recording import Recording, SmoothSettings


def configuration_digest(
    recording: Recording,
    settings: SmoothSettings,
    *,
    lag_s: float | None,
    every_s: float | None,
) -> str:
    """Return a digest of all that decides what an engine makes of measurements.

    Parameters
    ----------
    recording
        Its sensors, frame, epoch and speed of propagation; measurements do not matter.
    settings
        As used.
    lag_s, every_s
        Of the engine, and of the batches.
    """
    content = [
        recording.frame,
        recording.epoch,
        recording.propagation_speed_m_s,
        recording.propagation_sigma_m_s,
        list(recording.sensors.values()),
        settings,
        lag_s,
        every_s,
    ]
    return hashlib.sha256(json.dumps(_plain(content)).encode()).hexdigest()


def rows_digest(rows: Iterable[Row]) -> str:
    """Return a digest of rows, in their order."""
    digest = hashlib.sha256()
    for row in rows:
        digest.update(row.key)
    return digest.hexdigest()


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if dataclasses.is_dataclass(value):
        return {
            entry.name: _plain(getattr(value, entry.name)) for entry in dataclasses.fields(value)
        }
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, enum.Enum):
        return value.value
    return value.isoformat() if isinstance(value, datetime) else value
