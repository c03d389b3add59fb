"""A trust rule of the user's own, wherever a rule can be given, and what is said of one that is impossible."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import invoke
from recorded import write_log

import assist
from assist.certify import upper_bound
from assist.learning import RuleFamily, compare_rules, fit_influence, replayed
from assist.live import Assistant, Session
from assist.people import Population, UserCodeError
from assist.person import Setting
from assist.team import Pool, simulate
from planner import InputFileError, cost_to_go, sweep

TINY = "kitting/tiny"

OWN = """
from dataclasses import dataclass
import numpy as np

@dataclass(frozen=True)
class Disappointed:
    step: float = 0.1
    uses_answer = True
    feedback = "true"

    def update(self, theta, event):
        return np.clip(theta - self.step * (event.followed & event.shown & ~event.right), 0.0, 1.0)

strongly = Disappointed(0.3)

class Misspelt(Disappointed):
    def update(self, theta, event):
        return np.clip(theta + 0.1 * event.folowed, 0.0, 1.0)
"""


@dataclass(frozen=True)
class Disappointed:
    """Theta falls after a suggestion that was wrong."""

    step: float = 0.3
    uses_answer = True
    feedback = "true"

    def update(self, theta: Any, event: Any) -> Any:
        return np.clip(theta - self.step * (event.followed & event.shown & ~event.right), 0.0, 1.0)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (file := tmp_path / "rules.py").write_text(OWN)
    return file


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of people who sometimes follow suggestions."""
    pool = Pool.sample(TINY, 2, seed=0, setting=Setting(c_suggest=0.01, suggestions="all"))
    rows: list[Any] = []
    _ = simulate(pool, "reactive", humans=2, episodes=4, seed=0, trace=rows)
    return write_log(tmp_path_factory.mktemp("log") / "log.jsonl", rows)


def test_a_rule_in_a_file_is_the_same_as_the_object(own: Path) -> None:
    """It is simulated, bounded and recorded."""

    def pool_of(rule: Any) -> Pool:
        return Pool.sample(TINY, 2, seed=0, setting=Setting(trust=rule, suggestions="all", c_suggest=0.01, gamma=0.6))

    pools = [pool_of(rule) for rule in (Disappointed(0.3), f"{own}:strongly")]
    episodes = [simulate(pool, "attention", humans=2, episodes=20, seed=0).discounted_return for pool in pools]
    assert np.array_equal(*episodes)
    bounds = [upper_bound(pool, gap=0.2, window=0).upper for pool in pools]
    assert bounds[0] == bounds[1]
    assert assist.check(f"{own}:strongly").faults == ()


def test_commands_take_a_rule_in_a_file(own: Path, log: Path, tmp_path: Path) -> None:
    rule = f"{own}:strongly"
    done = invoke("simulate", TINY, "--humans", 2, "--episodes", 5, "--trust", rule)
    assert done.exit_code == 0, done.output
    (tmp_path / "own.toml").write_text('trust = "rules.py:strongly"\n')
    assert invoke("simulate", TINY, "--humans", 2, "--episodes", 5, "--setting", tmp_path / "own.toml").exit_code == 0
    fitted = invoke("fit", TINY, log, "--influence", rule)
    assert (fitted.exit_code, f"trust rule {rule};" in fitted.stdout) == (0, True), fitted.output
    document = json.loads(invoke("compare", "rules", TINY, log, "--folds", 2, "--rule", rule, "--json").stdout)
    assert [row["model"] for row in document["models"]] == ["constant", rule]
    shown = invoke("compare", "rules", TINY, log, "--folds", 2, "--rule", rule).stdout
    assert shown.endswith("; best: constant, since no other predicts better than it at 95% (p, corrected)\n")
    refused = invoke("fit", TINY, log, "--influence", rule, "--write-population", tmp_path / "p.json")
    assert (refused.exit_code, "has no rules of your own" in refused.stderr) == (2, True)
    refused = invoke("fit", TINY, log, "--influence", "papr")
    assert (refused.exit_code, "did you mean 'paper'?" in refused.stderr) == (2, True)


def test_a_saved_team_takes_its_rule_again(own: Path) -> None:
    """Its setting is given again; another one is refused, and no file is run because a document names it."""
    tiny, setting = sweep(TINY), Setting(trust=f"{own}:strongly")
    team = Assistant(tiny, ["ann"], setting=setting)
    team.observe("ann", team.person("ann").applicable[0])
    document = team.to_json()
    again = Assistant.from_json(document, tiny, setting=setting)
    assert np.array_equal(again.person("ann").belief, team.person("ann").belief)
    with pytest.raises(
        ValueError, match=r"trust was .*rules.py:strongly, a rule of your own; expected the team's setting"
    ):
        Assistant.from_json(document, tiny)
    with pytest.raises(ValueError, match="another than that of the saved team"):
        Assistant.from_json(document, tiny, setting=Setting(trust="constant"))


def test_a_session_goes_on_with_the_same_rule_only(tmp_path: Path) -> None:
    tiny, journal = sweep(TINY), tmp_path / "session.sqlite"
    for _ in range(2):
        session = Session(tiny, journal, setting=Setting(trust=Disappointed(0.3)))
        if not session.people:
            session.join("ann")
        session.close()

    @dataclass(frozen=True)
    class Other(Disappointed):
        def update(self, theta: Any, event: Any) -> Any:
            return super().update(theta, event) * 0.5

    Other.__qualname__ = "Disappointed"
    said = "the rule of trust leads theta elsewhere than when the session began, so its code has changed; expected"
    with pytest.raises(InputFileError, match=said):
        Session(tiny, journal, setting=Setting(trust=Other(0.3)))


@pytest.mark.cases
def test_a_session_goes_on_from_another_folder_with_the_same_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service that the system starts again has another working folder."""
    tiny, file = sweep(TINY), tmp_path / "code" / "rules.py"
    file.parent.mkdir()
    file.write_text(OWN)

    def opened(folder: Path, rule: str) -> None:
        monkeypatch.chdir(folder)
        Session(tiny, tmp_path / "session.sqlite", setting=Setting(trust=rule)).close()

    for folder, rule in ((file.parent, "rules.py:strongly"), (tmp_path, "code/rules.py:strongly")):
        opened(folder, rule)
    opened(tmp_path, f"{file}:strongly")
    with pytest.raises(InputFileError, match=r"setting trust rules\.py:strongly, not rules\.py:Disappointed"):
        opened(tmp_path, "code/rules.py:Disappointed")


def rule(update: Any, **attributes: Any) -> Any:
    usual = {"uses_answer": True, "feedback": "true", "update": lambda _, theta, event: update(theta, event)}
    return type("Mine", (), usual | attributes)()


@pytest.mark.cases
@pytest.mark.parametrize(
    ("given", "said"),
    [
        (Disappointed, "Disappointed is a class; expected its object, such as Disappointed()"),
        (rule(lambda theta, _: theta + 10), r"Mine: leads to theta 10(\.01)?; expected a number from 0 to 1"),
        (rule(lambda theta, _: theta * np.nan), "Mine: leads to theta nan; expected a number from 0 to 1"),
        (rule(lambda theta, event: theta * event.folowed), "Mine: AttributeError: .* has no attribute 'folowed'"),
        (rule(lambda theta, event: theta * event.followed, uses_answer=False), "though its `uses_answer` is False"),
        (rule(lambda theta, _: theta, feedback="always"), "has feedback 'always'; expected one of perceived, true"),
        (rule(lambda theta, _: theta[:3]), r"returns shape \(3, 1\) for 11 thetas and 16 events"),
    ],
)
def test_an_impossible_rule_is_refused_where_it_is_given(given: Any, said: str) -> None:
    with pytest.raises(UserCodeError, match=f"^trust: .*{said}"):
        Setting(trust=given)
    with pytest.raises(UserCodeError, match=r"^believed_trust: "):
        Setting(believed_trust=given)
    with pytest.raises(UserCodeError, match=said):
        fit_influence([], given)


def test_a_fault_in_a_file_has_its_line(own: Path) -> None:
    with pytest.raises(UserCodeError, match=r"rules.py:18: AttributeError: 'Event' object has no attribute 'folowed'"):
        Setting(trust=f"{own}:Misspelt")
    refused = invoke("simulate", TINY, "--humans", 1, "--trust", f"{own}:Misspelt")
    assert (refused.exit_code, "--trust: " in refused.stderr, "rules.py:18: " in refused.stderr) == (2, True, True)
    assert invoke("check", f"{own}:Misspelt").stdout.count("\n") == 1


def test_rules_are_compared_as_they_are_given(log: Path) -> None:
    """By name, as objects, as families, in a mapping or a list."""
    seen = replayed(TINY, log)
    in_a_list = compare_rules(seen, rules=["constant", Disappointed()], folds=2)
    named = {"constant": "constant", "mine": Disappointed(), "again": RuleFamily.of(Disappointed())}
    in_a_mapping = compare_rules(seen, rules=named, folds=2)
    assert [one.model for one in in_a_list.scores] == ["constant", "Disappointed"]
    nats = [score.nats_per_choice for score in in_a_mapping.scores]
    assert [one.model for one in in_a_mapping.scores] == list(named)
    assert nats[1] == nats[2] == in_a_list["Disappointed"].nats_per_choice
    assert [one.difference is None for one in compare_rules(seen, rules=["paper", "outcome"], folds=2).scores] == [
        True,
        False,
    ]


def test_a_rule_that_was_given_is_not_shown_as_estimated(log: Path) -> None:
    seen = replayed(TINY, log)
    assert "step 0.3 (given)" in repr(fit_influence(seen, Disappointed()))
    assert re.search(r"eta [\d.e?-]+, utility_scale 1 \(given\)", repr(fit_influence(seen, "paper")))


@pytest.mark.cases
def test_what_is_no_setting_or_population_is_refused() -> None:
    tiny, no_setting = sweep(TINY), "a dict where a Setting was expected, such as Setting"
    for wrong in ({"c_suggest": 5.0}, {}):
        with pytest.raises(TypeError, match=no_setting):
            Assistant(tiny, ["ann"], setting=wrong)  # type: ignore[arg-type]
        with pytest.raises(TypeError, match=no_setting):
            Assistant(tiny, ["ann"], setting=wrong, robots=2)  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="a dict where a Population was expected"):
            Assistant(tiny, ["ann"], population=wrong)  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="a dict where a Population was expected"):
            Pool.sample(tiny, 2, seed=0, population=wrong)  # type: ignore[arg-type]
        with pytest.raises(TypeError, match="a dict where a Population was expected"):
            Pool.sample(tiny, 2, seed=0, population=Population(), prior=wrong)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="a float where Limits were expected, such as Limits"):
        cost_to_go(TINY, limits=5.0)  # type: ignore[arg-type]
