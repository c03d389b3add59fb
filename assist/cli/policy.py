"""The command `policy`, which solves one person's POMDP and reports a lower and an upper bound."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from planner import Instance
from planner.batch.results_folder import versions
from planner.system.progress import status_line

from .options.common import gap_option, json_option, out_option, time_limit_option
from .options.goals import goals_option, several_goals
from .options.help import command
from .options.person import PersonOptions, person_options, person_problem
from .options.settings import REGION_STATES
from .options.task import costs_of
from .output.person_bounds import line_of, show_bounds
from .terminal.console import kept_if_interrupted, print_json

if TYPE_CHECKING:
    from planner import CostToGo

    from ..people.goals import Goals


@command("policy kitting/tiny --gap 0.01")
@gap_option
@time_limit_option
@out_option("policy and bounds (.npz)")
@person_options
@goals_option
@json_option
def policy(
    person: PersonOptions, gap: float, time_limit: float, out: Path | None, as_json: bool, problems: tuple[str, ...],
) -> None:  # fmt: skip
    """Solve the POMDP of assisting one person, with a lower and an upper bound on the optimal value."""
    from ..people.goals import first_of
    from ..person.policy import not_worth_its_cost
    from ..person.solver import Solution, solve

    instance, setting, domain = person.instance, person.setting, person.domain
    if not problems:
        person.given.refuse(["goal_prior"], "without --goals")
    if out is not None and out.suffix != ".npz":
        raise click.UsageError(f"--out {out}: expected a name that ends in .npz")

    def known_of(found: Instance) -> CostToGo | Goals:
        goals = several_goals(instance, problems, setting.goal_prior, domain=domain, max_states=setting.max_states)
        return goals or costs_of(found, max_states=setting.max_states, memory_limit_mb=setting.memory_limit)

    states = setting.region_states or REGION_STATES
    found, problem = person_problem(person, known_of, states=states, time_limit=time_limit)
    reached, solved = list[float](), list[Solution]()
    with kept_if_interrupted(lambda: reached), status_line("first bounds") as show:

        def tell(seconds: float, lower: float, upper: float) -> None:
            reached[:] = lower, upper, seconds
            show(line_of(lower, upper))

        solved.append(
            solve(problem.pomdp, gap=gap, time_limit=time_limit, memory_limit_mb=setting.memory_limit, bounds=tell)
        )
    if not solved:
        if as_json:
            print_json(dict(zip(("lower", "upper", "seconds"), reached, strict=True)) | {"stopped": "interrupt"})
        else:
            click.echo(f"{line_of(*reached[:2])}; no policy is saved")
        return
    (solution,) = solved
    if out is not None:
        solution.save(out, values=first_of(problem.known).values(problem.states.clip(0)), task_states=problem.states)
    frontier, too_high = problem.pomdp.frontier, None if solution.suggests else setting.c_suggest
    hidden = problem.pomdp.hidden
    record = {
        "instance": str(found.problem), "domain": str(found.domain), **solution.as_dict(),
        **({"goals": dict(hidden.goals)} if hidden.distinguishes_goals else {}),
        "method": problem.known.method, "frontier": 0 if frontier is None else len(frontier.states),
        "c_suggest_too_high": too_high, "versions": versions(),
    }  # fmt: skip
    if as_json:
        print_json(record)
    else:
        show_bounds(record)
        if too_high is not None:
            click.echo(f"{not_worth_its_cost(too_high)} (--c-suggest)")
