"""The header of a saved session: its tasks and settings, with which alone its events can be applied again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from planner import CostToGo
from planner.system.errors import InputFileError

from ..declare.declared import AnyTable, AnyText, Number, View, Whole, declared, plain
from ..people.belief import Grid
from ..people.choice_model import chances
from ..people.decision import perceived_cost
from ..people.given_rules import digest as digest_of_rule
from ..people.goals import Goals, first_of
from ..people.ranges import Population
from ..person.settings import Setting, own_rules
from ..person.truncated_task import TruncatedTask
from .desk import Desk
from .live_task import digest
from .record import TeamRecord


@declared(kw_only=True)
class Header(View):
    """What every saved session begins with. A session that is opened again has the same, but for version and files."""

    format: Annotated[AnyText, Field(description="Which records follow.")]
    version: Annotated[AnyText, Field(description="The version of kitassist that began it.")]
    tasks: Annotated[dict[str, AnyText], Field(description="A hash of each task, by its name.")]
    files: Annotated[dict[str, AnyText | None], Field(description="The problem file of each task, if it has one.")]

    @classmethod
    def of_tasks(cls, format: str, tasks: Mapping[str, CostToGo | Goals], **more: Any) -> Self:
        """Return the header of a session of tasks; `more` are the fields of the class beside these four."""
        digests = {name: digest(task) for name, task in tasks.items()}
        return cls(format=format, version=metadata.version("kitassist"), tasks=digests, files=_files_of(tasks), **more)


@declared(kw_only=True)
class TeamHeader(Header):
    """The header of a session of a team."""

    policy: Annotated[AnyText | None, Field(description="The name of the team's policy, if it has one.")]
    setting: Annotated[AnyTable, Field(description="The fields of `Setting`.")]
    population: Annotated[AnyTable, Field(description="The prior over people.")]
    distance: Annotated[list[list[Number]] | None, Field(description="The distances at first, if they were given.")]
    humans: Annotated[Whole | None, Field(description="How many people it is served for, if it is.")]
    chances: Annotated[
        dict[str, AnyText] | None,
        Field(description="If people choose by a function, a hash of its probabilities in each task."),
    ]
    moves: Annotated[
        dict[str, AnyText] | None, Field(description="A hash of where each trust rule of the user's own leads theta.")
    ] = None


def header_of(
    desk: Desk, tasks: Mapping[str, CostToGo | Goals], distance: ArrayLike | None, humans: int | None
) -> TeamHeader:
    """Return the header of a session of a team."""
    people, policy = desk.population, desk.policy
    return TeamHeader.of_tasks(
        TeamRecord.format, tasks,
        policy=policy if isinstance(policy, str) else getattr(policy, "name", None),
        setting=plain(Setting.of(desk.setting)), population=plain(people),
        distance=None if distance is None else np.asarray(distance, dtype=float).tolist(), humans=humans,
        chances=None if people.chooses is None else {name: _chances(task, people) for name, task in tasks.items()},
        moves={name: digest_of_rule(rule) for name, rule in own_rules(desk.setting).items()} or None,
    )  # fmt: skip


def _files_of(tasks: Mapping[str, CostToGo | Goals]) -> dict[str, str | None]:
    """Return the problem file of each task; None for that of a policy."""
    known = {name: getattr(getattr(first_of(task), "task", None), "instance", None) for name, task in tasks.items()}
    return {name: None if instance is None else str(instance.problem) for name, instance in known.items()}


def _chances(task: CostToGo | Goals, population: Population) -> str:
    """Return a hash of a function's choice probabilities in the likeliest states, which identify it better than a name.

    It does not depend on the numbers of states, which on demand are those of their first use.
    """
    region = TruncatedTask.of(task, states=20 if first_of(task).searches else 1_000, population=population)
    content, beta, order = sha256(), Grid.regular(population).beta, np.argsort(region.choices.keys)
    for choices in region.choices.of_each_goal:
        q = perceived_cost(choices, choices.h)
        content.update(chances(population.typical, choices, q, beta)[:, order].tobytes())
    return content.hexdigest()[:32]


def require_same(file: Path, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    """Check that the header of a saved session is the expected one.

    Raises
    ------
    InputFileError
        The file belongs to another session; the message states all differences.
    """
    found, expected = _without_folders(found), _without_folders(expected)
    differ = {n: v for n, v in expected.items() if n not in ("files", "version") and found.get(n) != v}
    if not differ:
        return
    said, tasks = list[str](), differ.get("tasks")
    before, now = found.get("moves"), differ.get("moves")
    if isinstance(before, Mapping) and isinstance(now, Mapping) and before.keys() == now.keys():
        others = ", ".join(name for name in now if now[name] != before[name])
        said.append(f"the rule of {others} leads theta elsewhere than when the session began, so its code has changed")
        del differ["moves"]
    if tasks is not None and isinstance(found.get("tasks"), dict):
        said.append(_others(found, differ.pop("tasks"), expected.get("files", {})))
    if differ:
        shown = (one for name, value in differ.items() for one in _shown(name, found.get(name), value))
        said.append(f"the session there has {'; '.join(shown)}")
    raise InputFileError(f"{file}: {'; '.join(said)}; expected the same, or another folder")


def _without_folders(value: Any) -> Any:
    """Return a header in which the user's code FILE.py:NAME has no folder: hashes tell whether it is the same."""
    if isinstance(value, Mapping):
        return {name: one if name == "files" else _without_folders(one) for name, one in value.items()}
    if isinstance(value, str) and ".py:" in value:
        return value.rpartition("/")[2]
    return value


def _others(header: Mapping[str, Any], tasks: dict[str, str], files: dict[str, str | None]) -> str:
    """Return a message that names the session's tasks and the expected ones."""
    before, kept = header["tasks"], header.get("files") or {}
    wrong = [name for name in tasks if before.get(name) != tasks[name]]
    same = [name for name in wrong if name in before and kept.get(name, files.get(name)) == files.get(name)]
    if same:
        return f"the file of the task {same[0]} is another than when the session began"

    def named(names: Iterable[str], where: Mapping[str, str | None]) -> str:
        return ", ".join(f"{name} ({where[name]})" if where.get(name) else name for name in names)

    return f"the session there is of the task {named(before, kept)}, not {named(tasks, files)}"


def _shown(name: str, found: Any, expected: Any) -> Iterator[str]:
    """Yield a short description of each part that differs."""
    if isinstance(found, Mapping) and isinstance(expected, Mapping):
        parts = [part for part in {**expected, **found} if found.get(part) != expected.get(part)]
        for part in parts:
            if part != "parts" or len(parts) == 1:  # the parts of a population follow from its ranges
                yield from _shown(f"{name} {part}", found.get(part), expected.get(part))
    else:
        yield f"{name} {str(found)[:60]}, not {str(expected)[:60]}"
