"""Metrics of a service, read with Prometheus's own parser."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import kit
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from test_live_web import Web

from assist.web.measures import Measures
from assist.web.metrics import entropy


def values(text: str) -> dict[tuple[str, ...], float]:
    return {
        (sample.name, *sample.labels.values()): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_metrics_are_what_happened(tmp_path: Path) -> None:
    web = Web(kit("tiny"), tmp_path)
    with web.client:
        web.service.bridges["mqtt"] = SimpleNamespace(counts={"recorded": 3}, connected=True, waits=())  # type: ignore[assignment]
        first = web.ask("GET", "/api/people/ann", "ann").json()
        assert first["suggestion"] is not None
        web.act(first["suggestion"], id="1")
        web.act(first["suggestion"], id="1")
        web.act("(fetch box-z)")
        seen = web.ask("GET", "/api/people/ann", "ann").json()
        other = next(action for action in seen["applicable"] if action != seen["suggestion"])
        declined = seen["suggestion"] is not None
        web.act(other)
        answer = web.ask("GET", "/metrics?name[]=kitassist_people", None)  # as some scrapers ask
        assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
        found = values(answer.text)
        events = web.ask("GET", "/api/team", None).json()["seq"]
        beliefs = web.service.session.beliefs()
    assert found["kitassist_events_total",] == events
    assert found["kitassist_people",] == 2
    assert found["kitassist_reports_total", "acted", "recorded"] == 3
    assert found["kitassist_reports_total", "acted", "refused"] == 1
    assert found["kitassist_suggestions_answered_total", "yes"] == 1
    assert found["kitassist_suggestions_answered_total", "no"] == int(declined)
    assert found["kitassist_report_seconds_bucket", "+Inf"] == found["kitassist_report_seconds_count",] == 4
    assert found["kitassist_belief_entropy_nats", "largest"] == max(map(entropy, beliefs.values()))
    assert found["kitassist_bridge_total", "mqtt", "recorded"] == 3
    assert found["kitassist_bridge_connected", "mqtt"] == found["kitassist_ready",] == 1
    assert "ann" not in answer.text


def test_an_action_on_an_older_view_answers_no_suggestion(tmp_path: Path) -> None:
    """The counts are those of the actions that have a suggestion in the log."""
    web = Web(kit("tiny"), tmp_path)
    with web.client:
        answered = [0]
        for late in (1, 0, 1, 0):
            seen = web.ask("GET", "/api/people/ann", "ann").json()
            assert seen["suggestion"] is not None
            other = next(action for action in seen["applicable"] if action != seen["suggestion"])
            assert web.act(other, seq=seen["seq"] - late).status_code == 200
            found = values(web.ask("GET", "/metrics", None).text)
            answered.append(int(found["kitassist_suggestions_answered_total", "no"]))
            assert found["kitassist_suggestions_answered_total", "yes"] == 0
            assert answered[-1] == sum(row["suggestion"] is not None for row in web.service.session.log())
    assert answered == [0, 0, 1, 1, 2]


def test_entropy_and_buckets() -> None:
    assert entropy(np.full(8, 1 / 8).tobytes()) == pytest.approx(math.log(8))
    assert entropy(np.array([1.0, 0.0]).tobytes()) == 0
    measures = Measures()
    for seconds in (0.002, 0.003, 60.0):
        measures.add("acted", "recorded", seconds)
    found = values(generate_latest(measures.registry).decode())
    assert [found["kitassist_report_seconds_bucket", limit] for limit in ("0.002", "5.0", "+Inf")] == [1, 2, 3]
