"""Metrics of a running service in the format of Prometheus (extra `metrics`).

Metrics are built when they are asked for, from the service's counts and the state of the session. None names a person.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from fastapi import APIRouter, HTTPException, Response

from planner.system.errors import MissingExtraError

from .authorization import Desk, Operator, refusals
from .service import Service

router = APIRouter()
MEDIA = "text/plain; version=0.0.4; charset=utf-8"
ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"content": {"text/plain": {"schema": {"type": "string"}}}},
    501: {"description": "The extra `metrics` is not installed."},
}


@router.get("/metrics", tags=["team"], response_class=Response, responses=refusals(403) | ANSWERS)
async def metrics(_: Operator, service: Desk) -> Response:
    """Return the service's metrics, as Prometheus reads them; 501 without the extra `metrics`."""
    try:
        return Response(await asyncio.to_thread(exposition, service), media_type=MEDIA)
    except MissingExtraError as error:
        raise HTTPException(501, str(error)) from None


def exposition(service: Service) -> bytes:
    """Return the metrics of a service as text.

    Raises
    ------
    MissingExtraError
        The extra `metrics` is not installed.
    """
    try:
        from prometheus_client import CollectorRegistry, generate_latest
    except ImportError:
        raise MissingExtraError("metrics need", "prometheus_client", "metrics") from None
    registry = CollectorRegistry()
    registry.register(_Collector(service))
    return bytes(generate_latest(registry))


class _Collector:
    """Builds all metrics when they are asked for."""

    def __init__(self, service: Service) -> None:
        self._service = service

    def collect(self) -> Iterator[Any]:
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily

        service, measures, outlook = self._service, self._service.measures, self._service.outlook
        yield CounterMetricFamily("kitassist_events", "Events since the session began.", value=outlook.events)
        yield GaugeMetricFamily("kitassist_people", "People in the team.", value=len(service.views))
        yield GaugeMetricFamily("kitassist_paused", "1 if suggestions are paused.", value=int(outlook.paused))
        fault = int(outlook.fault is not None)
        yield GaugeMetricFamily("kitassist_policy_fault", "1 if the policy failed at the last event.", value=fault)
        reports = CounterMetricFamily("kitassist_reports", "Answered reports.", labels=["kind", "outcome"])
        for (kind, outcome), count in sorted(measures.reports.items()):
            reports.add_metric([kind, outcome], count)
        yield reports
        answered = CounterMetricFamily("kitassist_suggestions_answered", "Answers to suggestions.", labels=["followed"])
        for followed in ("no", "yes"):
            answered.add_metric([followed], measures.followed[followed])
        yield answered
        yield HistogramMetricFamily(
            "kitassist_report_seconds", "From the arrival of a report until it is saved.",
            buckets=measures.buckets(), sum_value=measures.seconds,
        )  # fmt: skip
        spread = GaugeMetricFamily("kitassist_belief_entropy_nats", "Entropy of the beliefs in people.", labels=["of"])
        found = [entropy(belief) for belief in service.session.beliefs().values()]
        spread.add_metric(["mean"], float(np.mean(found)) if found else math.nan)
        spread.add_metric(["largest"], max(found, default=math.nan))
        yield spread
        bridge = CounterMetricFamily("kitassist_bridge", "What a bridge has counted.", labels=["bridge", "what"])
        linked = GaugeMetricFamily("kitassist_bridge_connected", "1 if a bridge is connected.", labels=["bridge"])
        for name, one in service.bridges.items():
            linked.add_metric([name], int(one.connected))
            for what, count in sorted(one.counts.items()):
                bridge.add_metric([name, what], count)
        yield bridge
        yield linked
        ready = int(not service.unready())
        yield GaugeMetricFamily("kitassist_ready", "1 if the service is ready, as /api/health says.", value=ready)


def entropy(belief: bytes) -> float:
    """Return the entropy of a belief, in nats."""
    p = np.frombuffer(belief)
    p = p[p > 0]
    return float(-(p * np.log(p)).sum())
