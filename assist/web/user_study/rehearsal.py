"""A rehearsal of a user study: simulated participants take all places, over the same interface as real ones.

They come by the join link, follow their page's connection, act as the model says (eqs. 5 to 7), and answer the
questionnaires. Their answers are made up, so that there is something to be analysed: a task weighs on them by how many
steps they lost, and they trust by how willing they are to follow. Others come and leave before their task begins, so
that places become free again.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from planner import CostToGo

from ...live.simulated_person import SimulatedPerson
from ...userstudy.questionnaires import STEP, Questionnaire
from ..client import Client
from .service import StudyService

AT_ONCE = 8
"""Participants who are there at the same time."""

LEAVING = 8
"""For each so many participants another one leaves before the task."""


class SimulatedParticipant:
    """Somebody who takes part in a rehearsal.

    Parameters
    ----------
    service : StudyService
        Of which only tokens and the study's file are looked at.
    tasks : mapping of str to CostToGo
    number : int
        From which, with the study's seed, they are drawn.
    leaves : str or None
        The stage at which they leave.
    lock : lock
        That of the session, since tasks that are asked on demand are one thread's at a time.
    base : str
        Where the service listens.
    """

    def __init__(
        self, service: StudyService, tasks: Mapping[str, CostToGo], number: int, leaves: str | None, lock: Any,
        base: str,
    ) -> None:  # fmt: skip
        study = service.study
        self.study, self._tasks, self._leaves, self._lock = study, tasks, leaves, lock
        seed = int(np.random.SeedSequence([study.seed, 1, number]).generate_state(1, np.uint64)[0])
        setting = study.setting
        self._person = SimulatedPerson(
            study.population, eta=setting.eta, utility_scale=setting.utility_scale, seed=seed
        )
        self._rng = np.random.default_rng([seed, 2])
        self._lost = 0.0
        visitor = Client(f"{base}/operator/{service.join_url().rpartition('/')[2]}")
        seat = visitor.ask("POST", "/api/study/seats", {"id": uuid.uuid4().hex, "simulated": True})
        self._name = seat["person"]
        self._client = Client(base + seat["part"].replace("/part/", "/join/", 1))

    def take_part(self) -> None:
        """Go through the whole study."""
        watched = self._client.watch()
        seen = next(watched)
        while seen["study"]["kind"] not in ("thanks", "withdrew", "declined"):
            answer = self._step(seen)
            while seen["seq"] < answer["seq"]:  # what the page is told, as a page waits for it
                seen = next(watched)
        watched.close()  # type: ignore[attr-defined]

    def _step(self, seen: dict[str, Any]) -> dict[str, Any]:
        at, path = seen["study"], f"/api/study/participants/{self._name}"
        once = {"id": uuid.uuid4().hex}
        if at["stage"] == self._leaves:
            answer: dict[str, Any] = self._client.ask("POST", f"{path}/withdraw", once)
            return answer
        if at["kind"] in ("practice", "task"):
            if not at["over"]:
                return self._act(seen)
            if at["kind"] == "task":
                self._lost = max(0.0, seen["steps"] - self._shortest(seen["task"]))
        answers = None
        if at["kind"] == "questionnaire":
            answers = self._answers(self.study.questionnaire(at["what"]))
        onward: dict[str, Any] = self._client.ask(
            "POST", f"{path}/onward", {**once, "stage": at["stage"], "answers": answers}
        )
        return onward

    def _shortest(self, task: str) -> float:
        with self._lock:
            return float(self._tasks[task].lookup([self._tasks[task].initial])[0])

    def _act(self, seen: dict[str, Any]) -> dict[str, Any]:
        task = self._tasks[seen["task"]]
        if seen["steps"] == 0:
            self._state = task.initial
        with self._lock:
            action = self._person.act(task, self._state, seen["applicable"], seen["suggestion"])
            rows = task.choices([self._state])
            names = [task.task.actions[number] for number in rows.actions]
            if action in names:
                self._state = int(rows.targets[names.index(action)])
        return self._client.act(action, seq=seen["seq"])

    def _answers(self, questionnaire: Questionnaire) -> dict[str, int | str]:
        answers: dict[str, int | str] = {}
        for item in questionnaire.items:
            if questionnaire.form == "text":
                answers[item.name] = "Made up: a simulated participant's words."
            elif questionnaire.form == "nasa-tlx":
                load = 25 + 4 * self._lost + self._rng.normal(0, 12)
                answers[item.name] = STEP * int(np.clip(round(load / STEP), 0, 100 // STEP))
            else:
                trust = 1 + (questionnaire.points - 1) * (self._person.theta + self._rng.normal(0, 0.12))
                answer = int(np.clip(round(trust), 1, questionnaire.points))
                answers[item.name] = questionnaire.points + 1 - answer if item.reversed else answer
        return answers


def rehearse(service: StudyService, tasks: Mapping[str, CostToGo], participants: int, base: str) -> None:
    """Let simulated participants take part until all have done.

    Parameters
    ----------
    service : StudyService
        Which runs.
    tasks : mapping of str to CostToGo
    participants : int
        Who stay to the end.
    base : str
        Where the service listens, whatever others call it.
    """
    lock: threading.RLock = service.session.lock
    early = [stage.name for stage in service.study.stages if stage.kind in ("consent", "instructions", "practice")]
    leaving: list[str | None] = [early[number % len(early)] for number in range(participants // LEAVING)]
    order: list[str | None] = [None] * participants
    for number, stage in enumerate(leaving):
        order.insert(number * LEAVING + LEAVING // 2, stage)

    places = threading.Semaphore(service.study.participants or len(order))

    def part(number: int) -> None:
        # Who stays waits for the place of somebody who leaves, if all are taken; who would leave is turned away.
        stays = order[number] is None
        if places.acquire(blocking=stays):
            try:
                SimulatedParticipant(service, tasks, number, order[number], lock, base).take_part()
            finally:
                if not stays:
                    places.release()

    with ThreadPoolExecutor(AT_ONCE) as threads:
        list(threads.map(part, range(len(order))))
