"""Logs: lines that can be read, faults that exclude an episode, and the replay of the rest."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from conftest import invoke, kit
from hypothesis import given
from hypothesis import strategies as st
from recorded import BACK, FETCH, RIGHT, WRONG, lines, log_of, write_log

from assist.learning import EvaluatedStates, Log, Method, fit_influence, observe, read_log, replayed
from assist.learning.log import told
from assist.learning.maximum_likelihood import maximum_likelihood
from assist.learning.replay import replay
from assist.people import Choices, Population
from assist.team import Pool, TeamAction, TeamState
from assist.team.pool import Setting
from assist.team.simulate import simulate
from assist.team.trace import Trace
from planner import InputFileError, Table

PAPER = kit("paper")
PAPER_PLAN = PAPER.optimal_plan() or []
PLAN = kit("tiny").optimal_plan() or []


def text_of(rows: list[dict]) -> list[str]:
    return [json.dumps(row) for row in rows]


def used(file: Path, table: Table, **options: bool) -> dict[str, int]:
    """Return the number of replayed actions of each person."""
    recording, _ = replay(read_log(file, **options), table)
    return {person: int((recording.person == k).sum()) for k, person in enumerate(recording.people)}


def test_of_several_tasks_only_the_lines_of_the_instance_are_read(tmp_path: Path, tiny: Table) -> None:
    """Episodes of other tasks may have the same names, unknown actions and gaps."""
    own = [row | {"task": "kitting/tiny"} for row in lines(*PLAN)]
    others = [row | {"task": "order-2"} for row in lines("(open lid)", FETCH)[1:]]
    seen = replayed(tiny, [*others, *own])
    assert seen.complete
    assert len(seen.recording) == len(PLAN)
    windows = [row | {"task": r"kitting\tiny"} for row in own]
    assert len(replayed(tiny, [*others, *windows]).recording) == len(PLAN)
    assert "only lines of the task kitting/tiny, without 1 others" in seen.log.note
    shown = invoke("fit", "kitting/tiny", str(write_log(tmp_path / "log.jsonl", [*others, *own])))
    assert shown.exit_code == 0
    assert "lines: order-2 1, kitting/tiny" in shown.stderr
    alone = replayed(tiny, [row | {"task": "desk"} for row in lines(*PLAN)])
    assert len(alone.recording) == len(PLAN)
    assert "lines of the task 'desk' as those of 'tiny'" in alone.log.note
    assert not replayed(tiny, lines(*PLAN)).log.note
    unknown = [*others, *(row | {"task": "desk"} for row in lines(*PLAN))]
    with pytest.raises(
        InputFileError, match=r"several tasks .order-2 1, desk .*expected lines of 'tiny'.*means something else"
    ):
        replayed(tiny, unknown)
    with pytest.raises(InputFileError, match=r"several tasks .order-2, kitting/tiny. were read"):
        replayed(tiny, Log.of([*others, *own]))
    with pytest.raises(TypeError, match="columns: expected a file, records or a frame, not a log"):
        replayed(tiny, Log.of(own), columns={"person": "worker"})


@pytest.mark.parametrize("line", [1, 2, 5, 8, 9])
@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.5, 0.8])
def test_a_broken_line_costs_its_episode_and_no_other(tmp_path: Path, line: int, share: float) -> None:
    """However little is left of a line, nothing is replayed from states that the person was not in."""
    first, second = lines(*PAPER_PLAN), lines(*PAPER_PLAN, person="bob")
    texts = text_of(first)
    texts[line - 1] = texts[line - 1][: int(share * len(texts[line - 1]))] + "#"
    file = tmp_path / "log.jsonl"
    for others in ([], text_of(second)):
        file.write_text("\n".join([*texts, *others]) + "\n")
        log = read_log(file)
        assert used(file, PAPER) == ({"bob": len(PAPER_PLAN)} if others else {})
        assert line in {fault.line for fault in log.faults}
        assert [str(fault) for fault in log.faults if fault.episode == "1" and "which is left out" in str(fault)]


@given(st.data())
def test_no_broken_line_makes_a_mistake(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    """Whichever lines of a log are cut, joined, lost or damaged, people who follow the plan never appear to err."""
    rows = [row for k in range(3) for row in lines(*PAPER_PLAN, person=f"p{k % 2}", episode=str(k))]
    order = data.draw(st.permutations(range(3)))
    raw = [json.dumps(row).encode() for k in order for row in rows[k * len(PAPER_PLAN) : (k + 1) * len(PAPER_PLAN)]]
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(raw) - 2))
        begin, end = sorted(data.draw(st.tuples(*[st.integers(0, len(raw[at]))] * 2)))
        kind = data.draw(st.sampled_from(["cut", "bytes", "join", "lose"]))
        if kind == "cut":
            raw[at] = raw[at][:begin] + raw[at][end:] if data.draw(st.booleans()) else raw[at][:begin]
        elif kind == "bytes":
            raw[at] = raw[at][:begin] + b"\xff" + raw[at][begin:]
        elif kind == "join":
            raw[at : at + 2] = [raw[at] + raw[at + 1]]
        else:
            raw[at : at + 1] = []
    file = tmp_path_factory.mktemp("log") / "log.jsonl"
    file.write_bytes(b"\n".join(raw) + b"\n")
    recording, _ = replay(read_log(file), PAPER)
    after = PAPER.h[recording.targets[np.arange(len(recording)), recording.chosen]]
    assert (after < PAPER.h[recording.state]).all()


def test_actions_as_people_write_them(tiny: Table) -> None:
    rows = lines(
        "(FETCH Box-A)", "place hammer slot-1", "( return )", "(open box-b)", told={1: "(place HAMMER slot-2)"}
    )
    rows = [dict(row, step=2 * row["step"]) for row in rows]
    rows.insert(1, {"person": "ann", "episode": "1", "step": 1, "action": "(Wait-a-little)", "suggestion": None})
    recording, faults = replay(log_of(rows), tiny, drop=["wait-a-little"], rename={"open": "fetch"})
    assert faults == []
    assert recording.state.tolist()[0] == tiny.initial
    assert [int(n) for n in recording.suggested >= 0] == [0, 1, 0, 0]
    plain, _ = replay(log_of(lines(FETCH, RIGHT, BACK, "(fetch box-b)", told={1: WRONG})), tiny)
    np.testing.assert_array_equal(recording.state, plain.state)
    np.testing.assert_array_equal(recording.chosen, plain.chosen)
    np.testing.assert_array_equal(recording.suggested, plain.suggested)


GOOD = lines(*PLAN, person="bob")
LEFT_OUT = "person 'ann', episode '1', which is left out: "


def of_ann(**changed: object) -> list[dict]:
    return [{"person": "ann", "episode": "1", "step": 0, "action": FETCH} | changed]


def later(step: int) -> list[dict]:
    return [*lines(FETCH, WRONG), *(row | {"step": step} for row in lines(FETCH))]


MALFORMED: list[tuple[list[dict], int, str]] = [
    (lines(FETCH, "(plce hammer slot-1 box-a)"), 8, LEFT_OUT + "step 1: (plce hammer slot-1 box-a): no action of the "
     f"task is called 'plce'; nearest in spelling of the 3 applicable: {RIGHT}, {WRONG}, {BACK}"),
    (lines(FETCH, "(fetch box-b)"), 8, LEFT_OUT + "step 1: (fetch box-b) is not applicable here; nearest in spelling "
     f"of the 3 applicable: {BACK}"),
    (lines(FETCH, "(place hamer slot-1 box-a)"), 8, LEFT_OUT + "step 1: (place hamer slot-1 box-a) is no action of "
     f"the task; nearest in spelling of the 3 applicable: {RIGHT}, {WRONG}, {BACK}"),
    (lines(FETCH, "(place hammer)"), 8, LEFT_OUT + f"step 1: (place hammer) may be any of {RIGHT}, {WRONG}"),
    ([*lines(FETCH), *lines(FETCH)], 8, LEFT_OUT + "its step, or time, is on line 7 already; are these two episodes, "
     "or two people?"),
    (later(10), 9, LEFT_OUT + "step 10 comes after step 1, as if a line were missing; --set gaps=true (in Python "
     "gaps=True) if the log counts otherwise"),
    (later(2), 9, LEFT_OUT + "step 2: (fetch box-a) is not applicable here; nearest in spelling of the 2 applicable: "
     "(return box-a)"),  # two people with one name
    (of_ann(step=2**63), 7, LEFT_OUT + "'step' is too large; expected a whole number of at most 64 bits"),
    (of_ann(action="(fetch box-a"), 7, LEFT_OUT + "'action' opens 1 and closes 0 brackets; expected (name argument "
     "...) or name(argument, ...)"),
    (of_ann(person="\ud800"), 7, "episode '1', which is left out: 'person' is \"\\ud800\", which cannot be shown; "
     "expected a name"),
    (of_ann(step="one"), 7, LEFT_OUT + "'step' is \"one\"; expected a whole number"),
    (of_ann(action=3), 7, LEFT_OUT + "'action' is 3; expected an action as text, \"(name argument ...)\", or null"),
]  # fmt: skip


@pytest.mark.parametrize(("bad", "line", "message"), MALFORMED, ids=[str(n) for n in range(len(MALFORMED))])
def test_faults_are_named_and_good_episodes_used(
    tmp_path: Path, tiny: Table, bad: list[dict], line: int, message: str
) -> None:
    read = read_log(write_log(tmp_path / "log.jsonl", [*GOOD, *bad]))
    recording, more = replay(read, tiny)
    (fault,) = [*read.faults, *more]
    assert (fault.line, str(fault)) == (line, message)
    assert (recording.people, len(recording)) == (("bob",), 6)


def test_what_comes_after_the_goal_is_left_out(tiny: Table) -> None:
    recording, (fault,) = replay(log_of(lines(*PLAN, FETCH, WRONG)), tiny)
    assert (len(recording), fault.line, fault.spoils) == (len(PLAN), len(PLAN) + 1, False)
    assert str(fault).endswith("episode '1': the goal was reached before this step; the actions up to it are used")


BOTH = {"ann": len(PLAN), "bob": len(PLAN)}


def both(begin: int = 0, every: int = 1) -> list[dict]:
    """Return two episodes whose steps count from a number, by a number."""
    return [row | {"step": begin + every * row["step"]} for row in [*lines(*PLAN), *lines(*PLAN, person="bob")]]


def test_steps_that_count_otherwise(tmp_path: Path, tiny: Table) -> None:
    """If step numbers are unclear, a broken line may belong to every episode that continues after it."""
    rows = both(every=3)
    file = write_log(tmp_path / "log.jsonl", rows)
    assert (used(file, tiny), used(file, tiny, gaps=True)) == ({}, BOTH)
    file.write_text("\n".join([*text_of(rows[:8]), "#", *text_of(rows[8:])]) + "\n")
    assert used(file, tiny, gaps=True) == {"ann": len(PLAN)}


@pytest.mark.parametrize("begin", [0, 1, 2, 5])
def test_a_first_line_may_be_missing(tmp_path: Path, tiny: Table, begin: int) -> None:
    """Actions after a wrong start would often be applicable, and a person would seem to err who did not."""
    rows = both(begin)
    file = write_log(tmp_path / "log.jsonl", rows)
    # Every episode may have lost its first line. Nothing else in the log can tell.
    said = f"read steps that count from {begin}: a first line that is missing in every episode is not noticed"
    assert read_log(file).note == (said if begin else "")
    assert read_log(file, gaps=True).note == ""
    assert used(file, tiny) == BOTH
    # An unreadable line begins no episode if all episodes begin with the first step number of this log.
    file.write_text("\n".join(["#", *text_of(rows)]) + "\n")
    assert used(file, tiny) == (BOTH if begin < 2 else {})
    for missing in (1, 2):
        write_log(file, [*rows[: len(PLAN)], *rows[len(PLAN) + missing :]])
        assert used(file, tiny) == {"ann": len(PLAN)}
        (fault,) = read_log(file).faults
        assert (fault.line, str(fault)) == (
            len(PLAN) + 1, f"person 'bob', episode '1', which is left out: step {begin + missing} is its first and "
            f"{begin} that of others, as if a line were missing; --set gaps=true (in Python gaps=True) if the log "
            "counts otherwise",
        )  # fmt: skip
        assert read_log(file, gaps=True).faults == ()


@pytest.mark.parametrize("text", [None, "", "-", "NA"])
def test_a_step_at_which_nothing_was_done(tmp_path: Path, tiny: Table, text: str | None) -> None:
    """It is no choice, and no missing line."""
    rows = both(every=2)
    pauses = [dict(row, step=row["step"] + 1, action=text, suggestion=text or None) for row in rows]
    file = write_log(tmp_path / "log.jsonl", [*rows, *pauses])
    assert used(file, tiny) == BOTH
    log = read_log(file)
    assert (log.faults, replay(log, tiny)[1]) == ((), [])
    assert "line 13 and 11 more, without an action, as nothing done" in log.note


def test_lines_that_count_for_nothing_may_have_the_step_of_an_action(tiny: Table) -> None:
    """What is dropped, and in a live log a missed action, which has the step of the next one that was seen."""
    rows = lines(*PLAN)
    seen = replayed(tiny, [*rows, rows[-1] | {"action": "(pause)"}], drop=["pause"])
    assert (seen.faults, len(seen.recording)) == ((), len(PLAN))
    missed = [dict(row, step=k) for k in range(len(PLAN)) for row in lines(None, PLAN[k])]  # type: ignore[arg-type]
    recording, faults = replay(Log.of(missed), tiny)
    assert (len(recording), faults) == (len(PLAN), [])


def test_a_line_that_lost_its_action_is_not_read_as_nothing_done(tmp_path: Path, tiny: Table) -> None:
    rows = [*lines(*PLAN), *lines(*PLAN, person="bob")]
    del rows[-1]["action"]
    file = write_log(tmp_path / "log.jsonl", rows)
    assert used(file, tiny) == {"ann": len(PLAN)}
    (fault,) = read_log(file).faults
    assert (fault.line, fault.message) == (len(rows), "no action; expected null if nothing was done")


def test_what_is_dropped_is_dropped_as_a_suggestion_too(tiny: Table) -> None:
    rows = lines(FETCH, "wait", RIGHT, BACK, told={0: "(wait)", 1: RIGHT, 2: WRONG, 3: "wait"})
    recording, faults = replay(Log.of(rows), tiny, drop=["wait"])
    assert faults == []
    assert [int(n) for n in recording.suggested >= 0] == [0, 1, 0]
    none = lines(FETCH, RIGHT, BACK, told={0: "none", 2: "none"})
    assert len(replay(Log.of(none), tiny)[0]) == 0
    recording, faults = replay(Log.of(none), tiny, drop=["none"])
    assert (len(recording), faults) == (3, [])
    robot = [{**row, "executed": "(wait)"} for row in lines(FETCH, RIGHT)]
    assert len(replay(Log.of(robot), tiny, drop=["wait"])[0]) == 2


CSV = "person,episode,step,action\nann,1,0,(fetch box-a)\nann,1,1,(place hammer slot-1 box-a)\nbob,2,0,(fetch box-b)\n"


@pytest.mark.parametrize(
    ("text", "message", "people"),
    [
        (CSV.replace("episode", "trial"), "log.csv:1: no column is called episode; expected person, episode, step", []),
        ("a,b\n1,2\n", "log.csv:1: no column is called person or episode or step or action; expected", []),
        (CSV.replace("ann,1,1,(place", "ann,1,(place"), "log.csv:3: person 'ann', episode '1', which is left out: 3 "
         "cells; expected 4, as in the first line", ["bob"]),
        (CSV.replace("ann,1,0,(fetch box-a)", "a"), "log.csv:2: 1 cells; expected 4, as in the first line", ["bob"]),
        (CSV.replace("bob,2,0", "bob,2,first"), "log.csv:4: person 'bob', episode '2', which is left out: 'step' is "
         '"first"', ["ann"]),
        (CSV.replace("ann,1,0", ",1,0"), "log.csv:2: episode '1', which is left out: 'person' is null; expected a name",
         ["bob"]),
        (CSV[:-16], "log.csv:4: person 'bob', episode '2': the last line is cut off; the lines before it are used",
         ["ann"]),
        (CSV[:-3], "log.csv:4: person 'bob', episode '2', which is left out: 'action' opens 1 and closes 0",
         ["ann"]),
        (CSV.replace("bob", '"bob'), "log.csv:4: not CSV (unexpected end of data); what comes after it is not read",
         ["ann"]),
    ],
    ids=[str(n) for n in range(9)],
)  # fmt: skip
def test_broken_csv(tmp_path: Path, tiny: Table, text: str, message: str, people: list[str]) -> None:
    file = tmp_path / "log.csv"
    file.write_text(text)
    assert message in told(read_log(file).faults, file.name)[0]
    assert list(used(file, tiny)) == people


WHOLE = "".join(f"{line}\n" for line in text_of([*lines(FETCH, RIGHT, told={1: WRONG}), *lines(*PLAN, episode="2")]))


@given(st.sampled_from([WHOLE, CSV]), st.data())
def test_whatever_a_file_has_is_read_or_a_fault(
    tmp_path_factory: pytest.TempPathFactory, tiny: Table, text: str, data: st.DataObject
) -> None:
    """No error is raised. Each readable line can be replayed, or is reported with its number."""
    raw = bytearray(text.encode())
    for _ in range(data.draw(st.integers(1, 6))):
        begin, end = sorted(data.draw(st.tuples(*[st.integers(0, len(raw))] * 2)))
        raw[begin : min(end, begin + 20)] = data.draw(
            st.one_of(
                st.binary(max_size=6),
                st.sampled_from([b"\n", b'"', b"{", b"}", b"null", b"1e999", b"-1", b"NaN", b"\xef\xbb\xbf", b"\0"]),
            )
        )
    file = tmp_path_factory.mktemp("log") / "log"
    file.write_bytes(raw)
    for gaps in (False, True):
        log = read_log(file, gaps=gaps)
        recording, faults = replay(log, tiny)
        assert set(recording.people) <= log.people
        assert all(1 <= fault.line <= len(re.split(rb"\r\n|\r|\n", raw)) for fault in [*log.faults, *faults])
        assert len(told(log.faults, "log")) <= len(log.faults)


def test_bytes_that_are_not_utf8_make_no_new_person(tmp_path: Path, tiny: Table) -> None:
    raw = "\n".join(json.dumps(row, ensure_ascii=False) for row in lines(*PLAN, person="Zoë")) + "\n"
    file = tmp_path / "log.jsonl"
    file.write_bytes(raw.encode("latin-1") + "\n".join(text_of(lines(*PLAN))).encode() + b"\n")
    log = read_log(file)
    assert log.people == {"ann"}
    assert told(log.faults, "log") == [
        "log:1: its bytes are not UTF-8; expected a file in that encoding (and so 5 more, to line 6)"
    ]
    assert used(file, tiny) == {"ann": len(PLAN)}


def test_what_the_robot_does_itself_is_no_choice(tiny: Table) -> None:
    """The robot's action comes before the person's choice; if it reaches the goal there is no choice."""
    rows = [{**line, "executed": PLAN[2 * k]} for k, line in enumerate(lines(*PLAN[1::2]))]
    recording, faults = replay(log_of(rows), tiny)
    assert faults == []
    plain, _ = replay(log_of(lines(*PLAN)), tiny)
    np.testing.assert_array_equal(recording.state, plain.state[1::2])
    np.testing.assert_array_equal(recording.chosen, plain.chosen[1::2])
    last = {**lines(*PLAN)[-1], "action": None, "executed": PLAN[-1]}
    recording, faults = replay(log_of([*lines(*PLAN)[:-1], last]), tiny)
    assert (len(recording), faults) == (len(PLAN) - 1, [])
    _, (fault,) = replay(log_of([*lines(*PLAN)[:-1], {**last, "action": FETCH}]), tiny)
    assert fault.message.startswith("the goal was reached before this step")
    alone = [{**line, "action": None, "executed": line["action"]} for line in lines(*PLAN)]
    recording, faults = replay(log_of(alone), tiny)
    assert (len(recording), recording.people, faults) == (0, (), [])
    _, (fault,) = replay(log_of([{**line, "executed": RIGHT} for line in lines(FETCH)]), tiny)
    assert fault.message.startswith(f"step 0: {RIGHT} is not applicable here")


class Busy:
    """A robot that does anything it can do, to anybody."""

    uses_belief = False

    def __init__(self) -> None:
        self.rng = np.random.default_rng(8)

    def __call__(self, team: TeamState) -> TeamAction:
        person = (self.rng.random(team.active.shape) * team.active).argmax(axis=1)
        x = team.x[np.arange(len(person)), person]
        count = team.policies[0].pomdp.robot_actions[x]
        return TeamAction(person[:, None], (self.rng.random(len(x)) * count).astype(int)[:, None])


def test_episodes_in_which_the_robot_works_as_well_are_replayed() -> None:
    """All episodes are replayed, and their estimates agree with those of episodes without executions."""
    for execute in (False, True):
        setting = Setting(execute=execute, knowledge="exact")
        pool = Pool.sample(Choices.of(PAPER), 6, seed=5, setting=setting, population=Population(sigma=(0, 0)))
        trace: Trace = []
        simulate(pool, Busy(), humans=2, episodes=20, seed=3, trace=trace)
        recording, faults = replay(Log.of(trace), PAPER)
        assert (list(Log.of(trace).faults), faults) == ([], [])
        assert len(recording) == sum(row["action"] is not None for row in trace)
        assert len(recording.episodes) == 2 * 20
        assert any(row.get("executed") for row in trace) == execute
        assert any(row["action"] is None for row in trace) == execute
        covered = []
        for found in maximum_likelihood(
            observe(recording, EvaluatedStates(PAPER.h, None), PAPER.is_goal(np.arange(len(PAPER)))), Method(eta=0.2)
        ):
            human = pool.people[int(found.observations.person.removeprefix("human-")) - 1]
            assert found.theta is not None
            covered.append(found.beta_interval[0] <= human.beta <= found.beta_interval[1])
            covered.append(found.estimates["theta"].interval[0] <= human.theta <= found.estimates["theta"].interval[1])
        assert (len(covered), covered.count(False) <= 1) == (12, True)  # of 95 % intervals


def test_every_line_that_fits_no_action_is_reported(tiny: Table) -> None:
    rows = lines(FETCH, "(fetch box-b)", "(hammer)", WRONG, "(place hammer box-a)", told={1: BACK})
    _, faults = replay(log_of(rows), tiny)
    assert [(f.line, f.message.partition(";")[0]) for f in faults] == [
        (2, "step 1: (fetch box-b) is not applicable here"),
        (3, "step 2: (hammer): no action of the task is called 'hammer'"),
        (5, "step 4: (place hammer box-a) is no action of the task"),
    ]


def test_the_log_of_another_task_is_told_in_a_few_lines(tiny: Table) -> None:
    rows = [
        row for n in range(30) for row in lines(f"(drive van-{n})", "(drive van)", f"(fetch box-{n})", episode=f"{n}")
    ]
    _, faults = replay(log_of(rows), tiny)
    assert len(faults) == len(rows)
    found = told(faults, "log")
    assert [line.partition("; actions that can never")[0].partition("out: ")[2] for line in found[:3]] == [
        "step 0: (drive van-0): no action of the task is called 'drive'",
        "step 1: (drive van): no action of the task is called 'drive'",
        "step 0: (drive van-1): no action of the task is called 'drive'",
    ]
    assert [line.endswith("(and so 29 more, to line 89)") for line in found[:3]] == [False, True, False]
    assert found[3] == "log:7: 28 more of this kind, to line 88"
    assert (len(found), found[7]) == (8, "log:12: 27 more of this kind, to line 90")


def test_malformed_logs_through_the_command(tmp_path: Path) -> None:
    bad, line, message = MALFORMED[0]
    file = write_log(tmp_path / "log.jsonl", [*GOOD, *bad], tail='{"person": "bob", "epi')
    command = ("fit", "kitting/tiny", file, "--json")
    result = invoke(*command)
    assert result.exit_code == 1
    cut = f"{file}:9: the last line is cut off; the lines before it are used"
    lost = f"{file}: 1 of 2 episodes are used; left out are ann 1 of 1, which are no random choice, so that "
    assert result.stderr.splitlines() == [f"{file}:{line}: {message}", cut, f"{lost}estimates may be biased"]
    ann, bob = json.loads(result.stdout)
    assert (ann["person"], ann["beta"], ann["error"]) == ("ann", None, "no episode can be used")
    assert list(ann)[:5] == ["person", "beta", "beta_interval", "beta_open", "theta"]
    assert (bob["person"], bob["actions"], bob["suboptimal_actions"], bob["error"]) == ("bob", 6, 0, None)
    assert bob["beta_open"] == ["above"]
    assert "made no mistake: beta is at least" in bob["notes"][0]
    strict = invoke(*command, "--strict")
    assert (strict.exit_code, strict.stdout) == (1, "")
    assert strict.stderr.splitlines()[-1] == f"{file}: nothing is estimated, because of --strict"


@pytest.mark.cases
def test_episodes_that_a_suggestion_costs_are_counted(tmp_path: Path) -> None:
    """They are those with mistakes; without the column of suggestions, they can be used."""
    wrong = [row | {"person": "ann", "suggestion": "(fetch box-c)"} for row in GOOD]
    file = write_log(tmp_path / "log.jsonl", [*GOOD, *wrong])
    result = invoke("fit", "kitting/tiny", file)
    assert "step 0: suggestion (fetch box-c) is no action of the task" in result.stderr
    said = result.stderr.splitlines()[-1]
    assert "1 of 2 episodes are used; left out are ann 1 of 1, which are no random choice" in said
    assert said.endswith("; 1 by the column suggestion: without it, all of these give expertise (beta) alone")


def test_what_depends_on_an_unknown_cost_is_left_out(tiny: Table) -> None:
    """Excluded are ann's step with a suggestion and her later steps of that episode, and bob's step alone."""
    rows = [*lines(FETCH, RIGHT, BACK, told={1: WRONG}), *lines(FETCH, episode="2"), *lines(*PLAN, person="bob")]
    recording, _ = replay(log_of(rows), tiny)
    h = tiny.h.copy()
    h[recording.targets[1, 1]] = np.nan
    left, counts = recording.evaluated(h)
    assert counts == {"ann": 2, "bob": 1}
    assert left.people == ("ann", "bob")
    assert (left.person == 0).sum() == 2
    assert not np.isnan(h[left.wanted()]).any()
    whole, none = recording.evaluated(tiny.h)
    assert none == {}
    np.testing.assert_array_equal(whole.targets, recording.targets)
    left, counts = recording.evaluated(np.full(len(tiny), np.nan))
    assert (len(left), left.people, counts) == (0, (), {"ann": 4, "bob": 6})


def test_what_is_left_where_costs_are_unknown_is_numbered_anew(tiny: Table) -> None:
    """A suggestion at an episode's first step excludes all of it; whether a cost is known counts for choices only."""
    rows = [*lines(FETCH, RIGHT, BACK, told={0: FETCH}), *lines(*PLAN, person="bob"), *lines(FETCH, RIGHT, person="cy")]
    recording, _ = replay(log_of(rows), tiny)
    h = tiny.h.copy()
    h[recording.targets[0, recording.applicable[0]]] = np.nan
    left, counts = recording.evaluated(h)
    assert (left.people, counts["ann"]) == (("bob", "cy"), 3)
    assert [left.people[k] for k in left.person] == ["bob"] * (len(PLAN) - counts["bob"]) + ["cy"] * (2 - counts["cy"])
    h = tiny.h.copy()
    h[tiny.initial] = np.nan  # a state in which people choose, and to which the way back leads
    left, _ = recording.evaluated(h)
    assert left.step[left.person == left.people.index("cy")].tolist() == [0]


@pytest.mark.cases
def test_theta_begins_anew_in_each_episode_of_a_simulations_log_unless_asked(tmp_path: Path) -> None:
    file, plain = tmp_path / "log.jsonl", tmp_path / "plain.jsonl"
    given = ("--humans", 2, "--pool", 2, "--policy", "reactive", "--episodes", 10, "--seed", 4)
    assert invoke("simulate", "kitting/tiny", *given, "--trace", file).exit_code == 0
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    plain.write_text("".join(json.dumps({n: v for n, v in row.items() if n != "theta"}) + "\n" for row in rows))
    found = {}
    for log, more in ((file, ()), (file, ("true",)), (file, ("false",)), (plain, ())):
        asked = [word for value in more for word in ("--set", f"theta_per_episode={value}")]
        result = invoke("fit", "kitting/tiny", log, "--influence", "constant", "--json", *asked)
        document = json.loads(result.stdout)
        found[log, more] = document["carried"], document["log_likelihood"]
        assert (document["log_likelihood_anew"] is None) != document["carried"]
        told = "theta begins anew in each episode; --set theta_per_episode=false carries it over" in result.stderr
        assert told == ((log, more) == (file, ()))
    assert found[file, ()] == found[file, ("true",)]
    assert found[plain, ()] == found[file, ("false",)]
    assert (found[file, ()][0], found[plain, ()][0]) == (False, True)
    log = replayed(kit("tiny"), file)
    assert (fit_influence(log, "constant").carried, fit_influence(log, "constant", carry=True).carried) == (False, True)
