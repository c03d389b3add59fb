"""The texts of an instance, read and checked as far as that needs no planner and no library."""

from __future__ import annotations

from dataclasses import dataclass

from . import finding, pddl, supported
from .expressions import Expression
from .pddl import Instance


@dataclass(frozen=True)
class Source:
    """The texts of an instance, with what they consist of.

    Attributes
    ----------
    instance : Instance
    domain_text, problem_text : str
        In lower case.
    domain, problem : Expression
    """

    instance: Instance
    domain_text: str
    problem_text: str
    domain: Expression
    problem: Expression

    @classmethod
    def of(cls, instance: Instance) -> Source:
        """Read an instance's files, and check what needs no library.

        Raises
        ------
        PDDLError
            They are no PDDL, do not belong together, or use what lies outside classical planning with action costs.
        """
        if (fault := finding.missing(instance)) is not None:
            raise fault
        domain, problem = pddl.text(instance.domain, "domain"), pddl.text(instance.problem, "problem")
        source = cls(
            instance, domain, problem, pddl.parse(instance.domain, domain), pddl.parse(instance.problem, problem)
        )
        supported.check(instance, source.domain, source.problem)
        return source
