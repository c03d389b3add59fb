"""Rehearsal of a user study by simulated participants, who use the same interface as real ones.

They join by the join link, watch their page's connection, act by the model (equations 5 to 7), see what their
condition lets them see of others, and answer the questionnaires. Their answers are random but not independent of their
behaviour, so that an analysis has something to find: reported workload grows with the number of extra steps, and
reported trust with theta. Others leave before their task begins, so that their places become free again.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from planner import CostToGo
from planner.system.progress import Progress, adding

from ...declare.refusals import InapplicableError
from ...live.simulated_person import SimulatedPerson
from ...studies.userstudy.forms import Answer, Item, Rehearsed
from ...studies.userstudy.session import StudySession
from ..client import Client
from .service import StudyService

PATIENCE = 600.0
"""Seconds for which a request is repeated: on a busy machine a hundred participants wait for each other's reports."""


class SimulatedParticipant:
    """A simulated participant of a rehearsal.

    Parameters
    ----------
    service : StudyService
        Source of the tokens and the study's plan.
    tasks : mapping of str to CostToGo
    number : int
        Number of the participant; with the study's seed, it determines their parameters.
    leaves : str or None
        The stage at which the participant leaves; None: never.
    base : str
        Address at which the service listens.
    client : callable
        Returns the client of a link.
    """

    def __init__(
        self, service: StudyService, tasks: Mapping[str, CostToGo], number: int, leaves: str | None, base: str,
        client: Callable[[str], Client],
    ) -> None:  # fmt: skip
        study = service.study
        assert isinstance(service.session, StudySession)
        self.study, self._tasks, self._leaves, self._session = study, tasks, leaves, service.session
        seed = int(np.random.SeedSequence([study.seed, 1, number]).generate_state(1, np.uint64)[0])
        self._person, self._place = SimulatedPerson(study.population, seed=seed), ("", 0)
        self._rng = np.random.default_rng([seed, 2])
        self._lost = 0.0
        visitor = client(f"{base}/study#{service.join_url().partition('#')[2]}")
        seat = visitor.ask("POST", "/api/study/seats", {"id": uuid.uuid4().hex, "simulated": True})
        self._name = seat["person"]
        self._client = client(base + seat["part"])

    def take_part(self) -> None:
        """Take part in the whole study."""
        watched = self._client.watch()
        seen = next(watched)
        while seen["study"]["kind"] not in ("thanks", "withdrew", "declined", "unmatched"):
            if seen["study"]["kind"] == "waiting":
                seen = next(watched)
                continue
            answer = self._step(seen)
            while seen["seq"] < answer["seq"]:  # as a page does, wait for the view that follows the answer
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
                try:
                    return self._act(seen)
                except InapplicableError:
                    now = self._client.see()
                    if not now["study"]["over"]:
                        raise
                    return now  # the time was up meanwhile
            if at["kind"] == "task":
                self._lost = max(0.0, seen["steps"] - self._shortest(seen["task"]))
        answers = None
        if at["kind"] == "questionnaire":
            items = {item.name: item for item in self.study.questionnaire(at["what"]).items}
            answers = {name: self._answer(items[name]) for name in at["items"]}
        onward: dict[str, Any] = self._client.ask(
            "POST", f"{path}/onward", {**once, "stage": at["stage"], "answers": answers}
        )
        return onward

    def _shortest(self, task: str) -> float:
        with self._session.lock:
            return float(self._tasks[task].lookup([self._tasks[task].initial])[0])

    def _act(self, seen: dict[str, Any]) -> dict[str, Any]:
        task = self._tasks[seen["task"]]
        if seen["steps"] == 0:
            self._state = task.initial
        with self._session.lock:  # also since tasks solved on demand are not thread-safe
            self._look()
            action = self._person.act(task, self._state, seen["applicable"], seen["suggestion"])
            rows = task.choices([self._state])
            names = [task.task.actions[number] for number in rows.actions]
            if action in names:
                self._state = int(rows.targets[names.index(action)])
        return self._client.observe(self._name, action, seq=seen["seq"])

    def _look(self) -> None:
        """Let the participant hear what has happened to them; in another condition their team is another one."""
        cohort = self._session.cohort
        who = cohort.known(self._name)
        stage, team = cohort.stage(who), cohort.team_of(who).team
        if self._place != (stage.kind, stage.period):
            self._place = stage.kind, stage.period
            self._person.joins(team.desk.setting.rule_of_people())
        self._person.hear(team.news(self._name))

    def _answer(self, item: Item) -> Answer:
        """Return an answer: workload and trust as the module says, attention checks right, and others at random."""
        if item.correct is not None:
            return item.correct
        return item.kind.rehearsed(item, Rehearsed(self._rng, self._person.theta, self._lost))


class Rehearsal:
    """Simulated participants who take part until enough of them have completed the study.

    Parameters
    ----------
    participants : int
        Number of participants who complete the study.
    progress : callable
        Receives how many have, as in `planner.system.progress`.
    """

    per_leaver = 8
    """Number of participants for each further one who leaves before the task."""
    at_once = 8
    """Number of participants at the same time. More finish earlier, but slow the service."""

    def __init__(self, participants: int, progress: Progress = lambda *_: None) -> None:
        self.participants, self._progress = participants, progress
        self._clients: list[Client] = []
        self._ended = threading.Event()

    def run(self, service: StudyService, tasks: Mapping[str, CostToGo], base: str) -> None:
        """Let all take part.

        Parameters
        ----------
        service : StudyService
            A running service.
        tasks : mapping of str to CostToGo
        base : str
            Address at which the service listens, which may differ from its public address.
        """
        early = [stage.name for stage in service.study.stages if stage.kind in ("consent", "instructions", "practice")]
        leaving = [early[number % len(early)] for number in range(self.participants // self.per_leaver)]
        order: list[str | None] = [None] * self.participants
        for number, stage in enumerate(leaving):
            order.insert(number * self.per_leaver + self.per_leaver // 2, stage)

        places = threading.Semaphore(service.study.participants or len(order))
        advance = adding(self._progress, "simulated participants", self.participants)

        def part(number: int) -> None:
            # A stayer waits for the place of a leaver if the study is full. A leaver is then turned away.
            stays = order[number] is None
            if places.acquire(blocking=stays):
                try:
                    if not self._ended.is_set():
                        one = SimulatedParticipant(service, tasks, number, order[number], base, self._client)
                        one.take_part()
                        advance(stays)
                finally:
                    if not stays or self._ended.is_set():
                        places.release()

        group = service.study.group
        # The members of a group take part at the same time.
        with ThreadPoolExecutor(self.at_once if group is None else max(self.at_once, group.size)) as threads:
            list(threads.map(part, range(len(order))))

    def end(self) -> None:
        """Let nobody else come, and those who take part give up as soon as the service no longer answers."""
        self._ended.set()
        for one in self._clients:
            one.patience = 0.0

    def _client(self, link: str) -> Client:
        client = Client(link, patience=PATIENCE)
        self._clients.append(client)
        if self._ended.is_set():
            client.patience = 0.0
        return client
