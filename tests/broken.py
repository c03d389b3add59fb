"""Broken inputs for commands, generated from valid ones, and checks of how commands end."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import broken_live
import click
import numpy as np
from click.testing import CliRunner

from assist.cli import main
from assist.declare.options import Value, Written

ROOT = Path(__file__).parent.parent
KITTING = ROOT / "domains" / "kitting"
WITH_COSTS = ROOT / "domains" / "delivery", "one-parcel.pddl"
STUDY = """
title = "small"
seed = 3
repeats = 2
instances = ["problem.pddl"]
humans = [1, 2]
pool = 3
draws = 1
trials = 1
policies = ["none", "reactive", "attention", "mine.py:quiet"]

[setting]
c_suggest = 0.2

[populations.everybody]
beta = [0.1, 3.0]

[[conditions]]
name = "first"
"""
MINE = """
import numpy as np

def quiet(team):
    return team.act(np.full(len(team.x), -1), team.first_optimal())
"""
ARGUMENTS: dict[str, list[str]] = {
    "solve": ["problem.pddl", "--verify", "1", "--out", "out", "--json"],
    "simulate": [
        "problem.pddl", "--humans", "2", "--pool", "2", "--episodes", "2", "--set", "max_steps=40",
            "--policy", "attention",
        "--out", "episodes.jsonl", "--trace", "trace.jsonl", "--json",
    ],
    "policy": ["problem.pddl", "--time-limit", "0.3", "--gap", "0.1", "--out", "policy.npz", "--json"],
    "bound": ["problem.pddl", "--humans", "2", "--value-episodes", "4", "--time-limit", "0.5", "--jobs", "1", "--json"],
    "export": ["problem.pddl", "--out", "person.pomdpx", "--json"],
    "fit": [
        "problem.pddl", "log.jsonl", "--jobs", "1", "--out", "people.jsonl", "--write-population", "fitted.json",
        "--json",
    ],
    "study": ["--protocol", "study.toml", "--out", "study", "--json"],
    "draw": ["problem.pddl", "--plan", "found.plan", "--out", "drawn.svg", "--json"],
    "serve": broken_live.ARGUMENTS,
}  # fmt: skip
OUTPUTS = ("policy.npz", "episodes.jsonl", "trace.jsonl", "people.jsonl")
NUMBERS = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1", "2", "0.5", "1.5", "1e-300", "1e300", "-1e300", "1e9", "1_0", "0x10",
    "", " ", "many", "99999999999", "99999999999999999999", "-99999999999999999999", "٣", "1e", "\udcff", "3\n",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, "", "nan", "many", [], {}, [1], -1, 0, 0.5, 1.5, 1e300, -1e300, 10**30, float("nan"),
    float("inf"), "\0", "ä" * 300, [[[]]], {"beta": 1},
)  # fmt: skip
POLICIES = (
    "", "def quiet(", "quiet = 3", "def quiet(): pass", "def quiet(team): return 1", "def quiet(team): return 'a', 'b'",
    "def quiet(team): raise KeyError('oops')", "def quiet(team): team.x[:] = 0", "import nosuch", "1/0", "\0", "\ufeff",
    *(
        f"import numpy as np\ndef quiet(team):\n  n = len(team.x)\n  return team.act({person}, {said})"
        for person in ("np.full(n, 99)", "np.full(n, -2)", "np.zeros(n)", "0", "None", "np.zeros(n + 1, int)",
                       "np.zeros(n, int)", "np.full(n, 2**62)", "team.x[:, 0]")
        for said in ("team.first_optimal()", "team.first_optimal() + 99", "-team.first_optimal()", "[[0]]",
                      "team.first_optimal() / 0", "team.q_values()")
    ),
    "def quiet(team): return (99, 99)", "def quiet(team): return (float('nan'), 0)", "raise SystemExit(0)",
    "def quiet(team): raise SystemExit(0)", "class quiet:\n  def __init__(self, *a): raise RuntimeError",
)  # fmt: skip


@dataclass(frozen=True)
class Input:
    """A broken input: a command line in a prepared folder, and what is known of the answer."""

    kind: str
    command: str
    arguments: tuple[str, ...]
    broken: bool = False  # certainly: success would be wrong


class Fuzzer:
    """Generates broken inputs from a folder of valid ones."""

    def __init__(self, folder: Path, seed: int, commands: Sequence[str]) -> None:
        self.rng = np.random.default_rng(seed)
        self.commands = commands
        self.sound = folder / "sound"
        self.sound.mkdir(parents=True)
        for name, text in (("domain.pddl", None), ("problem.pddl", None), ("study.toml", STUDY), ("mine.py", MINE)):
            (self.sound / name).write_text(text or (KITTING / name.replace("problem", "tiny")).read_text())
        shutil.copy(KITTING / "drawing.toml", self.sound)
        self.costs = {record["instance"]: record["cost"] for record in self._prepare()}

    def _prepare(self) -> list[dict[str, Any]]:
        """Run every command on valid inputs, which also loads compiled code; keep its files as inputs."""
        answers = {}
        os.chdir(self.sound)
        for command in self.commands:
            result = CliRunner().invoke(main, [command, *ARGUMENTS[command]])
            assert result.exit_code == 0, f"{command}: {result.output} {result.exception}"
            answers[command] = result.stdout
            if command == "solve":
                shutil.copy(next(Path("out").glob("*.plan")), "found.plan")
            if command == "simulate":
                shutil.copy("trace.jsonl", "log.jsonl")
            if command == "fit":
                shutil.copy("fitted.json", "population.json")
        Path("distances.json").write_text("[[0, 1, 1], [1, 0, 1], [1, 1, 0]]")
        if "study" in self.commands:
            self.episodes = (self.sound / "study" / "episodes.jsonl").read_bytes()
        return json.loads(answers["solve"])

    def make(self, folder: Path) -> Input:
        """Prepare a folder with the next input."""
        kinds: dict[str, tuple[float, Callable[[Path], Input]]] = {
            "PDDL": (0.3, self._pddl),
            "numbers": (0.3, self._numbers),
            "logs": (0.16, self._log),
            "JSON": (0.08, self._json),
            "TOML": (0.04 * ("study" in self.commands), self._toml),
            "policies": (0.04 * ("policy" in self.commands), self._policy),
            "results": (0.08, self._results),
            "drawings": (0.12 * ("draw" in self.commands), self._drawing),
            "sessions": (0.12 * ("serve" in self.commands), self._session),
        }
        weights = np.array([weight for weight, _ in kinds.values()])
        kind = str(self.rng.choice(list(kinds), p=weights / weights.sum()))
        shutil.copytree(self.sound, folder)
        if kind != "results":
            for name in ("out", "study"):
                shutil.rmtree(folder / name, ignore_errors=True)
            for name in OUTPUTS:
                (folder / name).unlink(missing_ok=True)
        if kind != "sessions":
            shutil.rmtree(folder / "session", ignore_errors=True)
        return kinds[kind][1](folder)

    def _one(self, options: Sequence[Any]) -> Any:
        return options[int(self.rng.integers(len(options)))]

    def _spoil(self, text: bytes) -> bytes:
        """Break a text once, somewhere."""
        at, length = int(self.rng.integers(len(text) + 1)), int(self.rng.geometric(0.15))
        words = text.split()
        match int(self.rng.integers(11)):
            case 0:
                return text[:at]
            case 1:
                return text[:at] + text[at + length :]
            case 2:
                return text[:at] + text[at : at + length] * 2 + text[at + length :]
            case 3:
                return text[:at] + self.rng.bytes(length) + text[at:]
            case 4:
                return text.replace(self._one(words), self._one(words), 1)
            case 5:
                return text.replace(self._one(words), b"", 1)
            case 6:
                return (
                    text[:at]
                    + self._one([b"(", b")", b"-", b"?", b";", b'"', b"{", b"]", b",", b"\0", b"\n"])
                    + text[at:]
                )
            case 7:
                return text.decode(errors="replace").encode(
                    self._one(["utf-16", "utf-8-sig", "utf-32", "cp037"]), errors="replace"
                )
            case 8:
                return text.replace(self._one(words), self._one(NUMBERS).encode(errors="surrogateescape"), 1)
            case 9:
                return text[:at] + b"(" * self._one([1, 100, 100_000]) + text[at:]
            case _:
                lines = text.splitlines(keepends=True)
                self.rng.shuffle(lines)  # type: ignore[arg-type]
                return b"".join(lines)

    def _spoil_file(self, file: Path) -> bool:
        """Break a file; return whether that changed it."""
        before = file.read_bytes()
        text = before
        for _ in range(int(self.rng.geometric(0.7))):
            text = self._spoil(text)
        file.write_bytes(text)
        return text != before

    def _pddl(self, folder: Path) -> Input:
        if self.rng.random() < 0.4:
            where, problem = WITH_COSTS
            shutil.copy(where / "domain.pddl", folder / "domain.pddl")
            shutil.copy(where / problem, folder / "problem.pddl")
        file = folder / self._one(["domain.pddl", "problem.pddl"])
        self._spoil_file(file)
        command = self._one([name for name in ("solve", "solve", *self.commands) if name not in ("study", "bound")])
        text = file.read_text(errors="replace")
        code = "\n".join(line.partition(";")[0] for line in text.splitlines())
        return Input("PDDL", command, (command, *ARGUMENTS[command]), broken=code.count("(") != code.count(")"))

    def _numbers(self, folder: Path) -> Input:
        command = self._one(self.commands)
        found = main.get_command(click.Context(main), command)
        assert found is not None
        numeric = [
            option
            for option in found.params
            if isinstance(option, click.Option) and isinstance(option.type, (Value, Written))
            if option.metavar not in ("FILE", "RULE")
        ]
        option = self._one(numeric)
        values = [self._one(NUMBERS) for _ in range(option.nargs)]
        broken = any(value in ("nan", "inf", "-inf", "", " ", "many", "1e", "\udcff") for value in values)
        assert folder.exists()
        return Input("numbers", command, (command, *ARGUMENTS[command], option.opts[0], *values), broken)

    def _log(self, folder: Path) -> Input:
        file = folder / "log.jsonl"
        rows = [json.loads(line) for line in file.read_text().splitlines()]
        if self.rng.random() < 0.35:
            return self._csv(rows, folder)
        broken = False
        if self.rng.random() < 0.5:
            broken = self._spoil_file(file) and not _is_json_lines(file)
        else:
            self._spoil_row(rows, VALUES)
            file.write_text("".join(json.dumps(row) + "\n" for row in rows), errors="surrogatepass")
        return Input("logs", "fit", ("fit", *ARGUMENTS["fit"]), broken)

    def _csv(self, rows: list[dict[str, Any]], folder: Path) -> Input:
        """Write the log as CSV, with the matching file name extension or another one."""
        file = folder / self._one(["log.csv", "log.txt"])
        whole = self.rng.random() < 0.5
        if not whole:
            self._spoil_row(rows, [*VALUES, *NUMBERS, *",;\t\n\r", '"', '"a"b'])
        text = io.StringIO(newline="")
        names = list(dict.fromkeys(name for row in rows for name in row))  # the first row may lack what was spoiled
        writer = csv.DictWriter(text, names, delimiter=self._one([",", ";", "\t"]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        file.write_text(text.getvalue(), encoding="utf-8", errors="surrogateescape", newline="")
        broken = whole and self._spoil_file(file) and not _is_utf8(_as_utf8(file.read_bytes()))
        arguments = [file.name if word == "log.jsonl" else word for word in ARGUMENTS["fit"]]
        return Input("logs", "fit", ("fit", *arguments), broken)

    def _spoil_row(self, rows: list[dict[str, Any]], values: Sequence[Any]) -> None:
        """Remove or change a value of a record."""
        row = self._one(rows)
        key = self._one(["person", "episode", "step", "action", "suggestion"])
        match int(self.rng.integers(3)):
            case 0:
                row.pop(key)
            case 1:
                row[key] = self._one(values)
            case _:
                row[key] = self._one(rows)[key]

    def _json(self, folder: Path) -> Input:
        field = self._one(["population", "distances"])
        name = f"{field}.json"
        file = folder / name
        broken = False
        if self.rng.random() < 0.4:
            broken = self._spoil_file(file) and not _is_json(file.read_bytes())
        else:
            document = json.loads(file.read_text())
            self._spoil_value(document)
            file.write_text(json.dumps(document))
        takers = ("simulate", "bound", "serve", *(("policy", "export") if name == "population.json" else ()))
        command = self._one([taker for taker in takers if taker in self.commands])
        return Input("JSON", command, (command, *ARGUMENTS[command], "--set", f"{field}={name}"), broken)

    def _spoil_value(self, document: Any) -> None:
        """Change, remove or repeat something within a document."""
        while True:
            keys = list(document) if isinstance(document, dict) else list(range(len(document)))
            key = self._one(keys)
            if isinstance(document[key], dict | list) and document[key] and self.rng.random() < 0.8:
                document = document[key]
                continue
            match int(self.rng.integers(3)):
                case 0:
                    del document[key]
                case 1:
                    document[key] = self._one(VALUES)
                case _:
                    document[key] = document[self._one(keys)]
            return

    def _toml(self, folder: Path) -> Input:
        file = folder / "study.toml"
        if self.rng.random() < 0.5:
            self._spoil_file(file)
        else:
            lines = file.read_text().splitlines()
            at = int(self.rng.integers(len(lines)))
            name = lines[at].partition(" = ")[0]
            value = self._one([*NUMBERS, "[]", "{}", "true", '"x"', "[1, 2", "1979-05-27", '["problem.pddl", 1]'])
            lines[at] = f"{name} = {value}"
            file.write_text("\n".join(lines), errors="surrogateescape")
        return Input("TOML", "study", ("study", *ARGUMENTS["study"]))

    def _drawing(self, folder: Path) -> Input:
        """How a domain is drawn, or a plan or an episode to be drawn; as a picture, or as a page that moves."""
        name = self._one(["drawing.toml", "drawing.toml", "found.plan", "log.jsonl"])
        file = folder / name
        if name == "drawing.toml" and self.rng.random() < 0.5:
            lines = file.read_text().splitlines()
            at = int(self.rng.integers(len(lines)))
            values = [
                *NUMBERS,
                "[]",
                "{}",
                "true",
                '"x"',
                '"?1 in ?9"',
                '"?1 in ?1"',
                '{shape = "egg"}',
                "{holds = -1}",
            ]
            lines[at] = f"{lines[at].partition(' = ')[0]} = {self._one(values)}"
            file.write_text("\n".join(lines), errors="surrogateescape")
        else:
            self._spoil_file(file)
        arguments = [
            word if word != "drawn.svg" else self._one(["drawn.svg", "drawn.html"]) for word in ARGUMENTS["draw"]
        ]
        if name == "log.jsonl":
            arguments[1:3] = ["--log", name]
        command = (
            self._one(["draw", "draw", "serve"]) if name == "drawing.toml" and "serve" in self.commands else "draw"
        )
        return Input("drawings", command, (command, *(arguments if command == "draw" else ARGUMENTS[command])))

    def _session(self, folder: Path) -> Input:
        broken_live.spoil(self, folder)
        self.journal = broken_live.kept(folder)
        return Input("sessions", "serve", ("serve", *ARGUMENTS["serve"]))

    def _policy(self, folder: Path) -> Input:
        """Write a user's policy, or a saved policy or table."""
        if self.rng.random() < 0.3:
            (folder / "mine.py").write_text(text := self._one(POLICIES))
            command = self._one(["simulate", "bound"])
            arguments = [word for word in ARGUMENTS[command] if word not in ("--policy", "attention")]
            broken = text in ("", "\0", "\ufeff", "1/0", "quiet = 3", "def quiet(", "import nosuch")
            return Input("policies", command, (command, *arguments, "--policy", "mine.py:quiet"), broken)
        file = folder / self._one(["policy.npz", "table.npz"])
        shutil.copy(
            self.sound / "policy.npz" if file.stem == "policy" else next((self.sound / "out").glob("*.npz")), file
        )
        broken = False
        if self.rng.random() < 0.5:
            broken = self._spoil_file(file) and not file.read_bytes().startswith(b"PK")
        else:
            self._spoil_arrays(file, np.savez)
        return Input("policies", "load", ("load", file.name), broken)

    def _spoil_arrays(self, file: Path, save: Callable[..., None]) -> None:
        """Remove an array of an archive, or put something else in its place, as another version may have it."""
        with np.load(file) as arrays:
            found = {name: arrays[name] for name in arrays.files}
        name = self._one(list(found))
        match int(self.rng.integers(6)):
            case 0:
                del found[name]
            case 1:
                found[name] = np.array(["text"])
            case 2:
                found[name] = found[name][..., :0] if found[name].ndim else found[name][None]
            case 3:
                found[name] = np.full_like(found[name], np.nan if found[name].dtype.kind == "f" else 1).astype(
                    self._one([found[name].dtype, np.int8, np.float32, np.complex128])
                )
            case 4:
                found[f"{name}2"] = found.pop(name)
            case _:
                found[name] = found[name].T if found[name].ndim > 1 else found[name][..., None]
        save(file, **found)

    def _results(self, folder: Path) -> Input:
        command = self._one(["solve", "solve", "study" if "study" in self.commands else "solve"])
        files = sorted(path for path in (folder / ARGUMENTS[command][-2]).rglob("*") if path.is_file())
        files = [path for path in files if path.suffix in ("", ".jsonl", ".json", ".npz", ".plan")]
        file = self._one(files)
        chance = self.rng.random()
        if chance < 0.15:
            file.unlink()
        elif chance < 0.4:
            self._of_another_version(file)
        else:
            self._spoil_file(file)
        return Input("results", command, (command, *ARGUMENTS[command], "--resume"))

    def _of_another_version(self, file: Path) -> None:
        """Change a file of results as a version might that calls something by another name, or has it not, or more."""
        if file.suffix == ".npz":
            self._spoil_arrays(file, np.savez)
            return
        text = file.read_text()
        lines = [text] if file.suffix == ".json" else text.splitlines()
        try:
            records = [json.loads(line) for line in lines]
        except ValueError:  # a plan
            file.write_text("; made by version 0\n" + text)
            return
        inner: Any = records[0]
        while (deeper := [value for value in inner.values() if isinstance(value, dict) and value]) and (
            self.rng.random() < 0.5
        ):
            inner = self._one(deeper)
        key, other = self._one(list(inner)), self._one(["name", "version", "schema"])
        for record in records if inner is records[0] else [inner]:
            match int(self.rng.integers(3)):
                case 0:
                    record.pop(key, None)
                case 1:
                    record[other] = record.pop(key, None)
                case _:
                    record[other] = 0
        file.write_text("".join(json.dumps(record) + "\n" for record in records))

    def check(self, made: Input, folder: Path, done: dict[str, Any]) -> list[str]:
        """Return descriptions of what is wrong with how an input ended."""
        code, stdout, stderr = done["code"], done["stdout"], done["stderr"]
        wrong = []
        if done["trace"]:
            wrong.append(f"traceback: {done['trace'].strip().splitlines()[-1]}")
        elif code not in (0, 1, 2):
            wrong.append(f"exit code {code}")
        wrong += [words for words in ("Traceback", "internal error", "None: None") if words in stdout + stderr]
        if code in (1, 2) and not stderr.strip():
            wrong.append(f"exit code {code} without a word")
        if code == 0 and made.broken:
            wrong.append("success, though the input is broken")
        if made.kind == "sessions":
            wrong += broken_live.wrong(self.journal, folder, code)
        if code == 0 and made.command != "load":
            wrong += self._wrong_answer(made, folder, stdout)
        if left := [str(path) for path in folder.rglob(".unfinished-*")]:
            wrong.append(f"half-written: {left}")
        wrong += [f"half-written: {file.name}" for file in folder.glob("*.jsonl") if file.name in OUTPUTS
                  if not _is_json_lines(file)]  # fmt: skip
        return wrong

    def _wrong_answer(self, made: Input, folder: Path, stdout: str) -> list[str]:
        if not _is_json(stdout.encode()):
            return ["stdout is no JSON"]
        document = json.loads(stdout)
        if made.command == "solve" and made.kind in ("results", "numbers"):
            costs = {record["instance"]: record["cost"] for record in document}
            return [] if costs == self.costs else [f"wrong answer: {costs}"]
        if made.command == "solve":
            return [f"status {r['status']}" for r in document if r["status"] not in ("solved", "unsolvable")]
        if made.kind == "results" and (folder / "study" / "episodes.jsonl").read_bytes() != self.episodes:
            return ["wrong answer: other episodes than before"]
        return []


def _is_json(text: bytes) -> bool:
    def refuse(constant: str) -> None:
        raise ValueError(constant)

    try:
        json.loads(text.decode("utf-8-sig"), parse_constant=refuse)
    except (ValueError, RecursionError):
        return False
    return True


def _is_utf8(text: bytes) -> bool:
    try:
        text.decode()
    except ValueError:
        return False
    return True


def _is_json_lines(file: Path) -> bool:
    return all(_is_json(line) for line in _as_utf8(file.read_bytes()).split(b"\n") if line.strip())


def _as_utf8(text: bytes) -> bytes:
    """Return a log in UTF-8, as logs in UTF-16 and UTF-32 are read, too; unchanged what is neither."""
    try:
        return text.decode(json.detect_encoding(text)).encode()
    except UnicodeError:
        return text
