"""The texts of an instance, read and checked as far as possible without a planner or another library."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from . import fragment, instance_finder, instances, writer
from . import reader as reading
from .instances import Instance
from .reader import Reading
from .s_expressions import Expression
from .writer import Rendered


@dataclass(frozen=True)
class Source:
    """The content of an instance's files, and both files rewritten in normalised form.

    The rewritten problem is for all readers, the domain for the translator.
    """

    reading: Reading
    rendered_domain: Rendered
    rendered_problem: Rendered

    @classmethod
    def of(cls, instance: Instance) -> Source:
        """Read the files of an instance, and perform the checks that need no library.

        A `PDDLError` says if they are not valid PDDL, do not match, or go beyond classical planning with action costs.
        """
        if (fault := instance_finder.missing(instance)) is not None:
            raise fault
        domain, problem = (
            instances.parse(file, instances.text(file, kind))
            for file, kind in ((instance.domain, "domain"), (instance.problem, "problem"))
        )
        fragment.check(instance, domain, problem)
        read = reading.read(instance, domain, problem)
        return cls(read, writer.domain(read), writer.problem(read))

    @cached_property
    def typed_domain(self) -> Rendered:
        """The domain for unified-planning, which accepts `object` as a type only if it is listed."""
        return writer.domain(self.reading, list_object=True)

    @property
    def instance(self) -> Instance:
        """The two files."""
        return self.reading.instance

    @property
    def domain(self) -> Expression:
        """The normalised domain, with the positions of the original file."""
        return self.rendered_domain.whole

    @property
    def problem(self) -> Expression:
        """The normalised problem, with the positions of the original file."""
        return self.rendered_problem.whole
