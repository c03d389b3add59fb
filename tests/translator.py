"""A process that has loaded Fast Downward's translator, and translates in forks of itself.

Tests translate hundreds of small texts. To start Python and load the translator takes most of the time of each.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

from planner.system.processes import guarded_group, python

PROGRAM = Path(__file__).stem


class Translator:
    """The process, for the process that makes it and none of its forks."""

    def __init__(self) -> None:
        self.owner, self.lock = os.getpid(), threading.Lock()
        self.process = subprocess.Popen(
            python(PROGRAM), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, process_group=guarded_group()
        )

    def run(self, arguments: list[str], folder: str) -> tuple[int, str] | None:
        """Return the translator's exit code and output, as `fast_downward._run` does; None in a fork."""
        if os.getpid() != self.owner:
            return None
        with self.lock:
            assert self.process.stdin is not None
            assert self.process.stdout is not None
            self.process.stdin.write(json.dumps([arguments, folder]) + "\n")
            self.process.stdin.flush()
            code, output = json.loads(self.process.stdout.readline())
        return code, output

    def close(self) -> None:
        self.process.communicate()


def main() -> None:
    import fast_downward.translate.main
    import fast_downward.translate.options  # noqa: F401

    for line in sys.stdin:
        arguments, folder = json.loads(line)
        read, write = os.pipe()
        child = os.fork()
        if child == 0:
            _translate(arguments, folder, write)
        os.close(write)
        with open(read, encoding="utf-8", errors="replace") as said:  # noqa: PTH123 (a descriptor)
            output = said.read()
        print(json.dumps([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), output]), flush=True)


def _translate(arguments: list[str], folder: str, write: int) -> None:
    """Do what `python -m fast_downward.translate` does, and end this process."""
    import runpy
    import traceback

    code = 1
    try:
        for descriptor in (1, 2):
            os.dup2(write, descriptor)
        os.chdir(folder)
        sys.argv[1:] = arguments
        runpy.run_module("fast_downward.translate", run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if isinstance(end.code, str):
            print(end.code)
    except BaseException:  # noqa: BLE001 (as Python does at the end)
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    main()
