"""The option `--policy`: a team policy by name, or a user's own as FILE.py:FUNCTION."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from planner.system.errors import expected
from planner.system.files import no_such

from ...people.user_code import parse
from ...team.policy_names import POLICIES
from ..terminal.console import ExitCode, fail
from .common import Option

if TYPE_CHECKING:
    from ...team.policies import UserPolicy

FIRST = "attention"
"""The policy of a team unless another one is named."""


class NameOrFile(click.ParamType):  # type: ignore[type-arg]
    """One of some names, or a user's own object as FILE.py:NAME.

    Parameters
    ----------
    what : str
        What it names; in capitals it is the placeholder of an option.
    names : iterable of str
    own : str
        What of a file is named, in capitals.
    """

    def __init__(self, what: str, names: Iterable[str], own: str) -> None:
        self.name, self._names, self._own = what, tuple(names), own

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:  # noqa: ARG002
        """Return the placeholder; the option's text lists the values."""
        return self.name.upper()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Check a value. What is the user's own is imported later."""
        if value not in self._names:
            place = parse(value)
            if place is None:
                self.fail(f"'{value}'; {expected(value, self._names, f', or FILE.py:{self._own}')}", param, ctx)
            if not place[0].is_file():
                self.fail(f"{place[0]}: {no_such(place[0])}", param, ctx)
        return str(value)


def policy_option(*, several: bool) -> Option[Any]:
    """Return the option `--policy`, which may be repeated where several are compared."""
    more: dict[str, Any] = {"multiple": True, "default": (FIRST,)} if several else {"default": FIRST}
    return click.option(
        "--policy", "policy", type=NameOrFile("policy", POLICIES, "FUNCTION"), show_default=True,
        help=f"Team policy: {', '.join(POLICIES)}, or FILE.py:FUNCTION.{several * ' Repeat it to compare several.'}",
        **more,
    )  # fmt: skip


def policies_of(names: tuple[str, ...]) -> dict[str, str | UserPolicy]:
    """Return each policy, keyed by its name in the results."""
    from ...team.policies import UserPolicy

    found: dict[str, str | UserPolicy] = {}
    for name in dict.fromkeys(names):
        place = parse(name)
        called = name if place is None else place[1]
        if called in found or (place is not None and called in POLICIES):
            raise click.UsageError(f"--policy {name}: there is already a policy '{called}'; expected another name")
        found[called] = name if place is None else UserPolicy.load(*place)
    return found


def baseline_among(policies: Iterable[str], given: str | None) -> str:
    """Return the policy that differences refer to; the given one may be FILE.py:FUNCTION."""
    from ...studies.reports.compared_policies import baseline_of

    place = None if given is None else parse(given)
    try:
        return baseline_of(policies, given if place is None else place[1])
    except ValueError as error:
        raise click.UsageError(f"--{error}") from None


@contextmanager
def policy_errors() -> Iterator[None]:
    """Report an error of a policy in one line, with file and line number."""
    from ...people.user_code import UserCodeError

    try:
        yield
    except UserCodeError as error:
        fail(str(error), ExitCode.FAILED)
