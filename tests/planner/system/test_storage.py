"""Output files are written completely or not at all, and existing files at their paths are kept."""

from __future__ import annotations

import errno
import json
import os
import resource
import stat
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import KITTING, ROOT, invoke

from assist.cli import main
from assist.cli.options.common import separate_files
from planner.system.errors import InputFileError
from planner.system.files import append, atomic, read_records, remove_unfinished, write_records

TINY = str(KITTING / "tiny.pddl")
SIMULATE = ("simulate", TINY, "--humans", "2", "--episodes", "2", "--pool", "2", "--policy", "none")


def test_a_link_goes_on_leading_to_its_file(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    file, link = tmp_path / "real" / "file.jsonl", tmp_path / "link.jsonl"
    file.write_text("before")
    file.chmod(0o640)
    link.symlink_to(file)
    write_records(link, [{"a": 1}])
    assert link.is_symlink()
    assert file.read_text() == '{"a": 1}\n'
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    dangling = tmp_path / "dangling"
    dangling.symlink_to(tmp_path / "new" / "file")
    write_records(dangling, [])
    assert (tmp_path / "new" / "file").is_file()
    left = sorted(path.name for path in tmp_path.rglob("*"))
    assert left == ["dangling", "file", "file.jsonl", "link.jsonl", "new", "real"]


def test_several_threads_write_one_file(tmp_path: Path) -> None:
    """Each thread writes to a file of its own, and the one that ends last is kept."""
    file = tmp_path / "file.txt"
    with atomic(file) as first:
        first.write_text("first")
        with atomic(file) as second:
            second.write_text("second")
        assert file.read_text() == "second"
    assert file.read_text() == "first"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("name", ["a" * 251 + ".npz", "\u6599" * 83 + ".npz", "\udcff.npz"])
def test_a_name_may_be_as_long_as_the_system_allows(tmp_path: Path, name: str) -> None:
    with atomic(tmp_path / name) as path:
        assert path.suffix == ".npz"
        path.touch()
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.jsonl"
    os.mkfifo(pipe)
    read: list[str] = []
    reader = threading.Thread(target=lambda: read.append(pipe.read_text()))
    reader.start()
    result = invoke(*SIMULATE, "--trace", pipe)
    reader.join(timeout=60)
    assert result.exit_code == 0
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert len(read[0].splitlines()) > 10
    assert all(json.loads(line)["policy"] == "none" for line in read[0].splitlines())


def test_what_is_printed_to_is_not_replaced(tmp_path: Path) -> None:
    """As with `--out /dev/stdout > FILE`."""
    code = f"""
import os, sys
sys.path.insert(0, {str(ROOT)!r})
from pathlib import Path
from planner.system.files import write_records
print("before", flush=True)
write_records(Path("/dev/stdout"), [{{"a": 1}}])
print("after")
"""
    printed = tmp_path / "printed"
    with printed.open("w") as stream:
        subprocess.run([sys.executable, "-c", code], stdout=stream, check=True)
    assert printed.read_text() == 'before\n{"a": 1}\nafter\n'


def test_a_write_protected_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mine.jsonl"
    file.write_text("precious")
    file.chmod(0o444)
    with pytest.raises(PermissionError, match="write-protected"):
        write_records(file, [{"a": 1}])
    result = invoke(*SIMULATE, "--out", file)
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"{file}: is write-protected" in result.stderr
    assert file.read_text() == "precious"


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("before")

    def records() -> Iterator[dict[str, int]]:
        yield {"a": 1}
        raise RuntimeError

    with pytest.raises(RuntimeError):
        write_records(file, records())
    assert [path.read_text() for path in tmp_path.iterdir()] == ["before"]


def test_a_full_disk_is_said_with_the_files_name(tmp_path: Path) -> None:
    """A limit on the size of files stands for a full disk."""
    whole, started = tmp_path / "whole.jsonl", tmp_path / "started.jsonl"
    append(started, "first\n")
    many = (*SIMULATE[:-5], "40", *SIMULATE[-4:])
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, hard))
    try:
        with pytest.raises(OSError, match=f"{whole}") as failure:
            write_records(whole, [{"number": n} for n in range(10_000)])
        assert failure.value.errno == errno.EFBIG
        with pytest.raises(OSError, match=f"{started}"):
            append(started, "second " * 10_000 + "\n")
        result = invoke(*many, "--out", whole)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert (result.exit_code, result.stderr) == (1, f"{whole}: File too large\n")
    assert [path.read_text() for path in tmp_path.iterdir()] == ["first\n"]


@pytest.mark.parametrize(
    ("content", "place"),
    [
        (b'{"a": 1}\n\x93NUMPY\x01\x00\n', ":2: is not text"),
        (b'{"a": 1}\n{"a": \n{"a": 2}\n', ":2: is no JSON"),
        (b"[1, 2]\n", ":1: expected a record"),
        (b"[" * 100_000 + b"\n", ":1: is no JSON"),
        (b"\xef\xbb\xbf\x00\n", ":1: is no JSON"),
    ],
)
def test_a_damaged_file_of_records_is_named_with_its_line(content: bytes, place: str, tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    file.write_bytes(content)
    with pytest.raises(InputFileError, match=f"{file}{place}"):
        read_records(file)


def test_a_last_line_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "results.jsonl"
    file.write_bytes('{"a": "ä"}\n{"b": "ö'.encode()[:-1])
    assert read_records(file) == [{"a": "ä"}]


def test_what_killed_processes_left_is_removed(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    for name in (".unfinished-7-table.npz", ".unfinished-1-x", ".hidden", "results.jsonl", "sub/.unfinished-7-x.plan"):
        (tmp_path / name).touch()
    remove_unfinished([tmp_path, tmp_path / "nowhere"])
    left = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert left == [".hidden", ".unfinished-7-x.plan", "results.jsonl"]


def test_files_of_one_command_are_kept_apart(tmp_path: Path) -> None:
    import click

    log, other = tmp_path / "log", tmp_path / "other"
    log.touch()
    (tmp_path / "again").symlink_to(log)
    separate_files({"--out": other, "--trace": tmp_path / "third", "--figure": None}, {"LOG": log})
    separate_files({"--out": Path("/dev/null"), "--trace": Path("/dev/null")})
    for outputs in ({"--out": other, "--trace": tmp_path / "x" / ".." / "other"}, {"--out": tmp_path / "again"}):
        with pytest.raises(click.UsageError, match="the same file as"):
            separate_files(outputs, {"LOG": log})


@pytest.mark.parametrize("option", ["--time-limit", "--memory-limit"])
@pytest.mark.parametrize("value", ["nan", "-inf", "0", "1e300", "many"])
def test_limits_are_positive_finite_numbers(option: str, value: str) -> None:
    result = invoke("solve", TINY, option, value)
    assert result.exit_code == 2
    assert f"Invalid value for '{option}'" in result.stderr


@pytest.mark.parametrize("command", ["solve", "study"])
def test_an_empty_name_is_no_output(command: str) -> None:
    result = invoke(command, *([TINY] if command == "solve" else []), "--out", "")
    assert (result.exit_code, result.stdout) == (2, "")
    assert "expected the name of a folder" in result.stderr


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_signs_are_printed_in_any_encoding(encoding: str) -> None:
    result = CliRunner(charset=encoding).invoke(main, [*SIMULATE])
    assert (result.exit_code, result.stderr) == (0, "")
    assert "none" in result.stdout
