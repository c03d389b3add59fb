"""The command `serve`, as a user starts it: links, actions, shutdown and resuming."""

from __future__ import annotations

import json
import signal
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import pytest
from conftest import ROOT, invoke
from serving import served

from assist import fit, read_log
from planner import Table

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


def test_people_act_the_service_ends_and_goes_on_where_it_was(tmp_path: Path, tiny: Table) -> None:
    options = ("--humans", 2, "--data", tmp_path, "--c-suggest", 0.1)
    with served(*options) as service, ExitStack() as held:
        assert list(service.links) == ["person-1", "person-2"]
        seen = service.ask("GET", "/api/people/person-1", "person-1").json()
        assert seen["applicable"] == ["(fetch box-a)", "(fetch box-b)"]
        assert (seen["cost_to_go"], seen["steps"], seen["finished"]) == (6.0, 0, False)
        first = service.ask(
            "POST", "/api/people/person-1/actions", "person-1", json={"action": "(fetch box-a)", "id": "1"}
        )
        assert (first.status_code, first.json()["steps"], first.json()["cost_to_go"]) == (200, 1, 5.0)
        team = service.ask("GET", "/api/team").json()
        links = service.links, service.operator
        streams = []
        for path in ("/api/people/person-1/events", "/api/team/events", "/api/team/changes"):
            request = urllib.request.Request(service.url + path, headers={"Authorization": f"Bearer {service.token()}"})
            streams.append(held.enter_context(urllib.request.urlopen(request, timeout=60)))
            assert streams[-1].readline() == b"event: ping\n"
        code, said = service.end(signal.SIGTERM)
        assert code == 0
        began = [line.split(" in ")[0].split(";")[0] for line in said.splitlines()]
        assert began == ["preparing the session", "the session is saved"]  # and no task that was cancelled
        for stream in streams:
            assert stream.read().endswith(b"\n\n")  # complete events, and then an orderly end
        tokens = [link.partition("#")[2] for link in (*service.links.values(), service.operator)]
        assert not any(token in said for token in tokens)
    with served(*options) as service:
        assert [link.rpartition("/")[2] for link in (*service.links.values(), service.operator)] == [
            link.rpartition("/")[2] for link in (*links[0].values(), links[1])
        ]
        again = service.ask(
            "POST", "/api/people/person-1/actions", "person-1", json={"action": "(fetch box-a)", "id": "1"}
        )
        assert again.json() == first.json()
        after = service.ask("GET", "/api/team").json()
        assert [person["belief"] for person in after["people"]] == [person["belief"] for person in team["people"]]
        assert after["people"][0]["steps"] == 1
        log = service.ask("GET", "/api/log").text
        assert service.end(signal.SIGINT)[0] == 0  # Ctrl-C
    (tmp_path / "log.jsonl").write_text(log)
    assert [json.loads(line)["action"] for line in log.splitlines()] == ["(fetch box-a)"]
    assert fit(tiny, read_log(str(tmp_path / "log.jsonl")))["person-1"].actions == 1
