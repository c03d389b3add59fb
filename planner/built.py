"""Tasks that were built in Python: from a unified-planning `Problem` to the files that everything else reads.

unified-planning allows names that PDDL does not (capitals, dots), and writes others in their place. `write` hands on
which, so that `restore_names` can give the grounded task the names of the problem again.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from .pddl import Instance, PDDLError

if TYPE_CHECKING:
    from unified_planning.model import Problem


def named(problem: Problem) -> Instance:
    """Name an instance that has no files: after its problem."""
    name = problem.name or "problem"
    return Instance(Path(name), Path(f"{name} (domain)"))


def write(problem: Problem, folder: Path) -> tuple[Instance, dict[str, str]]:
    """Write a problem as PDDL.

    Returns
    -------
    instance : Instance
        The two files, in `folder`.
    names : dict of str to str
        For each PDDL name that differs from the problem's own, the latter. A name that a ground action could not be
        written with, one with spaces, commas or parentheses, is left out: it stays as it is in PDDL.

    Raises
    ------
    PDDLError
        The problem is more than classical planning with action costs.
    """
    from unified_planning.exceptions import UPException
    from unified_planning.io import PDDLWriter

    instance = Instance(folder / "problem.pddl", folder / "domain.pddl")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            writer = PDDLWriter(problem)
            writer.write_domain(str(instance.domain))
            writer.write_problem(str(instance.problem))
    except Exception as error:  # noqa: BLE001  it raises whatever comes, its own internal errors included
        reason = " ".join(str(error).split()) if isinstance(error, UPException) else "unified-planning fails at it"
        raise PDDLError(named(problem).problem, None, f"not to be written as classical PDDL: {reason}") from None
    renamed = {name: item.name for name, item in writer.nto_renamings.items() if name != item.name}
    return instance, {name: own for name, own in renamed.items() if own and not re.search(r"[\s(),]", own)}


def restore_names(sas: str, names: Mapping[str, str]) -> str:
    """Give the facts and operators of a SAS text the problem's own names."""
    if not names:
        return sas

    def restored(match: re.Match[str]) -> str:
        return re.sub(r"[^\s(),]+", lambda word: names.get(word[0], word[0]), match[0])

    sas = re.sub(r"(?<=^Atom ).*", restored, sas, flags=re.M)
    sas = re.sub(r"(?<=^NegatedAtom ).*", restored, sas, flags=re.M)
    return re.sub(r"(?<=^begin_operator\n).*", restored, sas, flags=re.M)
