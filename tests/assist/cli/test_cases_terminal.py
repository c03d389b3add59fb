"""Control characters in names, files and options never reach a terminal: they are written out."""

from __future__ import annotations

import io
import json
import logging
import os
import pty
import shutil
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import Literal

import pytest
from click.testing import CliRunner
from conftest import KITTING
from recorded import lines, write_log

from assist.cli import main
from assist.web.log_lines import JsonLines, TextLines
from planner.system.errors import VisibleText, visible
from planner.system.progress import stages

EVIL = "red\x1b]0;title\x07\x9b2J\r\u202egnp"
SHOWN = r"red\x1b]0;title\x07\x9b2J\r\u202egnp"
PLAN = [
    "(fetch box-a)", "(place hammer slot-1 box-a)", "(return box-a)",
    "(fetch box-b)", "(place wrench slot-2 box-b)", "(return box-b)",
]  # fmt: skip


def run(*arguments: object) -> str:
    """Return both outputs of a command that had strange signs somewhere, which must not be in them raw."""
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert "Traceback" not in result.output
    assert [sign for sign in "\x1b\x07\x9b\r\u202e" if sign in result.output] == []
    return result.output


@pytest.mark.parametrize(
    "arguments",
    [
        ("solve", EVIL),
        ("solve", "kitting/tiny", EVIL),
        (EVIL,),
        ("solve", "kitting/tiny", f"--{EVIL}"),
        ("simulate", "kitting/tiny", "--policy", EVIL),
        ("simulate", "kitting/tiny", "--humans", EVIL),
        ("fit", "kitting/tiny", EVIL),
        ("draw", "kitting/tiny", "--out", f"{EVIL}.png", "--state", EVIL),
    ],
)
def test_what_a_message_repeats_is_written_out(arguments: tuple[str, ...]) -> None:
    assert r"red\x1b]0;title\x07" in run(*arguments)


def test_file_names_and_their_content_are_written_out(tmp_path: Path) -> None:
    folder = tmp_path / EVIL
    folder.mkdir()
    shutil.copy(KITTING / "domain.pddl", folder / "domain.pddl")
    shutil.copy(KITTING / "tiny.pddl", folder / "tiny.pddl")
    assert "solved" in run("solve", folder / "tiny.pddl", "--jobs", 1)  # its table has the name
    (folder / "tiny.pddl").write_text(f"(define (problem {EVIL}) (:domain kitting) (:goal (and)))")
    assert r"\x1b" in run("solve", folder / "tiny.pddl")


def test_names_in_logs_are_written_out(tmp_path: Path) -> None:
    rows = [
        *lines(*PLAN),
        *lines(*PLAN, person=EVIL),
        *lines(EVIL, person="bob"),
        *lines(*PLAN, person="[b]eve :smile:"),
    ]
    file = write_log(tmp_path / "log.jsonl", rows)
    printed = run("fit", "kitting/tiny", file, "--jobs", 1)
    assert "'person' is " in printed
    assert "[b]eve :smile:  " in printed  # no markup
    assert r"\x1b" in run("fit", "kitting/tiny", file, "--columns", f"person={EVIL}")
    assert r"\x1b" in run("fit", "kitting/tiny", file, "--drop", EVIL)


def test_styles_of_bars_are_kept() -> None:
    """On a terminal, a bar moves the cursor; a message within it still may not."""
    reader, writer = pty.openpty()
    outputs = sys.stdout, sys.stderr
    chunks: list[bytes] = []

    def read() -> None:
        with suppress(OSError):  # the terminal is closed
            while chunk := os.read(reader, 1 << 16):
                chunks.append(chunk)

    reading = threading.Thread(target=read)
    reading.start()
    with os.fdopen(writer, "w") as terminal:
        sys.stdout = sys.stderr = VisibleText(terminal)  # type: ignore[assignment]
        try:
            with stages() as show:
                show(f"solving {EVIL}", 1, 2)
                print(f"a message {EVIL}", file=sys.stderr)
        finally:
            sys.stdout, sys.stderr = outputs
    reading.join()
    os.close(reader)
    printed = b"".join(chunks).decode()
    assert f"a message {SHOWN}" in printed
    assert r"solving red\x1b]0;" in printed
    assert "\x1b[?25l" in printed  # the bar hides the cursor
    assert [sign for sign in "\x07\x9b\u202e" if sign in printed] == []


def test_a_stream_of_visible_text() -> None:
    beneath = io.StringIO()
    stream = VisibleText(beneath)
    assert (stream.write("a\tb\n\x00"), beneath.getvalue()) == (5, "a\tb\n\\x00")
    stream.writelines(["\x1b", "c"])
    assert beneath.getvalue().endswith("\\x1bc")
    assert stream.rich_proxied_file is beneath
    assert VisibleText(stream).rich_proxied_file is beneath  # type: ignore[arg-type]
    assert visible("é 猫 \U0001f469") == "é 猫 \U0001f469"
    assert json.loads(json.dumps(EVIL)) == EVIL


@pytest.mark.cases
@pytest.mark.parametrize("form", ["text", "json"])
def test_a_name_cannot_forge_a_line_of_a_services_log(form: Literal["text", "json"]) -> None:
    kind = {"text": TextLines, "json": JsonLines}[form]
    record = logging.makeLogRecord({"msg": "%s: refused", "args": ("ann\nbob: accepted\x1b[31m\u2028",)})
    line = kind().format(record)
    assert len(line.splitlines()) == 1
    assert "\x1b" not in line
    assert r"ann\nbob: accepted" in line
