"""Metrics of a running service in the format of Prometheus. None names a person."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from fastapi import APIRouter, Response
from prometheus_client import generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

from .authorization import Desk, Operator, refusals
from .service import Service

router = APIRouter()
MEDIA = "text/plain; version=0.0.4; charset=utf-8"
ANSWER: dict[int | str, dict[str, Any]] = {200: {"content": {"text/plain": {"schema": {"type": "string"}}}}}


@router.get("/metrics", tags=["team"], response_class=Response, responses=refusals(403) | ANSWER)
async def metrics(_: Operator, service: Desk) -> Response:
    """Return the service's metrics, as Prometheus reads them."""
    return Response(await asyncio.to_thread(generate_latest, service.measures.registry), media_type=MEDIA)


class Present:
    """The metrics of a session's present state, which are computed when they are asked for.

    Parameters
    ----------
    service : Service
    """

    def __init__(self, service: Service) -> None:
        self._service = service

    def describe(self) -> list[Any]:
        """Return nothing: what there is follows from the state."""
        return []

    def collect(self) -> Iterator[Any]:
        """Yield the metrics."""
        service, outlook = self._service, self._service.outlook
        yield CounterMetricFamily("kitassist_events", "Events since the session began.", value=outlook.seq)
        fault, ready = outlook.fault is not None, not service.unready()
        for name, said, value in (
            ("people", "People in the team.", len(service.views)),
            ("paused", "1 if suggestions are paused.", outlook.paused),
            ("policy_fault", "1 if the policy failed at the last event.", fault),
            ("ready", "1 if the service is ready, as /api/health says.", ready),
        ):
            yield GaugeMetricFamily(f"kitassist_{name}", said, value=int(value))
        spread = GaugeMetricFamily("kitassist_belief_entropy_nats", "Entropy of the beliefs in people.", labels=["of"])
        found = [entropy(belief) for belief in service.session.beliefs().values()]
        spread.add_metric(["mean"], float(np.mean(found)) if found else math.nan)
        spread.add_metric(["largest"], max(found, default=math.nan))
        bridge = CounterMetricFamily("kitassist_bridge", "What a bridge has counted.", labels=["bridge", "what"])
        linked = GaugeMetricFamily("kitassist_bridge_connected", "1 if a bridge is connected.", labels=["bridge"])
        for name, one in service.bridges.items():
            linked.add_metric([name], int(one.connected))
            for what, count in sorted(one.counts.items()):
                bridge.add_metric([name, what], count)
        yield from (spread, bridge, linked)


def entropy(belief: bytes) -> float:
    """Return the entropy of a belief, in nats."""
    p = np.frombuffer(belief)
    p = p[p > 0]
    return float(-(p * np.log(p)).sum())
