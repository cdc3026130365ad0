"""What the documents show is run: Python blocks, and commands of console blocks with their output.

The blocks of one document share a fresh folder and one Python namespace, in their order. Output
below a command must be matched (``...`` for what may differ). ``text`` blocks are shown only, and
of ``sh`` blocks, which set up a machine or run for hours, commands and options must exist.

The commands of README.md, and all that need a shell, are processes of their own. Of the other pages
plain ``geograph`` commands run in this process, which has imported already what they need: half of
a page's time would be starts.
"""

from __future__ import annotations

import contextlib
import doctest
import io
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer

from geograph.cli import main
from geograph.cli.app import app

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```(python|console)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHOWN = re.compile(r"^```sh\n(.*?)^```$", re.MULTILINE | re.DOTALL)
IN_SHELL = re.compile(r"[^\w\s./,:=+-]")
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def blocks(text):
    """Yield language, first line and content of each block that is run."""
    for found in BLOCK.finditer(text):
        yield found[1], text.count("\n", 0, found.start()) + 2, found[2]


def run_python(content, place, line, names):
    if content.lstrip().startswith(">>>"):
        test = doctest.DocTestParser().get_doctest(content, names, place, place, line - 1)
        runner = doctest.DocTestRunner(optionflags=FLAGS, verbose=False)
        output = []
        runner.run(test, out=output.append, clear_globs=False)
        assert not runner.failures, "".join(output)
        names.update(test.globs)
    else:
        # Padded, so that a traceback names the line of the document.
        code = compile("\n" * (line - 1) + content, place, "exec")
        exec(code, names)


def in_shell(command, folder):
    """Run a command in bash; return its exit status and what it printed."""
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": "100",
    }
    done = subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


def in_process(command, folder):
    """Run a plain ``geograph`` command as ``in_shell`` does."""
    out, err = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        patch.setenv("COLUMNS", "100")
        status = main(shlex.split(command)[1:])
    return status, out.getvalue() + err.getvalue()


def run_console(content, place, line, folder):
    for part in re.split(r"^\$ ", content, flags=re.MULTILINE)[1:]:
        command, _, expected = part.partition("\n")
        while command.endswith("\\"):
            more, _, expected = expected.partition("\n")
            command = command[:-1] + more
        plain = command.startswith("geograph ") and not IN_SHELL.search(command)
        run = in_process if plain and place != "README.md" else in_shell
        status, shown = run(command, folder)
        where = f"{place}, block at line {line}: $ {command}\n{shown}"
        if not expected.strip():
            assert status == 0, where
        else:
            assert doctest.OutputChecker().check_output(expected, shown, FLAGS), where


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_document_runs(document, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {"__name__": "__document__"}
    place = document.relative_to(ROOT).as_posix()
    for language, line, content in blocks(document.read_text(encoding="utf-8")):
        if language == "python":
            run_python(content, place, line, names)
        else:
            run_console(content, place, line, tmp_path)


def test_links_between_documents_lead_somewhere():
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", text):
            if "://" not in target and not target.startswith("mailto:"):
                assert (document.parent / target).exists(), f"{document.name}: {target}"


def test_commands_that_are_only_shown_exist():
    commands = typer.main.get_command(app).commands
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    shown = 0
    for document in DOCUMENTS:
        for block in SHOWN.findall(document.read_text(encoding="utf-8")):
            for line in block.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                where = f"{document.name}: {line}"
                if words[:1] == ["geograph"]:
                    known = {option for each in commands[words[1]].params for option in each.opts}
                    options = {word.partition("=")[0] for word in words if word.startswith("-")}
                    assert options <= known, where
                elif words[:2] == ["python", "-m"]:
                    assert find_spec(words[2]), where
                elif words[:1] == ["make"]:
                    assert words[1] in targets, where
                shown += 1
    assert shown > 20


def test_the_interface_page_has_every_public_name():
    listed = {}
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    for module, options in re.findall(r"^::: (\S+)\n((?:    .*\n)*)", page, re.MULTILINE):
        names = re.search(r"members: \[([^\]]*)\]", options)
        public = getattr(import_module(module), "__all__", None)
        found = names[1].split(", ") if names else public or ()
        listed.setdefault(module, set()).update(found)
        if public is not None:
            assert set(found) <= set(public), module
    for module in ("geograph", *listed):
        public = set(getattr(import_module(module), "__all__", ())) - {"__version__"}
        assert public <= listed[module], f"{module}: {sorted(public - listed[module])}"


def test_every_page_is_in_the_navigation_and_on_the_first_page():
    navigation = (ROOT / ".mkdocs.yml").read_text(encoding="utf-8").partition("nav:")[2]
    first = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    for document in (ROOT / "docs").glob("*.md"):
        assert f"- {document.name}\n" in navigation, document.name
        assert document.name == "index.md" or f"({document.name}" in first, document.name


def test_the_runner_sees_what_is_wrong(tmp_path):
    with pytest.raises(ZeroDivisionError):
        run_python("1 / 0\n", "here", 1, {})
    with pytest.raises(AssertionError):
        run_python(">>> 1 + 1\n3\n", "here", 1, {})
    with pytest.raises(AssertionError):
        run_console("$ echo one\ntwo\n", "here", 1, tmp_path)
    with pytest.raises(AssertionError):
        run_console("$ false\n", "here", 1, tmp_path)
    with pytest.raises(AssertionError, match="nowhere"):
        run_console("$ geograph doctor nowhere\n", "here", 1, tmp_path)
    assert in_process("geograph doctor nowhere", tmp_path) == in_shell(
        "geograph doctor nowhere", tmp_path
    )
    run_console("$ echo one two\none ...\n$ true\n", "here", 1, tmp_path)
