"""What holds for all tests.

Their order: files that take long first, lest one core waits for the other's last. And examples of
properties are the same in every run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from hypothesis import settings

if TYPE_CHECKING:
    import pytest

settings.register_profile("seeded", derandomize=True, deadline=None)
settings.load_profile("seeded")

LONG = (
    "test_docs.py",
    "test_accuracy.py",
    "test_locards.py",
    "test_mixed_study.py",
    "test_wrong_sensors.py",
    "test_incremental.py",
    "test_cluster.py",
    "test_families.py",
    "test_closed_form.py",
    "test_cli.py",
    "test_terrain_smoothing.py",
)
"""Those of half a minute or near it, the longest first."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {name: place for place, name in enumerate(LONG)}
    items.sort(key=lambda item: rank.get(item.path.name, len(LONG)))
