"""Log files: files written by people, pandas, R and spreadsheets are read, and ambiguous content is a fault."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pytest
from conftest import invoke, write_instance
from hypothesis import given
from hypothesis import strategies as st
from recorded import BACK, FETCH, RIGHT, WRONG, lines, log_of
from test_log import PLAN, text_of, used

from assist.declare.refusals import Refusal
from assist.learning.log import Log, read_log, told
from assist.learning.log_files import DASHES, MISSING
from assist.learning.replay import replay
from assist.people.action_names import words_of
from planner import Table, load, sweep
from planner.system.errors import plain

BASE = lines(FETCH, RIGHT, BACK, told={1: RIGHT})
HEAD = "person,episode,step,action,suggestion\n"
ROWS = f"ann,1,0,{FETCH},\nann,1,1,{RIGHT},{RIGHT}\nann,1,2,{BACK},\n"
WHOLE_STEPS = "as whole numbers"
DIALECTS = {
    "large steps of R": (HEAD + re.sub(r"1,(\d),", r"1,1e+05,", ROWS.splitlines()[0]) + "\n", "'1e+05'"),
    "missing as blanks": (HEAD + ROWS.replace(",\n", ",  \n"), ""),
    "blanks after separators": ((HEAD + ROWS).replace(",", ", "), ""),
    **{f"blanks around {name}": ((HEAD + ROWS).replace(",", f" {sign} "), "")
       for name, sign in {"commas": ",", "semicolons": ";", "bars": "|", "tabs": "\t"}.items()},
    "several blanks around separators": ((HEAD + ROWS).replace(",", "   ;  "), ""),
    "blanks around quoted cells": (re.sub(r"[^,\n]+", r' "\g<0>" ', HEAD + ROWS), ""),
    "a separator in quotes beside blanks": (
        HEAD + re.sub(r"\((\S+) (\S+) (\S+) (\S+)\)", r' "\1(\2, \3, \4)" ', ROWS), "",
    ),
    "as a database prints it": (
        (HEAD + "-----+---+---+------+----\n" + ROWS).replace(",", " | ").replace("-+-", "-+-") + "(3 rows)\n", "",
    ),
    "in a frame": (
        re.sub("(?m)^(.*)$", r"| \1 |", (HEAD + "-+-+-+-+-\n" + ROWS).strip().replace(",", " | "))
        .replace("| -+-", "|--+--").replace("-+- |", "--+--|"), "",
    ),
    "in a frame of lines": (
        "+---+---+---+---+---+\n" + re.sub("(?m)^(.*)$", r"| \1 |", (HEAD + ROWS).strip().replace(",", " | "))
        + "\n+---+---+---+---+---+\n", "",
    ),
    "two tables, one after the other": (HEAD + ROWS.splitlines()[0] + "\n" + HEAD
                                        + "\n".join(ROWS.splitlines()[1:]) + "\n",
                                        "line 3, with the names of the columns, as the beginning of a further table"),
    "empty cells at the end": (HEAD + ROWS.replace("\n", ",,\n"), ""),
    "empty columns in the first line only": (HEAD.replace("\n", ",,\n") + ROWS, ""),
    "an index that the first line leaves out": (
        '"person" "episode" "step" "action" "suggestion"\n'
        + f'"1" "ann" "1" 0 "{FETCH}" NA\n"2" "ann" "1" 1 "{RIGHT}" "{RIGHT}"\n"3" "ann" "1" 2 "{BACK}" NA\n',
        "the first column, which has no name, as numbers of rows, 'NA' as a missing value",
    ),
    "such an index, and no suggestion in quotes": (
        '"person" "episode" "step" "action" "suggestion"\n'
        + f'"1" "ann" "1" 0 "{FETCH}" ""\n"2" "ann" "1" 1 "{RIGHT}" "{RIGHT}"\n"3" "ann" "1" 2 "{BACK}" ""\n',
        "the first column, which has no name, as numbers of rows",
    ),
    "blank lines": ("\n" + HEAD + "\n" + ROWS.replace("\n", "\n\n") + ",,,,\n", ""),
    "line breaks in a cell": (
        "note," + HEAD + "".join(f'"two\nlines",{row}\n' for row in ROWS.splitlines()), "",
    ),
    "other columns": ("time," + HEAD + "".join(f"12:0{k},{row}\n" for k, row in enumerate(ROWS.splitlines())), ""),
}  # fmt: skip


@pytest.mark.parametrize("dialect", DIALECTS)
def test_tables_are_read_as_programs_write_them(tmp_path: Path, dialect: str) -> None:
    text, note = DIALECTS[dialect]
    file = tmp_path / "log.csv"
    file.write_bytes(text.encode())
    log = read_log(file)
    assert log.faults == ()
    wanted = [words_of(text) for row in BASE for text in (row["action"], row["suggestion"]) if text]
    count = 1 if dialect == "large steps of R" else 3
    assert [words_of(text) for entry in log.entries for text in entry.texts] == wanted[: 1 if count == 1 else None]
    assert [entry.step for entry in log.entries] == ([100_000] if count == 1 else [0, 1, 2])
    assert {entry.names for entry in log.entries} == {("ann", "1")}
    if dialect == "line breaks in a cell":
        assert [entry.line for entry in log.entries] == [2, 4, 6]
    assert note in log.note
    assert bool(note) == bool(log.note)


JSON_FORMS = {
    "steps with decimals": ([{**row, "step": float(row["step"])} for row in BASE], {}),
    "steps as text": ([{**row, "step": str(row["step"])} for row in BASE], {}),
    "missing as NaN": ([{**row, "suggestion": row["suggestion"] or float("nan")} for row in BASE], {}),
    "missing as text": ([{**row, "suggestion": row["suggestion"] or "NA"} for row in BASE], {}),
    "missing left out": ([{k: v for k, v in row.items() if v is not None} for row in BASE], {}),
    "upper case": ([{key.upper(): value for key, value in row.items()} for row in BASE], {}),
    "other names": ([{k.replace("person", "worker"): v for k, v in row.items()} for row in BASE], {"person": "Worker"}),
    "numbers for names": ([{**row, "episode": 1} for row in BASE], {}),
}  # fmt: skip


@pytest.mark.parametrize("form", JSON_FORMS)
def test_objects_are_read_as_programs_write_them(tmp_path: Path, form: str) -> None:
    rows, columns = JSON_FORMS[form]
    same = [{**vars(entry), "line": 0} for entry in Log.of(BASE).entries]
    for text in ("\n".join(text_of(rows)) + "\n", json.dumps(rows), json.dumps(rows, indent=2)):
        file = tmp_path / "log.json"
        file.write_text(text)
        log = read_log(file, columns=columns)
        assert log.faults == ()
        assert [{**vars(entry), "line": 0} for entry in log.entries] == same
    assert [entry.line for entry in log.entries] == [2, 2 + 2 + len(rows[0]), 2 + 4 + len(rows[0]) + len(rows[1])]
    if set(rows[1]) == set(BASE[1]):
        assert Log.of(rows).faults == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD + ROWS.replace(",1,1,", ",1,0.5,"), "'step' is \"0.5\"; expected a whole number"),
        (HEAD + ROWS.replace(",1,1,", ',1,"1,000",'), "'step' is \"1,000\"; expected a whole number"),
        (HEAD + ROWS.replace(",1,1,", ",1,NA,"), "'step' is null; expected a whole number"),
        (HEAD + ROWS.replace("ann,1,1", "None,1,1"), "'person' is null; expected a name"),
        (HEAD + ROWS.replace(f"{RIGHT},{RIGHT}", f"{RIGHT},TRUE"), "'suggestion' is true; expected an action as text"),
        (HEAD + ROWS.replace(f",{RIGHT},", ",TRUE,"), "'action' is true; expected an action as text"),
        (HEAD + re.sub(r"1,(\d),", r"1,\1,0,", ROWS), "6 cells; expected 5, as in the first line"),
        (HEAD.replace("step", "person") + ROWS, "2 columns are called person; expected one"),
        (HEAD.replace("person", "worker") + ROWS, "columns={'person': NAME}) with one of worker, episode, step"),
        (json.dumps(BASE)[:-9], "not JSON; expected a list of objects; what comes after it is not read"),
        (json.dumps(BASE) + "\nBASE", "there is more after the list; what comes after it is not read"),
        (json.dumps({**BASE[0], "Person": "bob"}) + "\n", "two fields are called person"),
        ('{"person": "bob", ' + json.dumps(BASE[0])[1:] + "\n", "two fields are called person"),
        ("[" + json.dumps(BASE[0])[:-1] + ', "step": 3}]', "two fields are called step"),
        (json.dumps({**BASE[0], "person": " "}) + "\n", "'person' is null; expected a name"),
        (json.dumps({**BASE[0], "episode": ""}) + "\n", "'episode' is null; expected a name"),
        ("PK\x03\x04" + HEAD, "this is a spreadsheet's own file, or an archive; expected a text file"),
        ("PAR1" + HEAD, "this is a Parquet file; expected a text file, CSV or JSON Lines"),
    ],
    ids=[str(n) for n in range(18)],
)
def test_what_may_mean_two_things_is_not_guessed(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "log.csv"
    if text.startswith(("[", "{")):
        file = file.with_suffix(".json")
    file.write_text(text)
    assert message in "\n".join(told(read_log(file).faults, file.name))


def test_what_was_taken_for_what_is_said_once(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text(HEAD + ROWS.replace("ann", "NA"))
    log = read_log(file)
    assert (log.people, log.note) == ({"NA"}, "read NA as the name of a person")
    doubtful = Log.of([row | {"uncertain": row["step"] > 0} for row in BASE])
    assert doubtful.note.startswith("read line 2 and 1 more, with an action that was seen with doubt")
    rows = [dict(row, action=row["action"].strip(")"), person=f"p{k}") for k in range(9) for row in lines(*PLAN)]
    assert told(Log.of(rows).faults, "log")[:3] == [
        "log:1: person 'p0', episode '1', which is left out: 'action' opens 1 and closes 0 brackets; expected (name "
        "argument ...) or name(argument, ...) (and so 53 more, to line 54)"
    ]


@given(st.data())
def test_tables_of_any_dialect_are_read_back(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    names = st.text(st.characters(blacklist_categories=("Cc", "Cs", "Z")), min_size=1, max_size=5).filter(
        lambda name: plain(name) == name and name not in MISSING | DASHES and not name.startswith(("#", "{", "["))
    )
    people = data.draw(st.lists(names, min_size=1, max_size=3, unique=True))
    rows = [row for person in people for row in lines(FETCH, RIGHT, BACK, person=person, told={1: WRONG})]
    missing = data.draw(st.sampled_from(["", *sorted(MISSING | DASHES)]))
    step = data.draw(st.sampled_from(["{}", "{}.0", "{}.000", "{},0"]))
    form = data.draw(st.sampled_from(["{} {}", "({} {})", "{}({})"]))
    separator = data.draw(st.sampled_from(",;\t|"))

    def written(action: str | None) -> str:
        if action is None:
            return missing
        name, *arguments = action.strip("()").split()
        return form.format(name, (", " if form == "{}({})" else " ").join(arguments))

    order = data.draw(st.permutations(list(rows[0])))
    index = data.draw(st.booleans())
    spare = data.draw(st.integers(0, 2))
    out = io.StringIO()
    writer = csv.writer(
        out, delimiter=separator, quoting=data.draw(st.sampled_from([csv.QUOTE_MINIMAL, csv.QUOTE_ALL])),
        lineterminator=data.draw(st.sampled_from(["\n", "\r\n", "\r"])),
    )  # fmt: skip
    case = data.draw(st.sampled_from([str.upper, str.title, str]))
    writer.writerow([*([""] * index), *(case(name) for name in order), *([""] * spare)])
    for number, row in enumerate(rows):
        cells = {**row, "step": step.format(row["step"]), **{k: written(row[k]) for k in ("action", "suggestion")}}
        writer.writerow([*([number] * index), *(cells[name] for name in order), *([""] * spare)])
    declared = data.draw(st.sampled_from(["", f"sep={separator}\n", f'"sep={separator}"\n']))
    file = tmp_path_factory.mktemp("log") / "log.csv"
    encoding = data.draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]))
    file.write_bytes((declared + out.getvalue()).encode(encoding))
    log = read_log(file)
    assert log.faults == ()
    assert (f"{missing!r} as a missing value" in log.note) == bool(missing)
    assert (WHOLE_STEPS in log.note) == (step != "{}")
    found = [(e.person, e.episode, e.step, *(words_of(t) for t in e.texts)) for e in log.entries]
    assert found == [(e.person, e.episode, e.step, *(words_of(t) for t in e.texts)) for e in Log.of(rows).entries]


def by_columns(rows: list[dict]) -> dict:
    """As pandas writes a frame unless told otherwise."""
    return {key: {str(n): row[key] for n, row in enumerate(rows)} for key in rows[0]}


NAMES = list(BASE[0])
CELLS = [list(row.values()) for row in BASE]
SHAPES = {
    "by columns": by_columns(BASE),
    "by columns, as lists": {key: [row[key] for row in BASE] for key in NAMES},
    "by rows": {str(n): row for n, row in enumerate(BASE)},
    "split": {"columns": NAMES, "index": [0, 1, 2], "data": CELLS},
    "as a table with a schema": {"schema": {"fields": [{"name": key} for key in NAMES]}, "data": BASE},
    "within an object": {"data": BASE, "version": 3},
    "within an object of another name": {"trials": BASE},
    "lists": [NAMES, *CELLS],
    "a list of lists of records": [BASE[:2], BASE[2:]],
}


JSON_TEXTS = {
    **{name: json.dumps(shape) for name, shape in SHAPES.items()},
    **{f"{name}, pretty": json.dumps(shape, indent=2) for name, shape in SHAPES.items()},
    "a list of records a line": "\n".join(map(json.dumps, [BASE[:2], BASE[2:]])),
    "a list a line, the first with names": "\n".join(map(json.dumps, [NAMES, *CELLS])),
    "an object of several a line": "\n".join(json.dumps({"data": rows}) for rows in (BASE[:2], BASE[2:])),
    "records one after the other, as jq writes them": "\n".join(json.dumps(row, indent=1) for row in BASE),
}


@pytest.mark.parametrize("shape", JSON_TEXTS)
def test_json_is_read_in_the_shapes_of_pandas_and_others(tmp_path: Path, shape: str) -> None:
    file, text = tmp_path / "log.json", JSON_TEXTS[shape] + "\n"
    file.write_text(text)
    log = read_log(file)
    assert (log.faults, log.note) == ((), "")
    assert [{**vars(e), "line": 0} for e in log.entries] == [{**vars(e), "line": 0} for e in Log.of(BASE).entries]
    if "jq" in shape:
        assert [entry.line for entry in log.entries] == [1, 8, 15]
    file.write_text(text.replace('"person"', '"Worker"'))
    assert len(read_log(file, columns={"person": "worker"}).entries) == 3


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"person": ["ann"], "episode": ["1"], "step": [0, 1], "action": [FETCH]},
         "log.json:1: columns of different lengths: person 1, episode 1, step 2, action 1"),
        (CELLS, "log.json:1: expected an object, "),
        ([NAMES, CELLS[0][:3]], "log.json:1: a list of 3; expected 5, as in the first"),
        ({"ann": [1], "bob": [2]}, "log.json:1: there is no 'person'; expected a name"),
        ({"name": "kit", **{key: [row[key] for row in BASE * 9] for key in NAMES}}, "; expected a name"),
    ],
)  # fmt: skip
def test_other_shapes_of_json_are_refused_in_one_short_line(tmp_path: Path, content: object, message: str) -> None:
    file = tmp_path / "log.json"
    file.write_text(json.dumps(content))
    (line,) = told(read_log(file).faults, file.name)
    assert message in line
    assert len(line) < 200


TIMES = {
    "seconds since 1970": ["1709287200", "1709287203", "1709287210"],
    "seconds since 1970 with decimals": [1709287200.25, 1709287200.75, 1709287201],
    "seconds": ["0.5", "3.25", "12.125"],
    "seconds with decimal commas": ["0,5", "3,25", "12,75"],
    "dates": ["2024-03-01T10:00:03", "2024-03-01T10:00:12", "2024-03-01T10:01:00"],
    "dates of spreadsheets": ["2024-03-01 10:00:03.5", "2024-03-01 10:00:03.75", "2024-03-02 00:00:00"],
    "dates with their zone": ["2024-03-01T10:59:03+01:00", "2024-03-01T10:00:12Z", "2024-03-01T10:00:13Z"],
    "dates with slashes": ["2024/03/01 10:00:03", "2024/03/01 10:00:12", "2024/03/01 10:01:00"],
    "times of the clock": ["9:59:58", "10:00:03", "10:00:12"],
    "hours and minutes": ["09:58", "09:59", "10:00"],
    "minutes and seconds with decimals": ["00:58.5", "00:59.25", "01:00.0"],
}


@pytest.mark.parametrize("form", TIMES)
def test_steps_may_be_times_if_there_may_be_gaps(tmp_path: Path, tiny: Table, form: str) -> None:
    """The actions of an episode are in the order of their times, whatever that of the lines is."""
    rows = [dict(row, step=step) for row, step in zip(BASE, TIMES[form], strict=True)]
    file = tmp_path / "log.jsonl"
    for order in ([0, 1, 2], [2, 0, 1]):
        file.write_text("".join(f"{text_of(rows)[n]}\n" for n in order))
        log = read_log(file, gaps=True)
        recording, faults = replay(log, tiny)
        assert (log.faults, faults, len(recording)) == ((), [], 3)
        assert ("in whose order actions are numbered" in log.note) == (form != "seconds since 1970")
    assert len(replay(Log.of(rows, gaps=True), tiny)[0]) == 3
    faults_without = read_log(file).faults
    assert faults_without
    assert all("gaps=true" in fault.message or "expected a whole number" in fault.message for fault in faults_without)


def test_times_that_cannot_be_ordered_are_faults(tiny: Table) -> None:
    def faults(*steps: object) -> str:
        log = Log.of([dict(row, step=step) for row, step in zip(BASE, steps, strict=True)], gaps=True)
        return "\n".join(told([*log.faults, *replay(log, tiny)[1]], "log"))

    assert "log:1: person 'ann', episode '1', which is left out: times of the clock" in faults("23:59", "0:03", "0:04")
    assert "go on after midnight; expected dates, too" in faults("23:59:01", "0:00:03", "0:00:04")
    assert "is on line 2 already" in faults("10:00:03", "10:00:04", "10:00:04")
    assert "'step' is \"10:00\"; expected a whole number" in faults("2024-03-01 10:00", "2024-03-01 10:01", "10:00")
    assert "'step' is \"1,250\"; expected a whole number" in faults("3", "7", "1,250")
    assert "'step' is \"3/1/2024 10:00\"; expected a whole" in faults("3/1/2024 10:00", "10:00", "10:01")


SIGNS = {
    "a space of no width": ("ann\u200b", "ann", "U+200B (zero width space) as nothing (first on line 4)"),
    "a mark of direction": ("\u200fann", "ann", "U+200F (right-to-left mark) as nothing (first on line 4)"),
    "a mark of byte order": ("\ufeffann", "ann", "U+FEFF (zero width no-break space) as nothing (first on line 4)"),
    "a soft hyphen": ("an\u00adn", "ann", "U+00AD (soft hyphen) as nothing (first on line 4)"),
    "a joiner": ("ann\u200d", "ann", "U+200D (zero width joiner) as nothing (first on line 4)"),
    "a space that does not break": ("ann\u00a0lee", "ann lee", "U+00A0 (no-break space) as a space (first on line 4)"),
    "a letter in two parts": ("Zoe\u0308", "Zo\u00eb", "decomposed letters as composed ones (first on line 4)"),
    "spaces around": (" ann  lee ", "ann lee", ""),
}


@pytest.mark.cases
def test_a_date_of_which_the_month_is_not_known_is_refused_or_told() -> None:
    """A step is refused with the form that is read; the order of episodes is told where it may not be that of days."""
    for step in ("01.03.2026 09:00", "3/1/2026 9:00", "1-3-26", "2026-03-01 9:00"):
        faults = Log.of([dict(row, step=step) for row in BASE], gaps=True).faults
        assert "or a date with a time such as 2026-03-01T09:00:00" in faults[0].message
    for names, told_of in (
        (("01.03.2026", "01.04.2026"), None),
        (("28.02.2026", "01.03.2026"), "01.03.2026"),  # by name, 1 March is before 28 February
        (("12/31/2025", "1/2/2026"), "1/2/2026"),
        (("3/1/2026", "3/2/2026"), None),
        (("2026-02-28", "2026-03-01"), None),
    ):
        note = Log.of([dict(BASE[0], episode=name) for name in names]).note
        right = (
            f"read episodes such as '{told_of}' in the order of these numbers, perhaps not of days; expected 2026-03-01"
        )
        assert note == ("" if told_of is None else right)


@pytest.mark.parametrize("sign", SIGNS)
def test_names_that_look_the_same_are_one_person(tmp_path: Path, sign: str) -> None:
    strange, usual, note = SIGNS[sign]
    rows = [*lines(FETCH, RIGHT, BACK, person=usual), *lines(FETCH, RIGHT, BACK, person=strange, episode="2")]
    file = tmp_path / "log.jsonl"
    file.write_text("\n".join(json.dumps(row, ensure_ascii=False) for row in rows) + "\n")
    log = read_log(file)
    assert (log.people, log.faults, log.note) == ({usual}, (), f"read {note}" if note else "")
    assert Log.of(rows).people == {usual}


def test_other_unseen_signs(tmp_path: Path, tiny: Table) -> None:
    """Joiners within words of other scripts and pictures stay."""
    persian, engineer = "\u0645\u06cc\u200c\u062e\u0648", "\U0001f469\u200d\U0001f527"
    assert [plain(persian), plain(engineer)] == [persian, engineer]
    file = tmp_path / "log.csv"
    file.write_text("\ufeff" + (HEAD + ROWS).replace("step", "\u200bstep").replace(")", ")\u200b"))
    assert used(file, tiny) == {"ann": 3}
    assert "U+200B (zero width space) as nothing (first on line 2)" in read_log(file).note


FOREIGN = {
    "PsychoPy": ("action,hint,trials.thisN,keys,participant,session\n,,,space,ann,001\n"
                 f"{FETCH},,0,1,ann,001\n{RIGHT},{RIGHT},1,1,ann,001\n{BACK},,2,1,ann,001\n,,,,ann,001\n",
                 "person=participant,episode=session,step=trials.thisN,suggestion=hint"),
    "jsPsych": ("trial_type,trial_index,subject,block,move,hint\ninstructions,0,ann,,,\n"
                f"html,0,ann,1,{FETCH},\nhtml,1,ann,1,{RIGHT},{RIGHT}\nhtml,2,ann,1,{BACK},\nend,3,ann,,,\n",
                "person=subject,episode=block,step=trial_index,action=move,suggestion=hint"),
    "jsPsych's JSON": (json.dumps([{"trial_type": "instructions", "trial_index": 0}, *(
        {"trial_index": row["step"], "subject": "ann", "block": 1, "move": row["action"], "hint": row["suggestion"]}
        for row in BASE), {"trial_type": "end", "trial_index": 9}]),
        "person=subject,episode=block,step=trial_index,action=move,suggestion=hint"),
}  # fmt: skip


@pytest.mark.parametrize("program", FOREIGN)
def test_rows_outside_of_episodes_are_no_part_of_them(tmp_path: Path, tiny: Table, program: str) -> None:
    """Programs for experiments write a row for instructions and for the end, without an action."""
    text, columns = FOREIGN[program]
    file = tmp_path / ("log.json" if text[0] == "[" else "log.csv")
    file.write_text(text)
    log = read_log(file, columns=dict(pair.split("=") for pair in columns.split(",")))
    recording, faults = replay(log, tiny)
    assert (log.faults, faults, len(recording)) == ((), [], 3)
    assert [int(n) for n in recording.suggested >= 0] == [0, 1, 0]
    assert "without an action in a step of an episode, as no part of one" in log.note
    if program == "jsPsych":  # instructions within an episode
        head, *rows = text.splitlines()[:-1]
        within = [row.replace(f"html,{n}", f"html,{2 * n + 1}") for n, row in enumerate(rows[1:])]
        file.write_text("\n".join([head, "instructions,0,ann,1,,", *within, ""]))
        log = read_log(file, columns=dict(pair.split("=") for pair in columns.split(",")), gaps=True)
        recording, faults = replay(log, tiny)
        assert (log.faults, faults, len(recording)) == ((), [], 3)


@pytest.mark.parametrize("column", ["Hint", "advice", "Suggested", "robot said"])
def test_a_column_that_may_have_suggestions_is_asked_about(tmp_path: Path, column: str) -> None:
    """By its name, or since it has actions."""
    how = f"--columns suggestion={column} (in Python columns={{'suggestion': '{column}'}})"
    asked = f"column '{column}' is not read; {how} if it has suggestions"
    csv_file, json_file = tmp_path / "log.csv", tmp_path / "log.json"
    csv_file.write_text(HEAD.replace("suggestion", column) + ROWS)
    json_file.write_text(json.dumps([{k.replace("suggestion", column): v for k, v in row.items()} for row in BASE]))
    for file in (csv_file, json_file):
        log = read_log(file)
        assert (log.faults, log.note) == ((), asked)
        assert read_log(file, columns={"suggestion": column}).note == ""


def test_other_columns_are_not_asked_about(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    file.write_text(f"time,{HEAD}" + "".join(f"12:0{k},{row}\n" for k, row in enumerate(ROWS.splitlines())))
    assert read_log(file).note == ""
    file.write_text(f"last,{HEAD}" + "".join(f"{FETCH},{row}\n" for row in ROWS.splitlines()))
    assert read_log(file).note == ""
    file.write_text(HEAD.replace("suggestion", "hint") + re.sub(r",[^,]*$", ",", ROWS, flags=re.M))  # empty
    assert read_log(file).note == ""


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"])
def test_unicode_is_read_in_any_form(tmp_path: Path, tiny: Table, encoding: str) -> None:
    """Spreadsheets and other systems write these encodings; a damaged line affects no other line."""
    file = tmp_path / "log.jsonl"
    texts = [*text_of(lines(*PLAN, person="Zoë")), *text_of(lines(*PLAN))]
    file.write_text("\n".join(texts) + "\n", encoding=encoding)
    log = read_log(file)
    assert (log.faults, log.note) == ((), f"read as {encoding[:6].upper()}")
    assert used(file, tiny) == {"Zoë": len(PLAN), "ann": len(PLAN)}
    raw = file.read_bytes()
    width = 4 if "32" in encoding else 2
    half = b"\x00\xd8" if encoding in ("utf-16", "utf-16-le") else b"\xd8\x00"  # half of a pair
    spoilt = half.ljust(width, b"\xd8") if width == 4 else half
    end = len(raw) - width
    file.write_bytes(raw[: end - 2 * width] + spoilt + raw[end - width :])
    assert used(file, tiny) == {"Zoë": len(PLAN)}
    assert read_log(file).faults[0].line == len(texts)


FORMS = {
    ("place", "hammer", "slot-1"): [
        "(place hammer slot-1)", "place hammer slot-1", "place(hammer, slot-1)", "PLACE(hammer,slot-1)",
        "( place hammer slot-1 )", "place (hammer slot-1)", " place( hammer , slot-1 )\n", "(place hammer, slot-1)",
    ],
    ("open",): ["(open)", "open", "open()", "open ( )", "( open)"],
}  # fmt: skip


def test_actions_are_read_in_every_form() -> None:
    for words, texts in FORMS.items():
        assert {words_of(text) for text in texts} == {words}
        assert {words_of(text, {"place": "put"}) for text in texts} == {tuple(w.replace("place", "put") for w in words)}
    for text in ("(place hammer", "place hammer)", "((place hammer))", "place(hammer", "place(a)(b)",
                 "(place (hammer))", ")place(", "place(hammer) slot"):  # fmt: skip
        with pytest.raises(Refusal, match=r"brackets"):
            words_of(text)


def test_columns_are_named_on_the_command_line(tmp_path: Path) -> None:
    plain, named = tmp_path / "plain.csv", tmp_path / "named.csv"
    plain.write_text(HEAD + ROWS)
    head = HEAD.replace("person", "Worker").replace("action", "move").replace("suggestion", "person")
    named.write_text(head + ROWS)
    mapped = ("--columns", "person=worker,action=move", "--columns", " suggestion = Person ")
    first, second = (
        invoke("fit", "kitting/tiny", file, *more, "--jobs", 1, "--json")
        for file, more in ((plain, ()), (named, mapped))
    )
    assert json.loads(first.stdout)[0]["suggestions"] == 1
    assert (second.exit_code, second.stdout) == (first.exit_code, first.stdout)
    # First estimates are shown only where something is compiled.
    notes = [
        "".join(line for line in one.stderr.splitlines(True) if not line.startswith("first, "))
        for one in (first, second)
    ]
    assert notes[1] == notes[0].replace("plain", "named")
    noted = tmp_path / "noted.csv"
    noted.write_text(HEAD + ROWS.replace(",\n", ",NA\n"))
    found = invoke("fit", "kitting/tiny", noted, "--jobs", 1, "--json")
    assert (found.stdout, found.stderr.count(f"{noted}: read 'NA' as a missing value")) == (first.stdout, 1)


def test_an_action_that_never_changes_anything_can_be_dropped(tmp_path: Path) -> None:
    """Going from a room to itself: the grounded task does not have it, and the rest of the episode is used."""
    domain = """(define (domain rooms) (:predicates (at ?r) (room ?r))
        (:action go :parameters (?a ?b) :precondition (and (at ?a) (room ?b)) :effect (and (not (at ?a)) (at ?b))))"""
    problem = """(define (problem one) (:domain rooms) (:objects a b c) (:init (at a) (room a) (room b) (room c))
        (:goal (at c)))"""
    rooms = sweep(load(write_instance(tmp_path, domain, problem)))
    assert "(go b b)" not in rooms.task.actions
    rows = lines("(go a b)", "(go b b)", "(go b c)")
    recording, faults = replay(log_of(rows), rooms)
    assert (len(recording), [fault.line for fault in faults]) == (0, [2])
    assert "(go b b) is no action of the task; actions that can never be done, or never change" in faults[0].message
    recording, faults = replay(log_of(rows), rooms, drop=["(go b b)"])
    assert (len(recording), faults) == (2, [])
    assert len(replay(log_of(rows), rooms, drop=["go b"])[0]) == 1  # all that begin so


class Frame:
    """A data frame, as far as a log asks for it."""

    def __init__(self, *names: str) -> None:
        self.columns = names

    def to_dict(self, how: str) -> list[dict[str, object]]:
        assert how == "records"
        return [dict.fromkeys(self.columns, 1)] * 3


@pytest.mark.cases
def test_a_frame_without_a_column_is_told_as_a_table_is() -> None:
    log = Log.of(Frame("worker", "episode", "step", "action"))  # type: ignore[arg-type]
    (fault,) = log.faults
    assert "no column is called person; expected person, episode, step, action" in str(fault)
    assert "with one of worker, episode, step, action" in str(fault)


@pytest.mark.cases
def test_one_column_has_one_role(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(HEAD + ROWS)
    with pytest.raises(ValueError, match="columns suggestion=action: 'action' is the column of the action already"):
        read_log(tmp_path / "log.csv", columns={"suggestion": "action"})
    (tmp_path / "log.csv").write_text((HEAD + ROWS).replace("person", "place"))
    log = read_log(tmp_path / "log.csv", columns={"person": "place"})
    assert [(entry.person, entry.place) for entry in log.entries] == [("ann", None)] * 3


@pytest.mark.cases
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", ["no recorded actions; expected a line for each, as JSON or in a table"]),
        (HEAD, ["no recorded actions; expected a line for each, as JSON or in a table"]),
        ((HEAD + ROWS).replace("step", "number"), ["no column is called step; ", "no line can be used"]),
        ((HEAD + ROWS).replace("(fetch", "(fetch(").replace("(place", "(place(").replace("(return", "(return("),
         ["opens 2 and closes 1 brackets", "0 of 1 episodes are used", "no episode can be used"]),
    ],
    ids=["nothing", "names", "no step", "brackets"],
)  # fmt: skip
def test_what_makes_a_log_useless_is_said_once(tmp_path: Path, text: str, said: list[str]) -> None:
    (tmp_path / "log.csv").write_text(text)
    done = invoke("fit", "kitting/tiny", tmp_path / "log.csv")
    found = done.stderr.splitlines()
    assert done.exit_code == 1
    for words in said:
        assert sum(words in line for line in found) == 1
    assert len(set(found)) == len(found)
