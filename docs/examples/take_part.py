"""Takes part in a user study over HTTP, as a page does: python take_part.py LINK, with the study's join link.

The signed link of a participant is taken, too.
Without a suggestion it acts at random, which may take thousands of steps: give the study `minutes`.
"""

import random
import sys
from typing import Any

from assist.declare import Refusal
from assist.web.client import Client


def answer(item: dict[str, Any]) -> Any:
    """Return some answer to a question."""
    if item["form"] == "text":
        return "None."
    if item["form"] == "choices":
        return item["options"][:1]
    return item["options"][0] if item["form"] == "choice" else int(item["min"])


def take_part(link: str, visitor: str) -> dict[str, Any]:
    """Go through a study without groups, and return the last view."""
    door = Client(link)
    seat = door.ask("POST", "/api/study/seats", door.visit or {"id": visitor})
    page, path = Client(door.url + seat["part"]), f"/api/study/participants/{seat['person']}/onward"
    form = page.ask("GET", "/api/study/form")
    while True:
        seen = page.see()
        at = seen["study"]
        if at["kind"] in ("thanks", "gone", "withdrew", "declined", "full"):
            return seen
        if at["kind"] in ("practice", "task") and not at["over"]:
            action = seen["suggestion"] or random.choice(seen["applicable"])
            page.observe(seat["person"], action, seq=seen["seq"])
            continue
        answers = None
        if at["kind"] == "questionnaire":
            items = form["questionnaires"][at["what"]]["items"]
            answers = {name: answer(items[name]) for name in at["items"]}
        page.ask("POST", path, {"stage": at["stage"], "answers": answers})


if __name__ == "__main__":
    try:
        last = take_part(sys.argv[1], f"visitor {random.random()}")["study"]
    except Refusal as error:  # the study is full, or the link is wrong
        sys.exit(str(error))
    print(last.get("completion") or f"not completed: {last['kind']}")
