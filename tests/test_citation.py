"""The citation file is valid YAML of its format, and of this version."""

from pathlib import Path

import yaml

import geograph as gg


def test_the_citation_is_of_this_version():
    text = (Path(__file__).parents[1] / "CITATION.cff").read_text(encoding="utf-8")
    found = yaml.safe_load(text)
    assert {"cff-version", "message", "title", "authors"} <= set(found)
    assert found["version"] == gg.__version__
    assert found["license"] == "BSD-3-Clause"
