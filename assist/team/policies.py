"""Team policies by name: those of the package, and those of the user in a file.

`named` returns the paper's policies and ours. `UserPolicy` is a function in a Python file, written as
`FILE.py:FUNCTION`. An error in it is reported as a `UserCodeError` with its file and line.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from planner.system.errors import expected
from planner.system.processes import on_threads
from planner.system.progress import adding

from ..people.user_code import UserCodeError, described, load, parse
from ..person.policy import Policy
from ..person.pomdp import AssistPOMDP
from ..person.qmdp import QMDP, qmdp
from ..person.travel import Travel
from .attention import AttentionSwitching
from .attention_never import AttentionAgainstNever
from .baselines import NoAssistance, Reactive
from .outlook import AttentionWithOutlook
from .policy_names import POLICIES
from .priority import Priority
from .rollout import Rollout
from .state import TeamAction, TeamPolicy, TeamState
from .whittle import Whittle


def named(
    name: str, policies: Sequence[Policy], travel: Travel, solver: Callable[[AssistPOMDP], QMDP] = qmdp
) -> TeamPolicy:  # fmt: skip
    """Return a team policy by its name.

    The data that it needs about each person are computed on first use, or by `prepare`.

    Parameters
    ----------
    name : str
        The paper's "none", "reactive" and "attention"; "attention-never" for the other reading of its Algorithm 1;
        "attention-outlook" for Algorithm 1 that considers those who see a suggestion; "whittle" for Whittle indices;
        our "priority"; "rollout", which improves on it by simulation; or FILE.py:NAME, a function of the user.
    policies : sequence of Policy
        Policies for single people.
    travel : Travel
    solver : callable
        Solves what "priority" needs about each person.

    Raises
    ------
    UserCodeError
        The file or the function does not exist, or the file cannot be run.
    ValueError
        The name is unknown, or the policy needs to enumerate a task that is too large.
    """
    if name == "none":
        return NoAssistance()
    if name == "reactive":
        return Reactive(uses_belief=any(policy.pomdp.hidden.distinguishes_goals for policy in policies))
    if name == "attention":
        return AttentionSwitching()
    if name == "attention-never":
        return AttentionAgainstNever.of(policies)
    if name == "attention-outlook":
        return AttentionWithOutlook()
    if name == "priority":
        return Priority.of(policies, travel, solver=solver)
    if name == "whittle":
        return Whittle.of(policies, travel)
    if name == "rollout":
        return Rollout.of(policies, travel)
    own = parse(name)
    if own is not None:
        return UserPolicy.load(*own)
    raise ValueError(f"unknown policy {name!r}; {expected(name, POLICIES, ', FILE.py:NAME, or a function')}")


def by_name(
    policies: Mapping[str, TeamPolicy | str] | Iterable[TeamPolicy | str] | TeamPolicy | str,
) -> dict[str, TeamPolicy | str]:
    """Return one or more policies by their names: those of a mapping, or their own.

    Raises
    ------
    ValueError
        Two have one name.
    """
    if isinstance(policies, Mapping):
        found = dict(policies)
    else:
        found = {}
        for one in [policies] if isinstance(policies, str) or callable(policies) else policies:
            name = one if isinstance(one, str) else str(getattr(one, "__name__", "policy"))
            if name in found:
                raise ValueError(f"two policies are called {name!r}; expected a mapping of names to policies")
            found[name] = one
    return found


def prepare(
    policy: TeamPolicy, policies: Sequence[Policy], *, progress: Callable[[int, int], None] | None = None, jobs: int = 1
) -> None:
    """Compute now the data that a team policy needs about the people of some policies.

    Parameters
    ----------
    policy : TeamPolicy
        Its method `prepare`, if it has one, is called with each of the policies.
    policies : sequence of Policy
    progress : callable, optional
        Called with the numbers of finished and of all policies, at the beginning and after each.
    jobs : int
        Number of policies that are processed at a time.
    """
    work = getattr(policy, "prepare", None)
    if work is None:
        return
    advance = adding(lambda _, done, total: progress and progress(done, total or 0), "", len(policies))

    def one(policy: Policy) -> None:
        work(policy)
        advance(1)

    on_threads(one, policies, jobs)


@dataclass(frozen=True)
class UserPolicy:
    """A team policy of the user.

    Attributes
    ----------
    file : Path
    name : str
        Name of the function in that file.
    function : callable
    tried : set of int
        Sizes of the teams in which a simulation has found that it remembers nothing (`memory_trial`).
    """

    file: Path
    name: str
    function: TeamPolicy
    tried: set[int] = field(default_factory=set, compare=False, repr=False)

    @classmethod
    def load(cls, file: str | Path, name: str) -> UserPolicy:
        """Load a function from a Python file.

        Raises
        ------
        UserCodeError
            The file or the function does not exist, or the file cannot be run.
        """
        file = Path(file)
        return cls(file, name, load(file, name))

    @property
    def uses_belief(self) -> bool:
        """Whether the function needs beliefs; true unless its attribute `uses_belief` is false."""
        return bool(getattr(self.function, "uses_belief", True))

    @property
    def source(self) -> str:
        """File and line at which the function begins."""
        code = getattr(self.function, "__code__", None)
        return f"{self.file}:{code.co_firstlineno}" if code else f"{self.file}:{self.name}"

    def __call__(self, team: TeamState, /) -> TeamAction:
        """Return the function's choice."""
        try:
            return self.function(team)
        except (Exception, SystemExit) as error:
            raise UserCodeError(described(error, self.file), code=self) from error
