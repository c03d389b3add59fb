"""Options of `serve`: the session that is built from them, its people, and messages about faults."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DOMAINS, KITTING, invoke

from assist.live import Began, Paused, Session
from assist.live.event_base import TeamEvent
from assist.live.header import _chances
from assist.live.live_setting import LiveSetting
from assist.live.simulated_person import SimulatedPerson
from assist.people import Human, Population, Weighted
from assist.people.memory import choices_of
from assist.people.user_code import UserChoiceModel, _loaded
from assist.web import server
from planner import OnDemand, Table

TINY, PAPER = KITTING / "tiny.pddl", KITTING / "paper.pddl"
WRONG, RIGHT = "(place hammer slot-2 box-a)", "(place hammer slot-1 box-a)"

OWN = """\
import numpy as np


def in_turn(team):
    return team.act(team.active.argmax(axis=1), team.first_optimal())


def oops(team):
    return {}["oops"]


def moves(choices, q, beta):
    share = choices.applicable / np.maximum(choices.applicable.sum(axis=1), 1)[:, None]
    return np.repeat(share[None], len(beta), axis=0)


def always(choices, q, beta):
    first = choices.applicable & (np.arange(q.shape[1]) == 0)
    return np.repeat(first[None].astype(float), len(beta), axis=0)
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    file = tmp_path / "own.py"
    file.write_text(OWN)
    return file


class Begun:
    """Return the plan and its session, without starting a service."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.sessions: list[Session] = []

        def serve(plan: server.Plan, session: Session, listening: Any, *rest: Any) -> None:
            self.plan, self._read_again = plan, rest[-1]
            self.sessions.append(session)
            listening.close()

        monkeypatch.setattr(server, "serve", serve)

    def __call__(self, *options: Any) -> Session:
        self.end()
        result = invoke("serve", *options, "--port", 0)
        assert result.exit_code == 0, result.output
        return self.sessions[-1]

    def again(self) -> list[TeamEvent]:
        """Return what follows from the configuration when it is read again."""
        found: list[TeamEvent] = self._read_again().events
        return found

    def end(self) -> None:
        for session in self.sessions:
            session.close()


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> Iterator[Begun]:
    found = Begun(monkeypatch)
    yield found
    found.end()


def test_a_policy_of_ones_own_decides(begun: Begun, own: Path, tmp_path: Path) -> None:
    options = (TINY, "--humans", 2, "--data", tmp_path / "data")
    session = begun(*options, "--policy", f"{own}:in_turn")
    assert [session.person(name)["suggestion"] for name in session.people] == ["(fetch box-a)"] * 2
    assert session.observe("person-1", "(fetch box-a)")["suggestion"] == RIGHT
    assert begun(*options, "--policy", f"{own}:in_turn").person("person-1")["steps"] == 1
    begun.end()
    refused = invoke("serve", *options, "--port", 0)
    _preparing, said = refused.stderr.splitlines()
    assert (refused.exit_code, "has policy in_turn, not attention" in said) == (2, True)


def test_people_go_on_where_a_policy_fails(begun: Begun, own: Path, tmp_path: Path) -> None:
    options = (TINY, "--humans", 2, "--data", tmp_path / "data", "--policy", f"{own}:oops")
    session = begun(*options)
    seen = session.observe("person-1", "(fetch box-a)", id="1")
    assert (seen["steps"], seen["suggestion"]) == (1, None)
    assert session.outlook().fault == f"{own}:9: KeyError: 'oops'"
    believed = session.beliefs()
    session = begun(*options)
    assert session.beliefs() == believed
    assert session.observe("person-1", "(fetch box-a)", id="1") == seen


@pytest.mark.cases
def test_distances_may_have_places_for_people_who_join_later(begun: Begun, tmp_path: Path) -> None:
    """Also those with which a session goes on after it was read again for one more person."""
    (file := tmp_path / "distances.json").write_text(json.dumps((1 - np.eye(3)).tolist()))
    options = (TINY, "--humans", 2, "--data", tmp_path / "data", "--set", f"distances={file}")
    session = begun(*options)
    larger = (1 - np.eye(4)).tolist()
    session.rearrange(larger)
    session.join("ann")
    file.write_text(json.dumps(larger))
    assert begun(*options).people == ("person-1", "person-2", "ann")
    file.write_text(json.dumps((1 - np.eye(2)).tolist()))
    refused = invoke("serve", *options[:3], "--port", 0, *options[5:])
    assert (refused.exit_code, "shape (2, 2): expected (3, 3), 2 people" in refused.stderr) == (2, True)


@pytest.mark.cases
def test_a_table_of_tasks_may_name_whoever_has_joined(begun: Begun, tmp_path: Path) -> None:
    """Present or not; after a restart everybody goes on with the task at which they were."""
    config = tmp_path / "line.toml"
    head = 'instances = ["kitting/tiny", "lockers/one-parcel"]\nhumans = 2\ndata = "data"\n[tasks]\n'
    config.write_text(head + 'person-2 = "tiny"')
    session = begun("--config", config)
    session.join("Zoë B")
    config.write_text(head + 'person-1 = "tiny"\n"Zoë B" = "one-parcel"')
    assert begun.again() == [Began(person="Zoë B", task="one-parcel")]
    session.leave("Zoë B")
    config.write_text(head + 'person-1 = "one-parcel"\n"Zoë B" = "one-parcel"')
    assert begun.again() == [Began(person="person-1", task="one-parcel")]
    session = begun("--config", config)
    assert [session.person(name)["task"] for name in session.people] == ["tiny", "tiny"]
    assert begun.again() == [Began(person="person-1", task="one-parcel")]
    config.write_text(head + 'ann = "tiny"')
    with pytest.raises(ValueError, match="there is no person 'ann'"):
        begun.again()


@pytest.mark.parametrize(
    "instance", [TINY, pytest.param(DOMAINS / "lockers" / "two-trays.pddl", marks=pytest.mark.slow)], ids=["", "large"]
)
def test_people_choose_as_a_function_says(begun: Begun, own: Path, tmp_path: Path, instance: Path) -> None:
    options = (instance, "--humans", 2, "--simulate", 1, "--c-suggest", 0.02, "--data", tmp_path / "data")
    options += ("--set", f"population.chooses={own}:moves")
    session = begun(*options)
    task, state = session.task_and_state("simulated-1")
    chance = begun.plan.seats().people["simulated-1"].chances(task, state)
    assert chance == pytest.approx(np.full(len(chance), 1 / len(chance)))
    if instance == TINY:
        for action in ("(fetch box-a)", WRONG):
            session.observe("person-1", action)
        # Random choices do not depend on beta, so that nothing is learned about it.
        beta = np.frombuffer(session.beliefs()["person-1"]).reshape(6, 10).sum(axis=1)
        assert beta == pytest.approx(np.full(6, 1 / 6))
    begun(*options)
    begun.end()
    own.write_text(OWN.replace("def moves", "def other").replace("def always", "def moves"))
    _loaded.cache_clear()
    refused = invoke("serve", *options, "--port", 0)
    assert (refused.exit_code, "has chances" in refused.stderr) == (2, True)


def test_people_are_drawn_from_a_file(begun: Begun, tmp_path: Path) -> None:
    file = tmp_path / "population.json"
    fixed = {"beta": [2.0, 2.0], "theta": [0.9, 0.9], "sigma": [0.0, 0.0], "noise": "state"}
    file.write_text(json.dumps({"parts": [fixed | {"weights": {"name": [9.0, 9.0]}, "share": 1.0}]}))
    session = begun(TINY, "--humans", 1, "--simulate", 1, "--set", f"population={file}")
    (person,) = begun.plan.seats().people.values()
    assert (person.human.beta, person.theta, person.human.weights) == (2.0, 0.9, {"name": 9.0})
    assert np.frombuffer(session.beliefs()["simulated-1"]).size == 10  # beta is known


def test_the_printed_setting_of_serve_is_accepted_unedited(begun: Begun, tmp_path: Path) -> None:
    (file := tmp_path / "all.toml").write_text(invoke("settings", "serve").stdout)
    begun(TINY, "--humans", 2, "--setting", file)
    assert begun.plan.setting == LiveSetting()
    file.write_text(file.read_text().replace("pace = 3.0", "pace = 4.0").replace("max_steps = 500", "max_steps = 5"))
    line = 1 + file.read_text().splitlines().index("pace = 4.0")
    result = invoke("serve", TINY, "--humans", 2, "--port", 0, "--setting", file)
    assert (result.exit_code, f"{file}:{line}: pace has no effect without --simulate" in result.stderr) == (2, True)


@pytest.mark.parametrize("content", ["gamma = 0.9\n[setting]\nc_suggest = 0.2", "gamma = 0.9\ninstances = []"])
def test_a_file_for_config_is_told_from_one_for_setting(content: str, tmp_path: Path) -> None:
    (file := tmp_path / "live.toml").write_text(content)
    result = invoke("serve", TINY, "--humans", 2, "--port", 0, "--setting", file)
    said = f"{file}:2: {'setting' if 'setting' in content else 'instances'}: unknown; this is a file for --config"
    assert (result.exit_code, said in " ".join(result.stderr.split())) == (2, True)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--policy", "nobody"), "expected one of none"),
        (("--policy", "own.py:missing"), "no such file"),
        (("--set", "population.chooses=x"), "expected FILE.py:FUNCTION"),
        (("--set", "execute=true"), "expected a robot that suggests"),
        (("--simulate", 3), "3 is more than --humans 2"),
        (("--set", f"distances={TINY}"), "distances"),
        (("--set", "gamma=2"), "gamma"),
        (("--set", "population.sigma=[2, 1]"), "--set population.sigma: [2, 1]; expected two numbers"),
        (("--set", "population.sigma=[0.1, 1.0]"), "population.sigma has no effect without --simulate"),
        (("--set", "pace=1"), "--set pace has no effect without --simulate"),
        (("--set", "seed=1"), "--set seed has no effect without --simulate"),
        (("--set", "keep_people=30"), "--set keep_people has no effect without people_store"),
        (("--set", "eta=0.3"), "--set eta has no effect without trust"),
        (("--set", "utility_scale=2", "--set", "trust=outcome"),
         "--set utility_scale has no effect with trust 'outcome'"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_in_one_line_before_anything_is_served(
    begun: Begun, options: tuple[Any, ...], says: str
) -> None:
    result = invoke("serve", TINY, "--humans", 2, "--port", 0, *options)
    assert result.exit_code == 2, result.output
    assert says in result.stderr
    assert "Traceback" not in result.stderr
    assert begun.sessions == []


def test_options_that_need_another_one_are_accepted_with_it(begun: Begun, tmp_path: Path) -> None:
    rule = ("--set", "trust=paper", "--set", "eta=0.3", "--set", "utility_scale=2")
    kept = ("--set", f"people_store={tmp_path / 'people.sqlite'}", "--set", "keep_people=7")
    options = ("--simulate", 1, "--set", "population.sigma=[0.2, 0.4]", "--set", "pace=1", "--set", "seed=5")
    begun(TINY, "--humans", 2, *options, *rule, *kept)
    setting = begun.plan.setting
    assert (setting.eta, setting.utility_scale, setting.pace, setting.seed, setting.keep_people) == (0.3, 2, 1, 5, 7)


def test_a_function_is_known_again_where_states_are_met_in_another_order(tiny: Table, own: Path) -> None:
    functions = [Population(chooses=UserChoiceModel.load(own, name)) for name in ("moves", "always")]
    asked, other = OnDemand(tiny.task, jobs=1), OnDemand(tiny.task, jobs=1)
    other.choices(other.choices([0]).targets[::-1])
    assert _chances(asked, functions[0]) == _chances(other, functions[0]) != _chances(asked, functions[1])


def test_several_tasks_are_given_in_turn_and_each_has_its_log(begun: Begun) -> None:
    session = begun(TINY, PAPER, "--humans", 3)
    assert session.tasks == ("tiny", "paper")
    tasks = [session.person(name)["task"] for name in session.people]
    assert tasks == ["tiny", "paper", "tiny"]
    assert session.person("person-2")["cost_to_go"] == 10.0
    assert session.join("guest", "paper")["task"] == "paper"
    for name in session.people:
        session.observe(name, "(fetch box-a)")
    session.begin("person-1", "paper")
    session.observe("person-1", "(fetch box-b)")
    rows = [(row["person"], row["episode"], row["task"]) for row in session.log("paper")]
    assert rows == [("person-1", "2", "paper"), ("person-2", "1", "paper"), ("guest", "1", "paper")]
    assert len(session.log()) == 5
    with pytest.raises(ValueError, match="expected one of tiny, paper"):
        session.log("none")


def test_a_simulated_person_chooses_as_the_model_says(tiny: Table) -> None:
    """Along a walk, terms with memory have the values of a `Human` on states with memory."""
    weights = {"goals": 0.7, "name": -0.4, "arguments": 1.1, "back": -2.0}
    ranges = {name: (weight, weight) for name, weight in weights.items()}
    population = Population((1.3, 1.3), (0.8, 0.8), (0.0, 0.0), weights=ranges)
    person, choices = SimulatedPerson(population, seed=1), choices_of(tiny, weights)
    human = Human(1.3, 0.8, 0.0, choices.h.copy(), Weighted(weights))
    expected, row, looked_back = human.chances(choices), choices.initial, 0
    plain = Human(1.3, 0.8, 0.0, choices.h.copy()).chances(choices)
    task_states = choices.of_task(np.arange(choices.task_states))
    for _ in range(40):
        state = int(task_states[row])
        if choices.goal[row]:
            break
        names = [choices.name(row, slot) for slot in range(int(choices.applicable[row].sum()))]
        assert person.chances(tiny, state) == pytest.approx(expected[row][: len(names)], abs=1e-12)
        looked_back += not np.allclose(expected[row], plain[row])
        done = person.act(tiny, state, names, None)
        row = int(choices.targets[row, names.index(done)])
    assert looked_back > 3


def test_the_service_says_which_seats_are_simulated(begun: Begun, tmp_path: Path) -> None:
    from starlette.testclient import TestClient

    from assist.web.app import make_app
    from assist.web.service import Service
    from assist.web.tokens import AccessTokens

    session = begun(TINY, PAPER, "--humans", 2, "--simulate", 1, "--set", "tick=60")
    service = Service(session, AccessTokens.kept(tmp_path / "secret", "http://testserver"))
    service.simulated = frozenset(begun.plan.simulated)
    headers = {"Authorization": f"Bearer {service.access.operator}"}
    with TestClient(make_app(service)) as client:
        team = client.get("/api/team", headers=headers).json()
        assert [(one["connected"], one["simulated"]) for one in team["people"]] == [(False, False), (False, True)]
        assert (team["tasks"], team["fault"]) == (["tiny", "paper"], None)
        come = client.post("/api/team/people", headers=headers, json={"person": "eve", "task": "paper"})
        assert come.status_code == 200
        assert client.get("/api/people/eve", headers=headers).json()["cost_to_go"] == 10.0
        client.post("/api/people/eve/actions", headers=headers, json={"action": "(fetch box-a)"})
        for task, count in (("paper", 1), ("tiny", 0)):
            assert len(client.get("/api/log", headers=headers, params={"task": task}).text.splitlines()) == count
        assert client.get("/api/log", headers=headers, params={"task": "none"}).status_code == 422
        session.report_all([Paused()])
