"""A live session without a service, and broken ones: journals that are truncated, changed, or of another task."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from broken import Fuzzer

ARGUMENTS = [
    "problem.pddl", "--humans", "2", "--simulate", "1", "--port", "0", "--c-suggest", "0.05", "--data", "session",
]  # fmt: skip
JOURNAL = Path("session") / "journal.jsonl"
STEPS = 6


def work(plan: Any, session: Any, listening: Any, ready: Callable[..., None]) -> None:
    """Replace `assist.web.server.serve`: each person acts a few times, pages are drawn, and the session ends."""
    from assist.live.course import Event
    from assist.web.task_drawings import Pictures
    from assist.web.tokens import AccessTokens

    try:
        access, pictures, people = AccessTokens.kept(plan.folder / "secret", "http://here"), Pictures(), session.people
        ready(access, people)
        simulated = plan.seats().people
        for number in range(STEPS):
            name = people[number % min(4, len(people))]
            seen = session.person(name)
            task, state = session.place(name)
            if seen["finished"] or not seen["applicable"]:
                continue
            pictures.of(task, state, seen["applicable"], 400)
            action = seen["applicable"][0]
            if name in simulated:
                action = simulated[name].act(task, state, seen["applicable"], seen["suggestion"])
            (outcome,) = session.report([Event("acted", name, action)])
            if isinstance(outcome, Exception):
                raise outcome
        session.report([Event("left", people[0]), Event("joined", people[0]), Event("began", people[-1])])
        json.dumps([session.entry(name) for name in session.people])
    finally:
        listening.close()
        session.close()


def spoil(fuzzer: Fuzzer, folder: Path) -> None:
    """Break a journal, or another file of its folder."""
    file = folder / JOURNAL
    chance = fuzzer.rng.random()
    if chance < 0.1:
        fuzzer._spoil_file(folder / "session" / "secret")
    elif chance < 0.2:
        domain = Path(__file__).parent.parent / "domains" / "delivery"
        shutil.copy(domain / "domain.pddl", folder)
        shutil.copy(domain / "one-parcel.pddl", folder / "problem.pddl")
    elif chance < 0.5:
        fuzzer._spoil_file(file)
    elif chance < 0.6:
        content = file.read_bytes()
        file.write_bytes(content[: int(fuzzer.rng.integers(len(content)))])
    else:
        records = [json.loads(line) for line in file.read_text().splitlines()]
        number = int(fuzzer.rng.integers(len(records))) if fuzzer.rng.random() < 0.7 else 0
        fuzzer._spoil_value(records[number])
        file.write_text("".join(json.dumps(record) + "\n" for record in records), errors="surrogatepass")


def wrong(before: bytes, folder: Path, code: Any) -> list[str]:
    """Return what is wrong with a journal afterwards. A refused one must be unchanged, except for an incomplete last
    line.
    """
    file = folder / JOURNAL
    after = file.read_bytes() if file.is_file() else b""
    whole = before[: before.rfind(b"\n") + 1]
    if code != 0 and after not in (before, whole):
        return ["a journal that was refused has changed"]
    if code == 0 and whole and not after.startswith(whole):
        return ["what had happened is no longer in the journal"]
    return []
