"""Print the contestants' packages that this interpreter can have: the extra ``bench``."""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def main() -> None:
    """Print one requirement a line."""
    extras = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for line in extras["bench"]:
        wanted = Requirement(line)
        if wanted.marker is None or wanted.marker.evaluate():
            print(f"{wanted.name}{wanted.specifier}")


if __name__ == "__main__":
    main()
