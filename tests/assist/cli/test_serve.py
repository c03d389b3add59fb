"""The command `serve` with probable goals, as a user starts it."""

from __future__ import annotations

import time

import pytest
from conftest import ROOT, invoke
from serving import served

KITS = ROOT / "docs" / "examples" / "kits"


@pytest.mark.slow
def test_the_goals_of_people_are_inferred() -> None:
    given = ("--goals", KITS, "--set", "goal_prior=travel=.5,mend=.3,mount=.2", "--humans", 2, "--set", "c_ask=0.01")
    noise = ("--set", "observation.miss=0.02", "--set", "observation.confusion=0.05", "--c-move", 0)
    with served(*given, *noise, "--simulate", 1, "--set", "pace=0.01", instance=KITS / "travel.pddl") as service:
        view = "/api/people/person-1"
        assert service.ask("GET", f"{view}/drawing", "person-1").json()["goal"] == []
        entry = service.ask("GET", "/api/team").json()["people"][0]
        assert entry["goals"] == pytest.approx({"travel": 0.5, "mend": 0.3, "mount": 0.2})
        for action in ("(fetch box-c)", "(place tape slot-2 box-c)"):
            service.ask("POST", f"{view}/actions", "person-1", json={"action": action})
        for _ in range(600):  # until the simulated person has acted, however busy the machine is
            team = service.ask("GET", "/api/team").json()
            if team["people"][1]["steps"]:
                break
            time.sleep(0.1)
        assert team["people"][0]["goals"]["travel"] > 0.8
        assert team["people"][1]["steps"] > 0
        seen = service.ask("GET", view, "person-1").json()
        assert "goals" not in seen
        for wrong in ({}, {"missed": 2}, {"likelihoods": {"(fetch box-c)": -1}}):
            assert service.ask("POST", f"{view}/actions", "person-1", json=wrong).status_code == 422
        known = dict.fromkeys(seen["applicable"], 1.0)
        seen = service.ask("POST", f"{view}/actions", "person-1", json={"likelihoods": known}).json()
        assert seen["steps"] == 3
        if "question" in seen:
            for nothing in ({}, {"seq": seen["seq"]}):  # which would have declined the question
                refused = service.ask("POST", f"{view}/answer", "person-1", json=nothing)
                assert (refused.status_code, "answer: is missing" in refused.json()["detail"]) == (422, True)
            said = {"answer": None, "seq": seen["seq"]}
            assert "question" not in service.ask("POST", f"{view}/answer", "person-1", json=said).json()
        refused = service.ask("POST", f"{view}/answer", "person-1", json={"answer": True})
        assert (refused.status_code, refused.json()["detail"]) == (409, "person-1 has no open question")
    result = invoke("serve", KITS / "travel.pddl", KITS / "mend.pddl", "--goals", KITS, "--humans", 1)
    assert (result.exit_code, "expected one INSTANCE, which has the first goal" in result.stderr) == (2, True)
