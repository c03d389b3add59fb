"""What a newcomer passes to the main functions is taken, or one sentence says what to pass; results are kept."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING
from matplotlib.text import Text
from recorded import lines

from assist import Assistant, Pool, fit, simulate
from assist.certify import certify, upper_bound
from assist.drawing import draw
from assist.drawing.plots import errors_figure, expertise_figure
from assist.learning import (
    Log,
    calibrate,
    compare_models,
    fit_population,
    infer_goals,
    maximum_likelihood,
    observed,
    read_log,
    replayed,
)
from assist.people import TERMS, Choices
from assist.person.person_problem import PersonProblem
from planner import InputFileError, OnDemand, astar, cost_to_go, load, sweep, sweep_goals

pytestmark = pytest.mark.cases

ACTIONS = ["(fetch box-a)", "(place hammer slot-2)", "(remove hammer slot-2)", "(place hammer slot-1)"]
ROWS = [row for person in ("ann", "bob") for row in lines(*ACTIONS, person=person, told={1: "(place hammer slot-1)"})]
LOG = Log.of(ROWS)

TASKS: dict[str, Callable[[], Any]] = {
    "name": lambda: "kitting/tiny",
    "file": lambda: str(KITTING / "tiny.pddl"),
    "path": lambda: KITTING / "tiny.pddl",
    "task": lambda: load("kitting/tiny"),
    "table": lambda: cost_to_go(load("kitting/tiny")),
    "on demand": lambda: OnDemand(load("kitting/tiny")),
}
OF_A_TASK: dict[str, Callable[[Any], Any]] = {
    "cost_to_go": lambda task: cost_to_go(task)[0],  # type: ignore[index]
    "sweep": lambda task: len(sweep(task)),
    "astar": lambda task: astar(task)[0],
    "sweep_goals": lambda task: len(sweep_goals([task])[0]),
    "Pool.sample": lambda task: [human.beta for human in Pool.sample(task, 2, seed=1).people],
    "Assistant": lambda task: Assistant(task, ["ann"]).recommend(),
    "Assistant by name": lambda task: Assistant(people={"ann": task}).recommend(),
    "fit": lambda task: round(fit(task, LOG)["ann"].beta or 0.0, 9),
    "compare_models": lambda task: compare_models(observed(task, LOG)).scores[0].nats_per_choice,
    "infer_goals": lambda task: len(infer_goals({"kit": task}, LOG).episodes),
    "fit with goals": lambda task: round(fit({"kit": task}, LOG)["ann"].beta or 0.0, 9),
    "PersonProblem.of": lambda task: len(PersonProblem.of(task).states),
    "draw": lambda task: draw(task).svg,
    "Choices.of": lambda task: len(Choices.of(task)),
    "OnDemand": lambda task: OnDemand(task).lookup([0]).tolist(),
}
GOALS = ("fit", "compare_models")  # which take a task for each goal's name, too
SEARCHED = (
    "Assistant",
    "Assistant by name",
    "Pool.sample",
    "PersonProblem.of",
    "Choices.of",
)  # a truncated task is another problem


@pytest.mark.filterwarnings("ignore:suggestions are ignored")
@pytest.mark.parametrize("function", OF_A_TASK)
def test_a_task_may_be_given_in_any_form(function: str) -> None:
    call = OF_A_TASK[function]
    found = {name: call(make()) for name, make in TASKS.items() if name != "on demand" or function not in SEARCHED}
    assert {name: value == found["table"] for name, value in found.items()} == dict.fromkeys(found, True)
    for wrong in (5, {"kitting": 1}, ["kitting/tiny"], load):
        kind = "int" if function in GOALS and isinstance(wrong, dict) else type(wrong).__name__
        with pytest.raises(TypeError, match=rf"^a {kind} where a task was expected: its name, ") as error:
            call(wrong)
        assert "\n" not in str(error.value)


LOGS: dict[str, Callable[[Path], Any]] = {
    "log": lambda _: LOG,
    "file": str,
    "path": lambda file: file,
    "read": read_log,
    "records": lambda _: ROWS,
    "an iterator": lambda _: iter(ROWS),
    "data frame": lambda _: pytest.importorskip("pandas").DataFrame(ROWS),
}


@pytest.mark.parametrize("form", LOGS)
def test_a_log_may_be_given_in_any_form(tmp_path: Path, form: str) -> None:
    file = tmp_path / "log.jsonl"
    file.write_text("".join(json.dumps(row) + "\n" for row in ROWS))
    assert fit("kitting/tiny", LOGS[form](file))["bob"].actions == len(ACTIONS)


def test_a_log_with_other_columns_is_read_by_fit(tmp_path: Path) -> None:
    renamed = [{("worker" if name == "person" else name): value for name, value in row.items()} for row in ROWS]
    pandas = pytest.importorskip("pandas")
    pandas.DataFrame(renamed).to_csv(tmp_path / "log.csv", index=False)
    for log in (tmp_path / "log.csv", renamed, pandas.DataFrame(renamed)):
        assert fit("kitting/tiny", log, columns={"person": "worker"})["bob"].actions == len(ACTIONS)
    with pytest.raises(InputFileError, match=r"log.csv:1: no column is called person; .*columns=\{'person': NAME\}"):
        fit("kitting/tiny", tmp_path / "log.csv")
    with pytest.raises(TypeError, match="columns: expected a file"):
        fit("kitting/tiny", LOG, columns={"person": "worker"})


@pytest.mark.parametrize("function", [fit, observed, lambda task, log: infer_goals({"kit": task}, log)])
def test_what_is_no_log_gets_one_sentence(function: Callable[..., Any]) -> None:
    for wrong in (5, None, {"person": ["ann"]}, b"log.csv"):
        with pytest.raises(
            TypeError, match=rf"^a {type(wrong).__name__} where a log was expected: a Log, the name of "
        ):
            function("kitting/tiny", wrong)
    with pytest.raises(TypeError, match=r"^a str where goals were expected"):
        infer_goals("kitting/tiny", LOG)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"expected a list of tasks"):
        sweep_goals("kitting/tiny")  # type: ignore[arg-type]


def test_a_task_where_a_pool_was_expected() -> None:
    said = r"^pool: expected people at a task, a Pool, not what is a str; Pool.sample\(task, 12, seed=1\) is one$"
    for call in (simulate, certify):
        with pytest.raises(TypeError, match=said):
            call("kitting/tiny", "reactive", humans=2, episodes=2, seed=0)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=said):
        upper_bound("kitting/tiny")  # type: ignore[arg-type]


def test_results_of_fit_are_what_figures_and_comparisons_take() -> None:
    people, seen = fit("kitting/tiny", LOG), replayed("kitting/tiny", LOG)
    for given in (people, list(people.values())):
        assert calibrate(given) == calibrate(people)
        for figure in (expertise_figure(given), errors_figure(given)):
            figure.draw_without_rendering()
            words = [text.get_text() for text in figure.findobj(Text)]
            assert {"0", "1"} <= set(words)  # marks of an axis that is logarithmic above a tenth
            assert not [one for one in words if "$" in one]
    for estimate in (compare_models, fit_population, maximum_likelihood):
        assert estimate(seen) == estimate(seen.observations(TERMS if estimate is compare_models else None))
        with pytest.raises(TypeError, match="a str where observations were expected; `replayed"):
            estimate("log.csv")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="a str where a person's estimates were expected"):
        calibrate(["ann"])


def test_a_state_is_drawn_as_it_is() -> None:
    table = cost_to_go("kitting/tiny")
    state = table.state(3)
    assert draw(state).svg == draw(table, state.values).svg != draw(table).svg


def test_policies_need_no_names() -> None:
    pool = Pool.sample("kitting/tiny", 1, seed=1)
    options: dict[str, Any] = {"episodes": 2, "window": 0, "gap": 0.5}
    for given in ("none", ["none"], {"none": "none"}):
        assert [one.policy for one in certify(pool, given, **options)[1]] == ["none"]


def test_one_action_to_drop_needs_no_list() -> None:
    assert fit("kitting/tiny", lines("wait", *ACTIONS), drop="wait")["ann"].actions == len(ACTIONS)


@pytest.mark.parametrize("options", [{}, {"model": "misconceptions"}, {"model": "terms"}])
def test_results_of_fit_are_kept_and_say_what_they_are(options: dict[str, Any]) -> None:
    with pytest.warns(UserWarning, match="is not applicable here"):
        people = fit("kitting/tiny", [*ROWS, *lines("(fetch box-b)", "(fetch box-b)", person="cy")], **options)
    again = pickle.loads(pickle.dumps(people))
    assert again.as_dicts() == people.as_dicts()
    assert repr(again["ann"]) == repr(people["ann"]) != repr(people["bob"])
    assert repr(people).startswith("<2 fitted people: ann (")
    assert repr(people).endswith("4 actions); 1 without an estimate; 1 faults of the log>")
    assert repr(people["ann"]).startswith("<estimates of ann (")


def test_an_assistant_is_a_line() -> None:
    assert repr(Assistant("kitting/tiny", ["ann"])) == "<Assistant of ann, policy 'attention', step 0>"
