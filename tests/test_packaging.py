"""The wheel and the sdist hold what they should, once."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = {"geograph": "geograph", "factors": "geograph/factors", "scenarios": "geograph/scenarios"}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build from a copy, so that nothing is left in the tree and nothing in it is picked up."""
    folder = tmp_path_factory.mktemp("build")
    tree = folder / "tree"
    tree.mkdir()
    for name in ("geograph", "factors", "scenarios"):
        ignored = shutil.ignore_patterns("__pycache__", "*.so")
        shutil.copytree(ROOT / name, tree / name, symlinks=True, ignore=ignored)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree / name)
    # The sdist first, and the wheel from it: the way that users build it.
    done = subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(tree)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = folder.glob("*.whl")
    (sdist,) = folder.glob("*.tar.gz")
    return wheel, sdist


def expected_files():
    """Return every module and datum of the tree under its name in an installation."""
    names = set()
    for folder, target in SOURCES.items():
        for path in (ROOT / folder).rglob("*"):
            inside = path.relative_to(ROOT / folder)
            if "__pycache__" in inside.parts or not path.is_file():
                continue
            if folder == "geograph" and inside.parts[0] in SOURCES:
                continue
            data = path.name == "py.typed" or inside.parts[0] == "data" or "assets" in inside.parts
            if path.suffix in (".py", ".pyi") or data:
                names.add(f"{target}/{inside.as_posix()}")
    return names


def test_wheel_holds_every_module_once_and_no_other_package(built):
    with zipfile.ZipFile(built[0]) as archive:
        names = archive.namelist()
    assert not [name for name, count in Counter(names).items() if count > 1]
    installed = {name for name in names if ".dist-info/" not in name}
    # One build for every Python that is supported; none at all where there is no compiler.
    built_here = {name for name in installed if name.endswith(".so")}
    assert built_here == ({"geograph/kernels/_compiled.abi3.so"} if shutil.which("cc") else set())
    assert installed - built_here == expected_files()
    assert {name.split("/")[0] for name in installed} == {"geograph"}


def test_wheel_has_the_command_the_licence_and_the_types(built):
    with zipfile.ZipFile(built[0]) as archive:
        names = archive.namelist()
        (points,) = (name for name in names if name.endswith("entry_points.txt"))
        assert "geograph = geograph.__main__:main" in archive.read(points).decode()
        assert any(name.endswith("licenses/LICENSE") for name in names)
    assert "geograph/py.typed" in names


def test_sdist_holds_every_module(built):
    with tarfile.open(built[1]) as archive:
        members = [Path(*Path(m.name).parts[1:]).as_posix() for m in archive if m.isfile()]
    assert not [name for name, count in Counter(members).items() if count > 1]
    back = {target: source for source, target in SOURCES.items()}
    sources = Path(__file__).parents[1].glob("geograph/kernels/*.[ch]")
    assert {f"geograph/kernels/{source.name}" for source in sources} <= set(members)
    for name in expected_files():
        package = "/".join(name.split("/")[:2])
        source = name.replace(package, back[package], 1) if package in back else name
        assert source in members


def test_installed_wheel_imports_and_runs_outside_the_tree(built, tmp_path):
    target = tmp_path / "site"
    with zipfile.ZipFile(built[0]) as archive:
        archive.extractall(target)
    code = (
        "import geograph, geograph.factors, geograph.scenarios, importlib.util as u;"
        f"assert geograph.__file__.startswith({str(target)!r}), geograph.__file__;"
        f"assert geograph.factors.__file__.startswith({str(target)!r});"
        "assert u.find_spec('scenarios') is None"
    )
    # -S leaves out the editable installation; what geograph needs comes back by the path.
    paths = [str(target), *(p for p in sys.path if p.endswith("site-packages"))]
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import sys; sys.path[:0] = {paths!r}; {code}"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_symbolic_links_show_one_tree_to_static_tools():
    for name in ("factors", "scenarios"):
        link = ROOT / "geograph" / name
        assert link.is_symlink()
        assert link.resolve() == ROOT / name
