"""`simulate` and `bound` on the command line: user policies, populations, limits, and error messages."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from conftest import KITTING, invoke, kit

from assist.learning.distribution import mixture
from assist.person.settings import Setting
from assist.team.pool import Pool
from assist.team.simulate import simulate
from planner import CostToGo, OnDemand

TINY = KITTING / "tiny.pddl"

OWN = """\
import numpy as np
from dataclasses import dataclass
from assist.team.state import NOBODY, TeamAction


@dataclass
class Note:  # finds its module
    text: "str"


def in_turn(team):
    return team.act(team.active.argmax(axis=1), team.first_optimal())


def oops(team):
    return {}["oops"]


def elsewhere(team):
    return TeamAction(np.full(team.location.shape, 7), np.zeros(team.location.shape, dtype=int))


def none(team):
    return None


def silent(team):
    assert team.belief is None
    return TeamAction(np.full(team.location.shape, NOBODY), np.zeros(team.location.shape, dtype=int))


silent.uses_belief = False


def leaves(team):
    raise SystemExit(0)

"""


def test_the_region_is_of_so_many_states_however_the_cost_to_go_is_found() -> None:
    def printed(known: CostToGo, *options: object) -> tuple[float, float]:
        """Return the printed return on a task with this cost-to-go, and that of Python with so small a region."""
        pool = Pool.sample(known, 2, seed=0, setting=Setting(c_suggest=0.2), states=1, region=5)
        expected = simulate(pool, "attention", humans=2, episodes=10, seed=0).discounted_return.mean()
        command = ["simulate", TINY, "--humans", 2, "--pool", 2, "--policy", "attention", "--episodes", 10]
        done = invoke(*command, "--c-suggest", 0.2, "--json", *options)
        (found,) = json.loads(done.stdout)["policies"]
        return found["return"]["mean"], float(expected)

    table = kit("tiny")
    swept, expected = printed(table, "--set", "region_states=5")
    assert swept == pytest.approx(expected)
    asked, expected = printed(OnDemand(table.task), "--set", "region_states=5", "--set", "max_states=5")
    assert asked == pytest.approx(expected)
    unasked, _ = printed(OnDemand(table.task), "--set", "max_states=5")
    assert abs(unasked - asked) > 0.01  # the region is larger then


@pytest.fixture
def own(tmp_path: Path) -> Path:
    file = tmp_path / "own.py"
    file.write_text(OWN)
    return file


def test_a_policy_of_ones_own_is_simulated_and_bounded_beside_others(own: Path, tmp_path: Path) -> None:
    options = (TINY, "--humans", 2, "--json", "--policy", f"{own}:in_turn", "--policy", f"{own}:silent")
    result = invoke(
        "simulate", *options, "--policy", "none", "--pool", 2, "--episodes", 40, "--out", tmp_path / "out.jsonl"
    )
    assert result.exit_code == 0, result.output
    first, silent, none = json.loads(result.stdout)["policies"]
    assert (first["policy"], silent["policy"]) == ("in_turn", "silent")
    assert first["interventions"]["mean"] > 2
    assert set(silent.pop("differences")) == {"human_actions_per_person", "interventions", "return"}
    assert {**silent, "policy": "none", "differences": None} == none
    assert len((tmp_path / "out.jsonl").read_text().splitlines()) == 120
    result = invoke("bound", *options, "--value-episodes", 50, "--gap", 0.5, "--set", "gamma=0.6")
    assert result.exit_code == 0, result.output
    assert [c["policy"] for c in json.loads(result.stdout)["policies"]] == ["in_turn", "silent"]


def test_differences_refer_to_any_of_the_policies(own: Path) -> None:
    policies = ("--policy", "none", "--policy", "attention", "--policy", f"{own}:in_turn")
    options = ("simulate", TINY, "--humans", 2, "--pool", 2, "--episodes", 8, "--set", "max_steps=60", *policies)
    usual, other = (
        json.loads(invoke(*options, *more, "--json").stdout) for more in ((), ("--baseline", f"{own}:in_turn"))
    )
    assert (usual["baseline"], other["baseline"]) == ("none", "in_turn")
    none, attention, in_turn = other["policies"]
    assert in_turn["differences"] is usual["policies"][0]["differences"] is None
    for measure in ("human_actions_per_person", "interventions", "return"):
        difference = none["differences"][measure]
        assert difference["mean"] == pytest.approx(-usual["policies"][2]["differences"][measure]["mean"])
        assert difference["low"] == pytest.approx(-usual["policies"][2]["differences"][measure]["high"])
        means = attention[measure]["mean"] - in_turn[measure]["mean"]
        assert attention["differences"][measure]["mean"] == pytest.approx(means)
    assert "difference to attention" in invoke(*options, "--baseline", "attention").stdout
    refused = invoke(*options, "--baseline", "attenton")
    assert (refused.exit_code, "--baseline 'attenton'; did you mean 'attention'?" in refused.stderr) == (2, True)


@pytest.mark.parametrize("command", ["simulate", "bound"])
@pytest.mark.parametrize(
    ("function", "code", "words"),
    [
        ("oops", 1, "own.py:16: KeyError: 'oops'"),
        ("leaves", 1, "SystemExit: 0"),  # which must not end the command as if all were well
        ("elsewhere", 1, "own.py:19: step 0: the policy goes to person 7 in a team of 2"),
        ("none", 2, "--policy"),  # a name of the package's
    ],
)
def test_faults_of_own_policies_are_said_in_one_line(
    own: Path, command: str, function: str, code: int, words: str
) -> None:
    result = invoke(command, TINY, "--humans", 2, "--policy", f"{own}:{function}",
                 *(("--time-limit", 0.05) if command == "bound" else ()))  # fmt: skip
    assert (result.exit_code, result.stdout) == (code, "")
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    if code == 1:
        assert result.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def f(:\n", "broken.py:1: SyntaxError: "),
        ("raise SystemExit(0)\n", "broken.py:1: SystemExit: 0"),
        ("import os\n1 / 0\n", "broken.py:2: ZeroDivisionError: division"),
    ],
)
def test_a_file_that_cannot_be_run_is_named_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "broken.py").write_text(text)
    result = invoke("simulate", TINY, "--humans", 1, "--policy", f"{tmp_path / 'broken.py'}:f")
    assert result.exit_code == 1
    assert words in result.stderr


@pytest.mark.slow
def test_a_population_is_taken_by_every_command_and_not_beside_ranges(tmp_path: Path) -> None:
    record = {"parts": [{"share": 1.0, "beta": [2.0, 2.5], "theta": [0.8, 0.9], "sigma": [0.0, 0.0]}]}
    file = tmp_path / "people.json"
    file.write_text(json.dumps(record))
    mixture(record)  # as `fit` writes it
    out = invoke("simulate", TINY, "--humans", 2, "--population", file, "--episodes", 5, "--json")
    assert out.exit_code == 0, out.output
    assert json.loads(out.stdout)["population"]["parts"][0]["beta"] == [2.0, 2.5]
    experts = invoke("policy", TINY, "--population", file, "--gap", 0.01, "--json")
    words = "--set population.beta=[2.0,2.5] --set population.theta=[0.8,0.9] --gap 0.01 --json"
    ranges = invoke("policy", TINY, *words.split())
    assert experts.exit_code == 0, experts.output
    assert json.loads(experts.stdout)["value_never"] == json.loads(ranges.stdout)["value_never"]
    for command in ("simulate", "bound", "policy"):
        team = () if command == "policy" else ("--humans", 2)
        for part in ("beta=[1, 2]", "theta=[0.5, 0.6]"):
            both = invoke(command, TINY, *team, "--population", file, "--set", f"population.{part}")
            assert (both.exit_code, both.stdout) == (2, "")
            assert f"--set population.{part.partition('=')[0]}: it is set twice; expected one value" in both.stderr
    file.write_text('["no population"]')
    assert invoke("bound", TINY, "--humans", 2, "--population", file).exit_code == 2


@pytest.mark.parametrize(
    ("command", "options", "words"),
    [
        ("simulate", ("--set", "goal_knowledge=known"), "--set goal_knowledge has no effect without --goals"),
        ("simulate", ("--set", "c_execute=0.5"), "--set c_execute has no effect without execute"),
        ("policy", ("--set", "c_execute=0.5"), "--set c_execute has no effect without execute"),
        ("bound", ("--trust", "constant", "--set", "eta=0.5"), "--set eta has no effect with trust 'constant'"),
        ("policy", ("--trust", "constant", "--set", "eta=0.5"), "--set eta has no effect with trust 'constant'"),
        ("simulate", ("--trust", "outcome", "--set", "utility_scale=2"),
         "--set utility_scale has no effect with trust 'outcome'"),
    ],
)  # fmt: skip
def test_options_without_an_effect_are_refused(command: str, options: tuple[object, ...], words: str) -> None:
    team = () if command == "policy" else ("--humans", 2)
    result = invoke(command, TINY, *team, *options)
    assert (result.exit_code, result.stdout, words in " ".join(result.stderr.split())) == (2, "", True), result.stderr


def test_the_cost_of_execution_is_that_of_robots_that_execute() -> None:
    result = invoke(
        "simulate", TINY, "--humans", 2, "--episodes", 2, "--robots", "[{execute = true}, {}]", "--set", "c_execute=0.5"
    )
    assert (result.exit_code, result.stderr) == (0, ""), result.stderr


def test_the_rate_of_a_population_is_used_unless_an_option_sets_the_rule(tmp_path: Path) -> None:
    parts = [{"share": 1.0, "beta": [0.2, 0.5], "theta": [0.4, 0.6], "sigma": [0.0, 0.0]}]
    file = tmp_path / "people.json"
    file.write_text(json.dumps({"parts": parts, "eta": 0.9, "utility_scale": 2.0}))
    without = tmp_path / "without.json"
    without.write_text(json.dumps({"parts": parts, "eta": None}))

    def simulated(*options: object) -> tuple[dict, list]:
        short = ("--pool", 2, "--policy", "reactive", "--episodes", 20, "--set", "max_steps=60", "--json")
        found = invoke("simulate", TINY, "--humans", 2, *short, *options)
        assert found.exit_code == 0, found.stderr
        out = json.loads(found.stdout)
        return out["setting"], out["policies"]

    setting, results = simulated("--population", file)
    assert (setting["eta"], setting["utility_scale"]) == (0.9, 2.0)
    assert results == simulated("--population", without, "--set", "eta=0.9", "--set", "utility_scale=2.0")[1]
    for options in (("--set", "eta=0.2"), ("--trust", "constant"), ("--trust", "paper")):
        setting, results = simulated("--population", file, *options)
        assert (setting["eta"], setting["utility_scale"]) == (0.2, 1.0)
        assert results == simulated("--population", without, *options)[1]
    file.write_text(json.dumps({"parts": parts, "eta": "high"}))
    refused = invoke("simulate", TINY, "--humans", 2, "--population", file)
    assert (refused.exit_code, f"--population {file}: eta 'high'" in refused.stderr) == (2, True), refused.stderr


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("simulate", "--episodes", 99_999_999_999), 1, "99,999,999,999 episodes of 2 people take about 15,400,000 MB"),
        (("simulate", "--set", "memory_limit=0.5"), 1,
         "tiny.pddl: policies for 12 people, on as few as 20 states, take about"),
        (("bound", "--set", "memory_limit=1"), 1, "2 problems of people, each of up to"),
        (("bound", "--value-episodes", 10**11), 2, "100000000000; expected a whole number from 2 to 1e+08"),
        (("simulate", "--policy", "Attention"), 2, "'Attention'; did you mean 'attention'"),
        (("simulate", "--policy", "nowhere.py:f"), 2, "nowhere.py: no such file"),
        (("simulate", "--out", "same.jsonl", "--trace", "same.jsonl"), 2, "the same file as --out"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_before_the_work_begins(
    options: tuple[object, ...], code: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    command, *more = options
    result = invoke(command, TINY, "--humans", 2, *more)
    assert (result.exit_code, result.stdout) == (code, "")
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.cases
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("bound", TINY, "--humans", 2, "--gap", 5), "5; expected a fraction from 0 to 1, such as 0.05 for 5 %"),
        (("policy", TINY, "--gap", "5%"), "5%; expected a fraction from 0 to 1, such as 0.05 for 5 %"),
        (("solve", TINY, "--time-limit", "5min"), "5min; expected a number of seconds above 0"),
        (("solve", TINY, "--time-limit", ".5s"), ".5s; expected a number of seconds above 0"),
        (("fit", TINY, "own.toml", "--set", "time_limit=5min"),
         'time_limit: "5min"; expected a number of seconds above'),
        (("study-report", "min"), "min: no such file or folder; did you mean 'mine.py'?"),
        (("simulate", TINY, "--humans", 2, "--set", "gama=1"), "Error: --set gama: unknown; did you mean 'gamma'?"),
        (("simulate", TINY, "--humans", 2, "--population", "empty.json"), "empty.json: the file is empty; expected"),
        (("simulate", TINY, "--humans", 2, "--population", "cut.json"), "cut.json:2: not JSON (column 5: Expecting"),
        (("simulate", TINY, "--humans", 2, "--population", "epty.json"), "no such file; did you mean 'empty.json'?"),
        (("simulate", TINY, "--humans", 2, "--setting", "own"), "own: no such file; did you mean 'own.toml'?"),
        (("simulate", TINY, "--humans", 2, "--policy", "min.py:f"), "min.py: no such file; did you mean 'mine.py'?"),
        (("simulate", TINY, "--humans", 2, "--set", "distances=cut.json"), "distances: cut.json:2: not JSON"),
        (("fit", TINY, "epty.json"), "epty.json: no such file; did you mean 'empty.json'?"),
        (("solve", "./mine.pdl"), "mine.pdl: no such file or folder; did you mean 'mine.pddl'?"),
        (("simulate", TINY, "--humans", 2, "--set", "neighbours.rule=outcome", "--set", "neighbours.pairs=[[1, 9]]"),
         "Error: neighbours.pairs: station 9 in a team of 2; expected stations up to 2"),
        (("compare", TINY, "empty.json"), "expected models or rules first, such as kitassist compare models"),
    ],
)  # fmt: skip
def test_a_wrong_number_or_name_is_told_with_the_right_form(
    options: tuple[object, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in {"empty.json": "", "cut.json": '{\n"a":', "own.toml": "", "mine.py": "", "mine.pddl": ""}.items():
        Path(name).write_text(text)
    result = invoke(*options)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in " ".join(result.stderr.split())
    assert not re.search("Errno|Expecting value: line", result.stderr)


TEAM, LIVE = "simulate kitting/tiny --humans 2", "serve kitting/tiny --humans 2 --port 0"
SMALL = 'instances = ["kitting/tiny"]\nhumans = [1]\npool = 1\n'


@pytest.mark.cases
@pytest.mark.parametrize(
    ("command", "text", "said"),
    [
        (f"{TEAM} --setting", "\ngamma = \n", ":2: not TOML (column 9: Invalid value)"),
        (f"{TEAM} --setting", "gamma = [1\n", ":1: not TOML (end of document: Unclosed array)"),
        (f"{TEAM} --setting", "[population]\nbeta = [1, 2]\nshares = [1.0]",
         ":3: population: 0 parts, 1 shares: expected one share for each part"),
        (f"{TEAM} --setting", 'robots = [{c_move = 0.1}]\nobservation = {miss = 0.1}\nneighbours = {rule = "outcome"}',
         ":3: neighbours: expected none with an observation model, as robots do not know then what people saw"),
        (f"{TEAM} --setting", 'execute = true\nrobots = [{execute = true}]\nobservation = {miss = 0.1}',
         ":2: robot 1: execute: expected actions that are all seen as they are"),
        (f"{TEAM} --setting", '[neighbours]\nrule = "outcome"\nmatrix = [[0]]\npairs = [[1, 2]]',
         ":4: neighbours: pairs and matrix: expected one of them"),
        (f"{TEAM} --setting", '\ndistances = "no.json"', ":2: distances: no.json: no such file"),
        (f"{LIVE} --setting", '\nlanguage = "xx"', ":2: language: language 'xx': expected one"),
        (f"{LIVE} --bridge", "[broker\n", ":1: not TOML (column 8: Expected ']'"),
        ("serve --port 0 --config", "humans = 2\nhumans = 3\n", ":2: not TOML (column 11: Cannot overwrite a value)"),
        ("serve --port 0 --study", "\ntasks = \n", ":2: not TOML (column 9: Invalid value)"),
        ("study --out out --protocol", f"{SMALL}[setting]\nask_error = 0.1",
         ":4: setting: ask_error 0.1 has no effect without c_ask"),
        ("study --out out --protocol",
         f'{SMALL}[[conditions]]\nname = "a"\nsettings = [{{gamma = 0.9}}, {{ask_error = 0.1}}]',
         ":6: conditions[1].settings[2]: ask_error 0.1 has no effect without c_ask"),
        ("study --out out --protocol",
         f'{SMALL}[[conditions]]\nname = "a"\nsettings = [{{neighbours = {{rule = "outcome", pairs = [[1, 2]]}}}}]',
         ":6: conditions[1].settings[1]: neighbours.pairs: station 2 in a team of 1; expected stations up to 1"),
    ],
)  # fmt: skip
def test_a_fault_in_a_file_is_told_with_its_line(
    command: str, text: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.toml").write_text(text)
    result = invoke(*command.split(), "own.toml")
    assert (result.exit_code, result.stdout) == (2, "")
    assert f"own.toml{said}" in " ".join(result.stderr.split())


def test_a_bound_where_everybody_has_finished_is_zero(tmp_path: Path) -> None:
    problem = TINY.read_text()
    start = problem.index("(:goal")
    (tmp_path / "done.pddl").write_text(problem[:start] + "(:goal (and)))")
    domain = KITTING / "domain.pddl"
    result = invoke(
        "bound", tmp_path / "done.pddl", "--domain", domain, "--humans", 2, "--value-episodes", 10, "--json"
    )
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert (found["value"], found["upper"], found["gap_percent"]) == (0, 0, 0)


@pytest.mark.slow
def test_a_time_limit_is_for_all_of_a_bound_which_holds_all_the_same() -> None:
    """With any time limit, a valid bound is proven."""
    options: tuple[Any, ...] = (TINY, "--humans", 3, "--c-suggest", 0.1, "--set", "gamma=0.95", "--json")
    short = invoke("bound", *options, "--time-limit", 0.05, "--gap", 0)
    assert short.exit_code == 0, short.output
    good = json.loads(invoke("bound", *options, "--value-episodes", 2000).stdout)
    hasty = json.loads(short.stdout)
    assert hasty["upper"] >= good["upper"] - 1e-9
    assert hasty["value"] <= hasty["upper"] + 4 * hasty["value_stderr"]
    assert (hasty["price"], hasty["episodes"]) == ([], 1024)  # no round of prices, and one batch of episodes


def test_a_single_episode_has_no_standard_error() -> None:
    said = invoke("simulate", str(TINY), "--humans", "1", "--policy", "none", "--episodes", "1").stdout
    assert "8.00" in said
    assert said.endswith("of one episode; 1 of 12 people drawn\n")
    assert "nan" not in said
    assert "±" not in said
