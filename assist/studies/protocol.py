"""Reader of study protocols (TOML files), whose format `docs/study.md` describes.

Every error names the file and the place in it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

from pydantic import Field

from planner import Instance
from planner.system.errors import InputFileError
from planner.system.errors import expected as meant

from ..declare.declared import (
    AnyTable,
    Count,
    Counts,
    Expected,
    Text,
    Texts,
    declared,
    names_of,
)
from ..declare.tables import convert, fault, label, load, replaced
from ..people.ranges import Population
from ..people.user_code import parse
from ..person.settings import Setting
from ..team.policy_names import POLICIES
from .plan_tables import among, different, own_policy, population, tasks
from .study import OWN, Condition, Contrast, Reference, Study, StudyPlan

PROTOCOLS = Path(__file__).parent / "protocols"


@declared
class ConditionTable:
    """A table of `conditions`. Missing fields have the study's values."""

    name: Text
    populations: Texts | None = None
    instances: Texts | None = None
    policies: Texts | None = None
    humans: Counts | None = None
    settings: Annotated[tuple[AnyTable, ...], Field(min_length=1), Expected("one table or more")] | None = None
    priors: Texts = (OWN,)
    repeats: Count | None = None


@declared(kw_only=True)
class StudyTable(StudyPlan):
    """The whole file."""

    instances: Texts
    title: Text | None = None
    humans: Counts = (1, 2, 3, 4, 5, 6)
    policies: Texts = ("none", "reactive", "attention")
    focus: Text | None = None
    baseline: Text | None = None
    setting: AnyTable = field(default_factory=dict)
    populations: dict[str, AnyTable] = field(default_factory=dict)
    conditions: tuple[ConditionTable, ...] | None = None
    contrasts: tuple[Contrast, ...] = ()
    reference: Reference | None = None


def shipped() -> list[str]:
    """Return the names of the bundled studies."""
    return sorted(path.stem for path in PROTOCOLS.glob("*.toml"))


def study_of(study: Study | str | Path) -> Study:
    """Return a study: itself, or from its file or shipped name, as `read` does.

    Raises
    ------
    InputFileError
        There is no such study, or its file is invalid.
    """
    return study if isinstance(study, Study) else read(study)


def read(study: str | Path, *, repeats: int | None = None, baseline: str | None = None) -> Study:
    """Read a study from a file, or a bundled one by name.

    Parameters
    ----------
    study : str or Path
        Paths in the file are relative to its folder.
    repeats : int, optional
        Replaces the study's own number of repeats.
    baseline : str, optional
        Replaces the study's own baseline.

    Raises
    ------
    InputFileError
        The file is invalid; the message names the place and the expected value.
    """
    file = Path(study)
    if file.suffix != ".toml":
        if str(study) not in shipped():
            raise InputFileError(
                f"no protocol '{study}'; {meant(str(study), shipped(), ' or a file that ends in .toml')}"
            )
        file = PROTOCOLS / f"{study}.toml"
    table = convert(load(file), StudyTable, file)
    reader = Reader(file, replace(table, repeats=repeats or table.repeats))
    found = reader.study()
    return found if baseline is None else replace(found, baseline=reader.baseline(baseline, found))


@dataclass(frozen=True)
class Reader:
    """Builds a study from the tables of a file; resolves names and paths.

    Attributes
    ----------
    file : Path
    table : StudyTable
    own : dict
        User policies named so far, each with its file and function.
    """

    file: Path
    table: StudyTable
    own: dict[str, tuple[Path, str]] = field(default_factory=dict)

    def study(self) -> Study:
        """Return the study."""
        table = self.table
        instances = self._instances()
        people = {name: population(self.file, f"populations.{name}", own) for name, own in table.populations.items()}
        people = people or {"everybody": Population()}
        if OWN in people:
            raise fault(self.file, f"populations.{OWN}", "means the true population in `priors`; expected another name")
        policies = self._policies("policies", table.policies)
        setting = replaced(Setting(), table.setting, self.file, "setting")
        names = tuple(label for label, _ in instances)
        tables = (ConditionTable("team size"),) if table.conditions is None else table.conditions
        different(self.file, "conditions", [one.name for one in tables])
        conditions = [
            self._condition(f"conditions[{number}]", own, names, tuple(people), policies, setting)
            for number, own in enumerate(tables, start=1)
        ]
        first = conditions[0]
        usual = "attention" if "attention" in first.policies else first.policies[-1]
        focus = self._one_of("focus", table.focus or usual, first.policies)
        others = tuple(name for name in first.policies if name != focus)
        baseline = None if table.baseline is None else self._one_of("baseline", table.baseline, others)
        for number, own in enumerate(table.contrasts, start=1):
            among(self.file, f"contrasts[{number}].of", own.of, people)
            among(self.file, f"contrasts[{number}].to", own.to, people)
        study = Study(
            **{name: getattr(table, name) for name in names_of(StudyPlan)}, file=self.file,
            title=table.title or self.file.stem, focus=focus, baseline=baseline, populations=tuple(people.items()),
            instances=instances, own_policies=tuple(self.own.items()), default=setting, conditions=tuple(conditions),
            contrasts=table.contrasts, reference=table.reference,
        )  # fmt: skip
        self._check_reference(study, people)
        return study

    def baseline(self, given: str, study: Study) -> str:
        """Return the name of a baseline that is given in place of the file's."""
        known = [name for name in study.conditions[0].policies if name != study.focus]
        name = self._name_of(given)
        if name not in known:
            raise InputFileError(f"baseline '{given}'; {meant(given, known)}")
        return name

    def _condition(
        self, place: str, own: ConditionTable, instances: tuple[str, ...], people: tuple[str, ...],
        policies: tuple[str, ...], setting: Setting,
    ) -> Condition:  # fmt: skip
        humans = tuple(sorted(set(own.humans or self.table.humans)))
        if humans[-1] > self.table.pool:
            message = f"{humans[-1]} people in a team; expected at most {self.table.pool}, the size of the pool"
            raise fault(self.file, f"{place}.humans", message)
        settings = {}
        for number, part in enumerate(own.settings or [{}], start=1):
            if (name := label(part)) in settings:
                raise fault(self.file, f"{place}.settings[{number}]", "is there twice; expected different settings")
            settings[name] = replaced(setting, part, self.file, f"{place}.settings[{number}]")
        return Condition(
            name=own.name, populations=among(self.file, f"{place}.populations", own.populations or people[:1], people),
            instances=among(self.file, f"{place}.instances", own.instances or instances, instances),
            policies=self._policies(f"{place}.policies", own.policies) if own.policies else policies, humans=humans,
            settings=tuple(settings.items()), priors=among(self.file, f"{place}.priors", own.priors, (OWN, *people)),
            repeats=own.repeats,
        )  # fmt: skip

    def _instances(self) -> tuple[tuple[str, Instance], ...]:
        """Return the tasks. Each is labelled with its file's name, or with its path if several files share the name."""
        named = dict.fromkeys(self.table.instances)
        problems = [instance for name in named for instance in tasks(self.file, "instances", name)]
        stems = [instance.problem.stem for instance in problems]
        labels = [s if stems.count(s) == 1 else str(i.problem) for s, i in zip(stems, problems, strict=True)]
        return tuple(zip(labels, problems, strict=True))

    def _policies(self, place: str, named: Iterable[str]) -> tuple[str, ...]:
        """Return the names of policies. A user's policy FILE.py:FUNCTION is named after its function."""
        names = []
        for name in dict.fromkeys(named):
            own = own_policy(self.file, place, name)
            if own is None:
                names.append(name)
                continue
            function = own[1]
            if (shipped := function.replace("_", "-")) in POLICIES:
                message = f"'{shipped}' is a policy of the package; expected another name"
                raise fault(self.file, place, message)
            if self.own.setdefault(function, own) != own:
                message = f"two policies are called '{function}'; expected different names"
                raise fault(self.file, place, message)
            names.append(function)
        return tuple(names)

    def _one_of(self, place: str, given: str, known: tuple[str, ...]) -> str:
        """Return the name of one of some policies, which may be given as FILE.py:FUNCTION."""
        return among(self.file, place, (self._name_of(given),), known)[0]

    def _name_of(self, given: str) -> str:
        own = parse(given, self.file.parent)
        return given if own is None or own not in self.own.values() else own[1]

    def _check_reference(self, study: Study, people: Iterable[str]) -> None:
        """Check the names in the reference."""
        table = self.table.reference
        if table is None:
            return
        others = [name.replace("-", "_") for name in study.compared_with(study.focus)]
        known = {f"{measure}_vs_{name}" for measure in ("actions", "costs", "interventions") for name in others}
        for key in table.headline:
            if key not in known:
                raise fault(self.file, f"reference.headline.{key}", f"unknown; {meant(key, sorted(known))}")
        for number, own in enumerate(table.interventions, start=1):
            among(self.file, f"reference.interventions[{number}].populations", own.populations, people)
        among(self.file, "reference.contrasts", table.contrasts, [contrast.name for contrast in self.table.contrasts])
