"""A rule of neighbours of the user's own, wherever a rule can be given, and what is said of one that is impossible."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import invoke
from test_own_trust_rules import OWN as OF_TRUST

import assist
from assist.certify import upper_bound
from assist.learning import Method, compare_rules, fit_influence, replayed
from assist.live import Assistant, Session
from assist.people import Neighbours, UserCodeError
from assist.person import Setting
from assist.studies import read
from assist.team import Pool, simulate
from planner import sweep
from planner.system.errors import InputFileError

TINY = "kitting/tiny"

OWN = """
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
class Contagion:
    """Theta comes nearer to what the neighbour did."""

    rate: float = 0.3

    def update(self, theta: Any, event: Any) -> Any:
        return theta + self.rate * event.weight * (np.where(event.followed, 1.0, 0.0) - theta)

    def envelope(self, theta: Any, _: Any, weight: float) -> Any:
        return theta * (1 - self.rate * weight), theta + self.rate * weight * (1 - theta)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (file := tmp_path / "rules.py").write_text(OWN)
    return file


def setting(rule: Any, **fields: Any) -> Setting:
    return Setting(c_suggest=0.01, gamma=0.8, neighbours=Neighbours(rule=rule), **fields)


def test_a_rule_in_a_file_is_the_same_as_the_object(own: Path) -> None:
    """It is simulated, bounded and checked."""
    pools = [
        Pool.sample(TINY, 3, seed=0, setting=setting(rule, trust="constant", c_move=0.0))
        for rule in (Contagion(), f"{own}:strongly", "none")
    ]
    episodes = [simulate(pool, "attention", humans=3, episodes=30, seed=0) for pool in pools]
    assert np.array_equal(episodes[0].discounted_return, episodes[1].discounted_return)
    assert not np.array_equal(episodes[0].discounted_return, episodes[2].discounted_return)
    bounds = [upper_bound(pool, (0, 1), gap=0.5, window=0).upper for pool in pools[:2]]
    assert bounds[0] == bounds[1]
    checked = assist.check(f"{own}:Contagion")
    assert (checked.kind, checked.faults, len(checked.trials)) == ("neighbours", (), 3)


def test_commands_take_a_rule_in_a_file(own: Path, tmp_path: Path) -> None:
    rule, log = f"{own}:strongly", tmp_path / "log.jsonl"
    one = ("--set", "trust=constant", "--set", "c_suggest=0", "--set", "c_move=0", "--set", f"neighbours.rule={rule}")
    done = invoke(
        "simulate", TINY, "--humans", 3, "--episodes", 4, *one, "--policy", "attention-outlook", "--trace", log
    )
    assert done.exit_code == 0, done.output
    (tmp_path / "own.toml").write_text('neighbours = { rule = "rules.py:strongly" }\n')
    assert invoke("simulate", TINY, "--humans", 2, "--episodes", 5, "--setting", tmp_path / "own.toml").exit_code == 0
    asked = ("--influence", "constant", "--set", "theta_per_episode=true", "--set", f"neighbours.rule={rule}")
    fitted = invoke("fit", TINY, log, *asked)
    assert (fitted.exit_code, f"trust rule constant, neighbours {rule};" in fitted.stdout) == (0, True), fitted.output
    document = json.loads(invoke("compare", "rules", TINY, log, "--folds", 2, *asked, "--json").stdout)
    assert [row["model"] for row in document["models"]][-1] == rule
    refused = invoke("simulate", TINY, "--humans", 2, "--set", f"neighbours.rule={own}:Misspelt")
    assert (refused.exit_code, "rules.py:19: AttributeError" in refused.stderr) == (2, True), refused.output
    assert invoke("check", f"{own}:Misspelt").stdout.count("\n") == 1


@pytest.mark.parametrize(
    ("code", "setting"),
    [(OWN, 'neighbours = { rule = "rules.py:strongly" }'), (OF_TRUST, 'trust = "rules.py:strongly"')],
    ids=["neighbours", "trust"],
)
def test_a_study_knows_when_the_file_of_a_rule_has_changed(code: str, setting: str, tmp_path: Path) -> None:
    (rules := tmp_path / "rules.py").write_text(code)
    (file := tmp_path / "study.toml").write_text(
        'title = "own"\nrepeats = 1\ninstances = ["kitting/tiny"]\nhumans = [2]\npool = 2\ndraws = 1\ntrials = 1\n'
        f'policies = ["none", "attention"]\n[[conditions]]\nname = "main"\nsettings = [{{ {setting} }}]\n'
    )
    study = read(file)
    before = study.fingerprint()
    rules.write_text(code.replace("0.3", "0.2"))
    assert study.fingerprint() != before


def test_a_saved_team_and_a_session_go_on_with_the_same_rule_only(own: Path, tmp_path: Path) -> None:
    """No file is run because a document names it."""
    tiny, given = sweep(TINY), setting(f"{own}:strongly")
    document = Assistant(tiny, ["ann", "ben"], setting=given).to_json()
    assert Assistant.from_json(document, tiny, setting=given).people == ("ann", "ben")
    with pytest.raises(ValueError, match=r"neighbours.rule was .*rules.py:strongly, a rule of your own"):
        Assistant.from_json(document, tiny)
    with pytest.raises(ValueError, match="another than that of the saved team"):
        Assistant.from_json(document, tiny, setting=setting(f"{own}:Contagion"))

    @dataclass(frozen=True)
    class Other(Contagion):
        def update(self, theta: Any, event: Any) -> Any:
            return super().update(theta, event) * 0.9

        def envelope(self, theta: Any, _: Any, weight: float) -> Any:
            return theta * 0.9 * (1 - self.rate * weight), np.ones_like(theta)

    Other.__qualname__ = "Contagion"
    Session(tiny, tmp_path / "session.sqlite", setting=setting(Contagion())).close()
    with pytest.raises(InputFileError, match=r"the rule of neighbours\.rule leads theta elsewhere"):
        Session(tiny, tmp_path / "session.sqlite", setting=setting(Other()))


def rule(update: Any, **attributes: Any) -> Any:
    return type("Mine", (), {"update": lambda _, theta, event: update(theta, event)} | attributes)()


def stays(_: Any, theta: Any, *_of_event: Any) -> Any:
    return theta, theta


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (Contagion, "Contagion is a class; expected its object, such as Contagion()"),
        (rule(lambda theta, _: theta + 10), r"Mine: leads to theta 10; expected a number from 0 to 1"),
        (rule(lambda theta, event: theta * event.folowed), "Mine: AttributeError: .* has no attribute 'folowed'"),
        (rule(lambda theta, _: theta[:3]), r"Mine: returns shape \(3, 1\) for 11 thetas"),
        (rule(lambda theta, event: theta * event.weight, envelope=stays), "Mine: moves theta out of its `envelope`"),
        ("folowed", r"'folowed'; did you mean 'followed'\?$"),
    ],
)
def test_an_impossible_rule_is_refused_where_it_is_given(given: Any, said: str) -> None:
    with pytest.raises(ValueError, match=f"^rule: {said}") as told:
        Neighbours(rule=given)
    assert isinstance(told.value, UserCodeError) == (given != "folowed")


def test_a_rule_of_ones_own_is_taken_unchanged_in_estimates() -> None:
    given, log = setting(Contagion(), trust="constant", knowledge="exact", c_move=0.0), list[Any]()
    pool = Pool.sample(TINY, 4, seed=0, setting=given)
    _ = simulate(pool, "attention-outlook", humans=3, episodes=3, seed=0, trace=log)
    seen, method = replayed(TINY, log), Method(neighbours=given.neighbours)
    fit = fit_influence(seen, "constant", method, carry=False)
    assert (fit.rule, fit.intervals, fit.parameters) == ("constant, neighbours Contagion", {}, {"rate": 0.3})
    compared = compare_rules(seen, method, beside="constant", folds=2, carry=False)
    assert [one.model for one in compared.scores] == ["none", "outcome", "followed", "steps", "Contagion"]
