"""Commands and examples in the documentation are run, and their output is compared with the text."""

from __future__ import annotations

import doctest
import os
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from conftest import ROOT
from test_architecture import PACKAGES, handed_on

from assist.cli import main

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "domains").rglob("*.md"))]
STATUS = "echo $?"
"""After a command: it may fail, its stderr is shown too, and its exit code is compared."""
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
# Cells of notebooks are run where the documentation is built.
KINDS = {"console", "pycon", "sh", "pddl", "toml", "text", "json", "nginx", "{toctree}", "{eval-rst}", "{code-cell}"}
BLOCK = re.compile(r"^```([\w{}-]*)\n(.*?)^```", re.M | re.S)


def blocks(page: Path, language: str) -> str:
    """Return all blocks of a language in a page, joined."""
    return "\n".join(text for name, text in BLOCK.findall(page.read_text()) if name == language)


def commands(page: Path) -> list[tuple[str, str]]:
    """The commands of a page's console blocks, each with the output that is shown."""
    found: list[tuple[str, str]] = []
    lines = iter(blocks(page, "console").splitlines())
    for line in lines:
        if line.startswith("$ "):
            command = line[2:]
            while command.endswith("\\"):
                command = command[:-1] + next(lines).removeprefix("> ")
            found.append((command, ""))
        elif found:
            command, output = found[-1]
            found[-1] = (command, output + line + "\n")
    return found


def pages_with(language: str) -> list[Path]:
    return [page for page in PAGES if blocks(page, language)]


def cases(language: str) -> list[Any]:
    """Return the pages with blocks of a language; all but the files called README are slow tests."""
    return [
        pytest.param(page, marks=[] if page.stem == "README" else [pytest.mark.slow]) for page in pages_with(language)
    ]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, one_picture: None) -> Path:  # noqa: ARG001
    """A folder that looks like the project's, to which nothing is written in the project itself."""
    for folder in ("domains", "docs"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command: str) -> tuple[int, str, str, str]:
    """Run a command; return its exit code, stdout, stderr and both. The project's own command runs in this process."""
    if command.startswith("kitassist ") and not set(command) & set("|<>&;$`"):
        result = CliRunner().invoke(main, shlex.split(command)[1:], prog_name="kitassist")
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result.exit_code, result.stdout, result.stderr, result.output
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(command, shell=True, capture_output=True, text=True, env=environment, timeout=600)
    return done.returncode, done.stdout, done.stderr, done.stdout + done.stderr


@pytest.mark.parametrize("page", cases("console"), ids=name)
def test_console_blocks(page: Path, place: Path) -> None:
    assert Path.cwd() == place
    shown = commands(page)
    code = 0
    for (command, expected), (after, _) in zip(shown, [*shown[1:], ("", "")], strict=True):
        if command == STATUS:
            assert int(expected) == code, f"line before\n{STATUS}"
            continue
        code, printed, errors, both = run(command)
        if after == STATUS:
            printed = both
        else:
            assert code == 0, f"{command}\n{errors}"
        # How many states `solve` compares in a second is up to the machine, as the seconds behind it are.
        expected = re.sub(r"(?<= )\d+( +\.\.\.)$", r"...\1", expected, flags=re.M)
        if expected.strip():
            same = doctest.OutputChecker().check_output(expected.strip() + "\n", printed.strip() + "\n", FLAGS)
            assert same, f"{command}\n--- shown\n{expected}\n--- printed\n{printed}"


@pytest.mark.parametrize("page", cases("pycon"), ids=name)
def test_python_blocks(page: Path, place: Path) -> None:
    assert place.exists()
    test = doctest.DocTestParser().get_doctest(blocks(page, "pycon"), {}, name(page), str(page), 0)
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    complaints: list[str] = []
    runner.run(test, out=complaints.append)
    assert test.examples
    assert runner.failures == 0, "".join(complaints)


def test_every_block_is_of_a_kind_that_is_run_or_is_no_code() -> None:
    for page in PAGES:
        for language, text in BLOCK.findall(page.read_text()):
            assert language in KINDS, f"{name(page)}: ```{language}\n{text}"


@pytest.mark.parametrize("page", pages_with("sh"), ids=name)
def test_make_commands_exist(page: Path) -> None:
    """Blocks of `sh` hold the commands that set the project up: they run in the continuous integration."""
    for line in blocks(page, "sh").splitlines():
        command = line.partition("#")[0].strip()
        if command.startswith("make"):
            target = command.removeprefix("make").strip()
            subprocess.run(["make", "--dry-run", target], cwd=ROOT, check=True, capture_output=True)
        else:
            assert command.startswith(("git clone", "cd ", ". .venv/")) or not command


def test_every_exception_is_in_the_catalogue() -> None:
    values = {name: getattr(import_module(package), name) for package in PACKAGES for name, _ in handed_on(package)}
    exceptions = {name for name, value in values.items() if isinstance(value, type) and issubclass(value, Exception)}
    rows = re.findall(r"^\| (`(?:\w+Error|Refusal)`.*?) \|", (ROOT / "docs" / "errors.md").read_text(), re.M)
    assert {name for row in rows for name in re.findall(r"\w+", row)} == exceptions


def test_what_notebooks_write_is_what_the_examples_have() -> None:
    """Cells run when the documentation is built; each notebook can be read first."""
    text = (ROOT / "docs" / "tutorials" / "domain.md").read_text()
    for file in ("domain.pddl", "bookshelf.pddl"):
        assert (ROOT / "docs" / "examples" / "shelf" / file).read_text() in text


def test_links_lead_somewhere() -> None:
    for page in PAGES:
        for link in re.findall(r"\]\(([^)#\s]+)", page.read_text()):
            if "://" not in link:
                assert (page.parent / link).exists(), f"{name(page)}: {link}"
