"""Reading studies from TOML files. `docs/study.md` describes the form; every fault is named with file and place."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from planner import Instance, InstanceError, find_instances

from ..learning import population as populations
from ..people.human import Mixture, Population
from ..team.policies import POLICIES, parse
from ..team.settings import Setting
from .study import OWN, Condition, Contrast, Reference, Study, StudyError

PROTOCOLS = Path(__file__).parent / "protocols"
COMMON = ("instances", "policies", "humans")
"""What each condition takes from the study, unless it says otherwise."""


def shipped() -> list[str]:
    """Name the studies that come with the package."""
    return sorted(path.stem for path in PROTOCOLS.glob("*.toml"))


def read(study: str | Path, *, repeats: int | None = None) -> Study:
    """Read a study: its file, or the name of one that comes with the package.

    Parameters
    ----------
    study : str or Path
        Files that the study names are sought beside it.
    repeats : int, optional
        Replaces the study's own number.

    Raises
    ------
    StudyError
        What is wrong, where, and what would be right.
    """
    file = Path(study)
    if file.suffix != ".toml":
        if str(study) not in shipped():
            raise StudyError(f"no protocol '{study}'; expected {', '.join(shipped())} or a file that ends in .toml")
        file = PROTOCOLS / f"{study}.toml"
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StudyError(f"{file}: no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{file}: {error}") from None
    found = _study(file, _Table(file, "", content))
    return found if repeats is None else replace(found, repeats=repeats)


class _Table:
    """A table of the file, from which values are taken one by one; what is left at the end is a mistake."""

    def __init__(self, file: Path, place: str, content: dict[str, Any]) -> None:
        self.file, self.place, self.content = file, place, dict(content)
        self.known: list[str] = []

    def fault(self, key: str, message: str) -> StudyError:
        return StudyError(f"{self.file}: {f'{self.place}.{key}'.strip('.')}: {message}")

    def gives(self, key: str) -> bool:
        self.known.append(key)
        return key in self.content

    def take(self, key: str, default: Any = None) -> Any:
        self.known.append(key)
        return self.content.pop(key, default)

    def text(self, key: str, default: str | None = None) -> str:
        value = self.take(key, default)
        if not isinstance(value, str) or not value:
            raise self.fault(key, f"{_shown(value)}; expected a text")
        return value

    def whole(self, key: str, default: int | None = None, least: int = 1) -> int:
        value = self.take(key, default)
        if not _is_whole(value) or value < least:
            raise self.fault(key, f"{_shown(value)}; expected a whole number of {least} or more")
        return value

    def number(self, key: str) -> float:
        value = self.take(key)
        if not _is_number(value):
            raise self.fault(key, f"{_shown(value)}; expected a number")
        return float(value)

    def texts(self, key: str, default: tuple[str, ...] | None = None) -> tuple[str, ...]:
        value = self.take(key, default)
        if not isinstance(value, list | tuple) or not value or not all(isinstance(v, str) and v for v in value):
            raise self.fault(key, f"{_shown(value)}; expected a list of texts")
        return tuple(dict.fromkeys(value))

    def wholes(self, key: str, default: tuple[int, ...] | None = None) -> tuple[int, ...]:
        value = self.take(key, default)
        if not isinstance(value, list | tuple) or not value or not all(_is_whole(v) and v > 0 for v in value):
            raise self.fault(key, f"{_shown(value)}; expected a list of whole numbers of 1 or more")
        return tuple(sorted(set(value)))

    def pair(self, key: str, default: tuple[float, float]) -> tuple[float, float]:
        value = self.take(key, default)
        if not isinstance(value, list | tuple) or len(value) != 2 or not all(_is_number(v) for v in value):
            raise self.fault(key, f"{_shown(value)}; expected two numbers, [low, high]")
        return float(value[0]), float(value[1])

    def table(self, key: str) -> _Table:
        value = self.take(key, {})
        if not isinstance(value, dict):
            raise self.fault(key, f"{_shown(value)}; expected a table")
        return _Table(self.file, f"{self.place}.{key}".strip("."), value)

    def tables(self, key: str, default: list[dict[str, Any]] | None = None) -> list[_Table]:
        value = self.take(key, default)
        if not isinstance(value, list) or not value or not all(isinstance(v, dict) for v in value):
            raise self.fault(key, f"{_shown(value)}; expected one table or more")
        name = f"{self.place}.{key}".strip(".")
        return [_Table(self.file, f"{name}[{number}]", v) for number, v in enumerate(value, start=1)]

    def done(self) -> None:
        """Refuse what nobody has asked for."""
        for key in self.content:
            raise self.fault(key, f"unknown; expected one of {', '.join(sorted(set(self.known)))}")


def _shown(value: Any) -> str:
    return "is missing" if value is None else json.dumps(value, default=str)


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _study(file: Path, top: _Table) -> Study:
    title, seed, repeats = top.text("title", file.stem), top.whole("seed", 0, least=0), top.whole("repeats", 50)
    pool, draws, trials = top.whole("pool", 12), top.whole("draws", 6), top.whole("trials", 5)
    instances = _instances(file, top)
    populations = {t.place.partition(".")[2]: _population(t) for t in _each(top.table("populations"))}
    populations = populations or {"everybody": Population()}
    policies, own = _policies(file, top, "policies", ("none", "reactive", "attention"))
    humans = top.wholes("humans", (1, 2, 3, 4, 5, 6))
    setting = _setting(top.table("setting"), Setting())
    names = tuple(label for label, _ in instances)
    conditions: list[Condition] = []
    for table in top.tables("conditions", [{"name": "team size"}]):
        chosen, more = _policies(file, table, "policies", policies) if table.gives("policies") else (policies, {})
        own.update(more)
        condition = Condition(
            name=table.text("name"),
            populations=_among(table, "populations", tuple(populations)[:1], tuple(populations)),
            instances=_among(table, "instances", names, names),
            policies=chosen,
            humans=table.wholes("humans", humans),
            settings=_settings(table, setting),
            priors=_among(table, "priors", (OWN,), (OWN, *populations)),
            repeats=table.whole("repeats") if table.gives("repeats") else None,
        )
        table.done()
        if condition.name in {other.name for other in conditions}:
            raise table.fault("name", f"there are two conditions '{condition.name}'; expected different names")
        if max(condition.humans) > pool:
            raise table.fault("humans", f"{max(condition.humans)} people in a team, and {pool} in a pool")
        conditions.append(condition)
    focus = top.text("focus", "attention" if "attention" in conditions[0].policies else conditions[0].policies[-1])
    if focus not in conditions[0].policies:
        raise top.fault("focus", f"'{focus}'; expected one of {', '.join(conditions[0].policies)}")
    contrasts = []
    for table in top.tables("contrasts") if top.gives("contrasts") else []:
        names = tuple(populations)
        sides = {side: _among(table, side, (), names) for side in ("of", "to")}
        contrasts.append(Contrast(table.text("name"), **sides))
        table.done()
    reference = (
        _reference(top.table("reference"), populations, contrasts, conditions[0]) if top.gives("reference") else None
    )
    top.done()
    return Study(
        file, title, seed, repeats, pool, draws, trials, focus, tuple(populations.items()), instances,
        tuple(own.items()), tuple(conditions), tuple(contrasts), reference,
    )  # fmt: skip


def _each(table: _Table) -> list[_Table]:
    return [table.table(key) for key in list(table.content)]


def _among(table: _Table, key: str, default: tuple[str, ...], allowed: tuple[str, ...]) -> tuple[str, ...]:
    names = table.texts(key, default)
    for name in names:
        if name not in allowed:
            raise table.fault(key, f"'{name}'; expected one of {', '.join(allowed)}")
    return names


def _instances(file: Path, top: _Table) -> tuple[tuple[str, Instance], ...]:
    """Find the tasks; each is called by its file's name, or by its path where two have the same."""
    folder = file.parent
    comes_with_the_package = folder == PROTOCOLS
    if comes_with_the_package:  # and the tasks with the project
        checkout = PROTOCOLS.parent.parent
        folder = checkout if (checkout / "domains").is_dir() else Path()
    names = top.texts("instances")
    try:
        found = [find_instances([folder / name]) for name in names]
    except InstanceError as error:
        hint = "; the project's folder `domains` is needed: run this in a checkout" if comes_with_the_package else ""
        raise top.fault("instances", f"{error}{hint}") from None
    problems = [instance for instances in found for instance in instances]
    stems = [instance.problem.stem for instance in problems]
    labels = [s if stems.count(s) == 1 else str(i.problem) for s, i in zip(stems, problems, strict=True)]
    return tuple(zip(labels, problems, strict=True))


def _population(table: _Table) -> Population | Mixture:
    """Read ranges, or the name of a file that `kitassist fit --population` has written."""
    try:
        if table.gives("file"):
            path = table.file.parent / table.text("file")
            table.done()
            return populations.mixture(json.loads(path.read_text(encoding="utf-8")))
        everybody = Population()
        ranges = {name: table.pair(name, getattr(everybody, name)) for name in ("beta", "theta", "sigma")}
        population = Population(**ranges, noise=table.text("noise", everybody.noise))  # type: ignore[arg-type]
        table.done()
    except StudyError:
        raise
    except (ValueError, OSError) as error:
        raise StudyError(f"{table.file}: {table.place}: {error}") from None
    return population


def _policies(
    file: Path, table: _Table, key: str, default: tuple[str, ...]
) -> tuple[tuple[str, ...], dict[str, tuple[Path, str]]]:
    """Read names of policies; one of the user's own is written FILE.py:FUNCTION and called by its function."""
    names, own = [], {}
    for name in table.texts(key, default):
        place = parse(name, file.parent)
        if place is not None:
            where, function = place
            if not where.is_file():
                raise table.fault(key, f"{where}: no such file")
            if function in POLICIES:
                raise table.fault(key, f"'{function}' is a policy of the package; expected another name")
            own[function] = place
        elif name not in POLICIES:
            raise table.fault(key, f"'{name}'; expected one of {', '.join(POLICIES)}, or FILE.py:FUNCTION")
        names.append(name if place is None else place[1])
    return tuple(names), own


def _setting(table: _Table, base: Setting) -> Setting:
    """Read a setting: what is not given is as in another."""
    known = {field.name: getattr(Setting(), field.name) for field in fields(Setting)}
    given: dict[str, Any] = {}
    for key, default in known.items():
        if table.gives(key):
            value = table.take(key)
            kind = type(default)
            right = (
                _is_number(value) if kind is float else isinstance(value, kind) and (kind is bool or value is not True)
            )
            if not right:
                named = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}[kind]
                raise table.fault(key, f"{_shown(value)}; expected {named}")
            given[key] = float(value) if kind is float else value
    table.known += known
    table.done()
    choices = {"knowledge": ("own", "exact"), "suggestions": ("optimal", "all")}
    for key, allowed in choices.items():
        if key in given and given[key] not in allowed:
            raise table.fault(key, f"'{given[key]}'; expected {' or '.join(allowed)}")
    try:
        return replace(base, **given)
    except ValueError as error:
        raise StudyError(f"{table.file}: {table.place}: {error}") from None


def _settings(table: _Table, base: Setting) -> tuple[tuple[str, Setting], ...]:
    """Read a condition's settings; each is called by what it says."""
    found = {}
    for part in table.tables("settings", [{}]):
        label = ", ".join(
            f"{key} {value:g}" if _is_number(value) else f"{key} {value}" for key, value in part.content.items()
        )
        found[label] = _setting(part, base)
    return tuple(found.items())


def _reference(
    table: _Table, populations: dict[str, Population | Mixture], contrasts: list[Contrast], first: Condition
) -> Reference:
    source, name = table.text("source"), table.text("name", "the reference")
    numbers = table.table("headline")
    known = {f"{m}_vs_{p.replace('-', '_')}" for m in ("actions", "interventions") for p in first.policies}
    for key in numbers.content:
        if key not in known:
            raise numbers.fault(key, f"unknown; expected one of {', '.join(sorted(known))}")
    headline = tuple((key, numbers.number(key)) for key in list(numbers.content))
    interventions = []
    for part in table.tables("interventions", []) if table.gives("interventions") else []:
        interventions.append((_among(part, "populations", (), tuple(populations)), part.number("mean")))
        part.done()
    declines = table.take("declines", False)
    if not isinstance(declines, bool):
        raise table.fault("declines", f"{_shown(declines)}; expected true or false")
    claimed: tuple[str, ...] = ()
    if table.gives("contrasts"):
        claimed = _among(table, "contrasts", (), tuple(contrast.name for contrast in contrasts))
    table.done()
    return Reference(source, name, headline, tuple(interventions), declines, claimed)
