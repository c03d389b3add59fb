"""Rules of the user's own, of trust and of what neighbours see, wherever they can be given; impossible ones refused."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from conftest import invoke
from recorded import write_log

import assist
from assist.certify import upper_bound
from assist.learning import Method, RuleFamily, compare_rules, fit_influence, replayed
from assist.live import Assistant, Session
from assist.people import Neighbours, Population, UserCodeError
from assist.person import Setting
from assist.studies import read
from assist.team import Pool, simulate
from planner import InputFileError, cost_to_go, sweep

TINY = "kitting/tiny"
OF_TRUST = """
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
OF_NEIGHBOURS = """
from dataclasses import dataclass
import numpy as np

@dataclass(frozen=True)
class Contagion:
    rate: float = 0.1

    def update(self, theta, event):
        return theta + self.rate * event.weight * (np.where(event.followed, 1.0, 0.0) - theta)

    def envelope(self, theta, gain, weight):
        return theta * (1 - self.rate * weight), theta + self.rate * weight * (1 - theta)

strongly = Contagion(0.3)

class Misspelt(Contagion):
    def update(self, theta, event):
        return theta + 0.1 * event.folowed
"""


@dataclass(frozen=True)
class Disappointed:
    """Theta falls after a suggestion that was wrong."""

    step: float = 0.3
    uses_answer = True
    feedback = "true"

    def update(self, theta: Any, event: Any) -> Any:
        return np.clip(theta - self.step * (event.followed & event.shown & ~event.right), 0.0, 1.0)


@dataclass(frozen=True)
class Contagion:
    """Theta comes nearer to what the neighbour did."""

    rate: float = 0.3

    def update(self, theta: Any, event: Any) -> Any:
        return theta + self.rate * event.weight * (np.where(event.followed, 1.0, 0.0) - theta)

    def envelope(self, theta: Any, _: Any, weight: float) -> Any:
        return theta * (1 - self.rate * weight), theta + self.rate * weight * (1 - theta)


def with_trust(rule: Any, **fields: Any) -> Setting:
    return Setting(**{"trust": rule, "suggestions": "all", "c_suggest": 0.01, "c_move": 0.0, "gamma": 0.8} | fields)


def with_neighbours(rule: Any, **fields: Any) -> Setting:
    return Setting(
        **{"neighbours": Neighbours(rule=rule), "trust": "constant", "c_suggest": 0.01, "c_move": 0.0, "gamma": 0.6}
        | fields
    )


class Kind(NamedTuple):
    """What differs between the two kinds of rules."""

    code: str
    object: Any
    setting: Callable[..., Setting]
    field: str
    line: int


KINDS = {
    "trust": Kind(OF_TRUST, Disappointed, with_trust, "trust", 18),
    "neighbours": Kind(OF_NEIGHBOURS, Contagion, with_neighbours, "neighbours.rule", 19),
}


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest, tmp_path: Path) -> Kind:
    (tmp_path / "rules.py").write_text(KINDS[request.param].code)
    return KINDS[request.param]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of people who sometimes follow suggestions."""
    pool = Pool.sample(TINY, 2, seed=0, setting=Setting(c_suggest=0.01, suggestions="all"))
    rows: list[Any] = []
    _ = simulate(pool, "reactive", humans=2, episodes=4, seed=0, trace=rows)
    return write_log(tmp_path_factory.mktemp("log") / "log.jsonl", rows)


def test_a_rule_in_a_file_is_the_same_as_the_object(kind: Kind, tmp_path: Path) -> None:
    """It is simulated, bounded and checked."""
    rules = (kind.object(), f"{tmp_path / 'rules.py'}:strongly", "constant" if kind.field == "trust" else "none")
    pools = [Pool.sample(TINY, 3, seed=0, setting=kind.setting(rule)) for rule in rules]
    own, same, other = (simulate(pool, "attention", humans=3, episodes=30, seed=0) for pool in pools)
    assert np.array_equal(own.discounted_return, same.discounted_return)
    assert not np.array_equal(own.discounted_return, other.discounted_return)
    bounds = [upper_bound(pool, (0, 1), gap=0.5, window=0).upper for pool in pools[:2]]
    assert bounds[0] == bounds[1]
    checked = assist.check(f"{tmp_path / 'rules.py'}:strongly")
    assert (checked.kind, checked.faults) == (kind.field.partition(".")[0], ())


def test_commands_take_a_rule_in_a_file(kind: Kind, log: Path, tmp_path: Path) -> None:
    rule = f"{tmp_path / 'rules.py'}:strongly"
    given = ("--set", f"{kind.field}={rule}")
    done = invoke("simulate", TINY, "--humans", 2, "--episodes", 5, "--policy", "attention-outlook", *given)
    assert done.exit_code == 0, done.output
    (tmp_path / "own.toml").write_text(f'{kind.field} = "rules.py:strongly"\n')
    assert invoke("simulate", TINY, "--humans", 2, "--episodes", 5, "--setting", tmp_path / "own.toml").exit_code == 0
    refused = invoke("simulate", TINY, "--humans", 2, "--set", f"{kind.field}={tmp_path / 'rules.py'}:Misspelt")
    said = f"rules.py:{kind.line}: AttributeError: '" in refused.stderr
    assert (refused.exit_code, said, "no attribute 'folowed'" in refused.stderr) == (2, True, True), refused.output
    assert invoke("check", f"{tmp_path / 'rules.py'}:Misspelt").stdout.count("\n") == 1
    if kind.field == "trust":
        asked, compared = ("--influence", rule), ("--rule", rule)
        words, models = f"trust rule {rule};", ["constant", rule]
    else:
        asked = compared = ("--influence", "constant", "--set", "theta_per_episode=true", *given)
        words, models = f"trust rule constant, neighbours {rule};", [rule]
    fitted = invoke("fit", TINY, log, *asked)
    assert (fitted.exit_code, words in fitted.stdout) == (0, True), fitted.output
    document = json.loads(invoke("compare", "rules", TINY, log, "--folds", 2, *compared, "--json").stdout)
    assert [row["model"] for row in document["models"]][-len(models) :] == models


def test_what_commands_say_of_rules(log: Path, tmp_path: Path) -> None:
    (tmp_path / "rules.py").write_text(OF_TRUST)
    rule = f"{tmp_path / 'rules.py'}:strongly"
    shown = invoke("compare", "rules", TINY, log, "--folds", 2, "--rule", rule).stdout
    assert shown.endswith("; best: constant, since no other predicts better than it at 95% (p, corrected)\n")
    refused = invoke("fit", TINY, log, "--influence", rule, "--write-population", tmp_path / "p.json")
    assert (refused.exit_code, "has no rules of your own" in refused.stderr) == (2, True)
    refused = invoke("fit", TINY, log, "--influence", "papr")
    assert (refused.exit_code, "did you mean 'paper'?" in refused.stderr) == (2, True)


def test_a_study_knows_when_the_file_of_a_rule_has_changed(kind: Kind, tmp_path: Path) -> None:
    (file := tmp_path / "study.toml").write_text(
        'title = "own"\nrepeats = 1\ninstances = ["kitting/tiny"]\nhumans = [2]\npool = 2\ndraws = 1\ntrials = 1\n'
        'policies = ["none", "attention"]\n[[conditions]]\nname = "main"\n'
        f'settings = [{{ {kind.field} = "rules.py:strongly" }}]\n'
    )
    study = read(file)
    before = study.fingerprint()
    (tmp_path / "rules.py").write_text(kind.code.replace("0.3", "0.2"))
    assert study.fingerprint() != before


def test_a_saved_team_and_a_session_go_on_with_the_same_rule_only(kind: Kind, tmp_path: Path) -> None:
    """The setting is given again; another one is refused, and no file is run because a document names it."""
    tiny, given = sweep(TINY), kind.setting(f"{tmp_path / 'rules.py'}:strongly")
    team = Assistant(tiny, ["ann", "ben"], setting=given)
    team.observe("ann", team.person("ann").applicable[0])
    document = team.to_json()
    again = Assistant.from_json(document, tiny, setting=given)
    assert np.array_equal(again.person("ann").belief, team.person("ann").belief)
    with pytest.raises(ValueError, match=rf"{kind.field} was .*rules.py:strongly, a rule of your own; expected the"):
        Assistant.from_json(document, tiny)
    with pytest.raises(ValueError, match="another than that of the saved team"):
        Assistant.from_json(document, tiny, setting=kind.setting(kind.object(0.1)))

    class Other(kind.object):  # type: ignore[name-defined, misc]
        def update(self, theta: Any, event: Any) -> Any:
            return super().update(theta, event) * 0.9

        def envelope(self, theta: Any, *_: Any) -> Any:
            return theta * 0, np.ones_like(theta)

    Other.__qualname__ = kind.object.__name__
    for _ in range(2):
        Session(tiny, tmp_path / "session.sqlite", setting=kind.setting(kind.object())).close()
    with pytest.raises(InputFileError, match=rf"the rule of {kind.field} leads theta elsewhere than when the session"):
        Session(tiny, tmp_path / "session.sqlite", setting=kind.setting(Other()))


@pytest.mark.cases
def test_a_session_goes_on_from_another_folder_with_the_same_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A service that the system starts again has another working folder."""
    tiny, file = sweep(TINY), tmp_path / "code" / "rules.py"
    file.parent.mkdir()
    file.write_text(OF_TRUST)

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


def stays(_: Any, theta: Any, *_of_event: Any) -> Any:
    return theta, theta


MISSPELT = rule(lambda theta, event: theta * event.folowed)


@pytest.mark.cases
@pytest.mark.parametrize(
    ("of", "given", "said"),
    [
        ("trust", Disappointed, "Disappointed is a class; expected its object, such as Disappointed()"),
        ("trust", rule(lambda theta, _: theta + 10), r"Mine: leads to theta 10(\.01)?; expected a number from 0 to 1"),
        ("trust", rule(lambda theta, _: theta * np.nan), "Mine: leads to theta nan; expected a number from 0 to 1"),
        ("trust", MISSPELT, "Mine: AttributeError: .* has no attribute 'folowed'"),
        ("trust", rule(lambda theta, event: theta * event.followed, uses_answer=False), "its `uses_answer` is False"),
        (
            "trust",
            rule(lambda theta, _: theta, feedback="always"),
            "feedback 'always'; expected one of",
        ),
        ("trust", rule(lambda theta, _: theta[:3]), r"returns shape \(3, 1\) for 11 thetas and 16 events"),
        ("neighbours", Contagion, "Contagion is a class; expected its object, such as Contagion()"),
        ("neighbours", rule(lambda theta, _: theta + 10), "Mine: leads to theta 10; expected a number from 0 to 1"),
        ("neighbours", MISSPELT, "Mine: AttributeError: .* has no attribute 'folowed'"),
        ("neighbours", rule(lambda theta, _: theta[:3]), r"Mine: returns shape \(3, 1\) for 11 thetas"),
        ("neighbours", rule(lambda theta, event: theta * event.weight, envelope=stays), "out of its `envelope`"),
        ("neighbours", "folowed", r"'folowed'; did you mean 'followed'\?$"),
    ],
)
def test_an_impossible_rule_is_refused_where_it_is_given(of: str, given: Any, said: str) -> None:
    error = ValueError if given == "folowed" else UserCodeError
    if of == "neighbours":
        with pytest.raises(error, match=f"^rule: .*{said}"):
            Neighbours(rule=given)
        return
    with pytest.raises(error, match=f"^trust: .*{said}"):
        Setting(trust=given)
    with pytest.raises(error, match=r"^believed_trust: "):
        Setting(believed_trust=given)
    with pytest.raises(error, match=said):
        fit_influence([], given)


def test_rules_are_compared_as_they_are_given(log: Path) -> None:
    """By name, as objects, as families, in a mapping or a list; what was given is not shown as estimated."""
    seen = replayed(TINY, log)
    in_a_list = compare_rules(seen, rules=["constant", Disappointed()], folds=2)
    named = {"constant": "constant", "mine": Disappointed(), "again": RuleFamily.of(Disappointed())}
    in_a_mapping = compare_rules(seen, rules=named, folds=2)
    assert [one.model for one in in_a_list.scores] == ["constant", "Disappointed"]
    nats = [score.nats_per_choice for score in in_a_mapping.scores]
    assert [one.model for one in in_a_mapping.scores] == list(named)
    assert nats[1] == nats[2] == in_a_list["Disappointed"].nats_per_choice
    paired = compare_rules(seen, rules=["paper", "outcome"], folds=2).scores
    assert [one.difference is None for one in paired] == [True, False]
    assert "step 0.3 (given)" in repr(fit_influence(seen, Disappointed()))
    assert re.search(r"eta [\d.e?-]+, utility_scale 1 \(given\)", repr(fit_influence(seen, "paper")))


def test_a_rule_of_what_neighbours_see_is_taken_unchanged_in_estimates() -> None:
    given, rows = with_neighbours(Contagion(), knowledge="exact", gamma=0.8), list[Any]()
    pool = Pool.sample(TINY, 4, seed=0, setting=given)
    _ = simulate(pool, "attention-outlook", humans=3, episodes=3, seed=0, trace=rows)
    seen, method = replayed(TINY, rows), Method(neighbours=given.neighbours)
    fit = fit_influence(seen, "constant", method, carry=False)
    assert (fit.rule, fit.intervals, fit.parameters) == ("constant, neighbours Contagion", {}, {"rate": 0.3})
    compared = compare_rules(seen, method, beside="constant", folds=2, carry=False)
    assert [one.model for one in compared.scores] == ["none", "outcome", "followed", "steps", "Contagion"]


@pytest.mark.cases
def test_what_is_no_setting_or_population_is_refused() -> None:
    tiny, no_setting = sweep(TINY), "a dict where a Setting was expected, such as Setting"
    wrong: Any
    for wrong in ({"c_suggest": 5.0}, {}):
        for more in ({}, {"robots": 2}):
            with pytest.raises(TypeError, match=no_setting):
                Assistant(tiny, ["ann"], setting=wrong, **more)
        for use in (
            lambda given: Assistant(tiny, ["ann"], population=given),
            lambda given: Pool.sample(tiny, 2, seed=0, population=given),
            lambda given: Pool.sample(tiny, 2, seed=0, population=Population(), prior=given),
        ):
            with pytest.raises(TypeError, match="a dict where a Population was expected"):
                use(wrong)
    with pytest.raises(TypeError, match="a float where Limits were expected, such as Limits"):
        cost_to_go(TINY, limits=5.0)  # type: ignore[arg-type]
