"""What ``geograph simulate`` does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geograph.errors import InputError
from geograph.scenarios.parameters import show
from geograph.scenarios.registry import scenario, scenarios

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from geograph.scenarios.parameters import Value
    from geograph.scenarios.registry import Scenario


def listing(name: str | None) -> str:
    """Return all scenarios, or the parameters of one, as text."""
    if name is None:
        known = scenarios()
        width = max(map(len, known))
        return "\n".join(
            f"{other.name:<{width}}  {other.title} [{other.source}]" for other in known.values()
        )
    chosen = scenario(name)
    values = {key: show(value) for key, value in chosen.parameters().items()}
    width = max(map(len, values))
    rows = [f"  {key:<{width}}  {value}" for key, value in values.items()]
    return "\n".join([f"{chosen.title} [{chosen.source}]", *rows])


def split(text: str, option: str) -> tuple[str, str]:
    """Return name and value of ``NAME=VALUE``.

    Raises
    ------
    InputError
        If it is none.
    """
    name, mark, value = text.partition("=")
    if not mark or not name.strip() or not value.strip():
        raise InputError(f"{option} {text!r}; expected NAME=VALUE")
    return name.strip(), value.strip()


def given_parameters(chosen: Scenario, changes: Iterable[str]) -> dict[str, Value]:
    """Return the parameters that are set to other than their defaults, in the scenario's order.

    Parameters
    ----------
    chosen
        The scenario.
    changes
        Each ``NAME=VALUE``.

    Raises
    ------
    InputError
        If one is not of the scenario, does not fit, or is given twice.
    """
    found: dict[str, Value] = {}
    for text in changes:
        key, value = split(text, "--set")
        if key in found:
            raise InputError(f"--set {key} is given twice; expected it once")
        found[key] = chosen.parse(key, value)
    return {
        key: found[key]
        for key, default in chosen.parameters().items()
        if key in found and found[key] != default
    }


def simulate_one(name: str, output: Path, *, seed: int, changes: Iterable[str]) -> str:
    """Write the recording of a scenario, and return what to say of it.

    Raises
    ------
    InputError
        If anything given is wrong; then nothing is written.
    """
    from geograph.io import write

    chosen = scenario(name)
    values = given_parameters(chosen, changes)
    recording = chosen.simulate(seed, values)
    write(recording, output, overwrite=True, beside=chosen.files_beside(seed, values))
    counts = ", ".join(
        f"{len(table)} {kind.replace('_', ' ')}" for kind, table in recording.tables.items()
    )
    return (
        f"wrote {output}: {counts} of {len(recording.sensors)} sensors, with the truth; "
        f"smooth it with: geograph smooth {output} -o RESULTS"
    )
