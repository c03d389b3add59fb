"""Data flows one way: a module imports only from those above it."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from assist.cli import main
from assist.cli.command_group import COMMANDS

ROOT = Path(__file__).resolve().parent.parent

ROOMS = {
    "planner.system": "errors arrays results files limits progress processes jit",
    "planner.pddl": """instances declarations expressions formulas reader compilation durative static_facts
        numeric_schemas value_sets value_ranges value_scope numeric_encoding numeric_compiler validation
        plan_execution built_problems""",
    "planner.grounding": "fast_downward task translation",
    "planner.search.kernels": "packed_successors state_sets ranked_successors block_steps",
    "planner.search": """state_space search_space sorted_space numbering invariants
        variable_clusters state_ranking automorphisms successor_generator state_registry
        ranked_index""",
    "planner.costtogo": """trial_states number_values load cost_to_go table astar goal_tables
        orbit_table on_demand portfolio""",
    "planner.batch": "results_folder solve_instance solve_batch",
    "planner": "engine",
    "assist.declare": "declared rows tables options catalogue refusals",
    "assist.people": """hidden_type arguments state_keys slots choices misconception decision same_costs user_code
        goals terms memory memory_on_demand choice_model human ranges spread belief influence_kernels
        type_kernels trust_rules perceived_suggestions given_rules neighbours neighbourhood sights
        theta_reach action_names signals""",
    "assist.person": """ties leaf_bounds behaviour evidence observation_model robots fleet travel settings
        robot_actions trust_shares pomdp each_goal assumptions visiting_robot problem_arrays people_arrays
        random_streams rows rounding action_values krylov belief_update sparse_iteration policy_iteration mdp_values
        problem_rows policy rows_of_people lazy_policy archive belief_filter dynamics_kernel
        dynamics joint_belief beliefs known_states uncertain_states expected_values qmdp solution_cache
        alpha_vectors upper_hull convex_bound belief_hulls vector_lists hsvi search memory_needed
        further_beliefs solver time_expansion subproblem_frontier attention_subproblem frontier_bounds
        state_cache likely_states truncated_task shared_task closed_problem backups compliance_relaxation
        truncated_bound growing_problem leaf_estimates truncated_policy person_problem""",
    "assist.team": """policy_names by_policy state action_check assignment schedule people_at_work seen baselines
        attention attention_never outlook questions robots_at_work trust_of_people model_group team_tasks engine
        priority whittle rollout policies affordable drawn solving matching pool common_random_numbers
        goal_knowledge trace episodes beginning requested traced_run run memory_trial simulate
        belief_trace illustration""",
    "assist.certify.information_relaxation": "confidence belief_nodes options congestion path_search sampled_bound",
    "assist.certify": """options action_prices envelope priced_steps prices certificate
        computation truncated_prices sample_paths team_bound relaxed_value comparison""",
    "assist.certify.coupled": """agents price_bound whittle index_policy rollout policies simulation joint_optimum
        sampled_bound""",
    "assist.learning": """method log_rows log_steps log_json log_tables log_files log intervals comparison
        advice_log
        advice_rules advice_model advice_fit replay observations evidence likelihood
        rule_families neighbours_in_logs
        likelihood_table likelihood_arrays first_estimates person_estimate maximum_likelihood
        logit_likelihood hierarchy misconception_fit
        diagnostics distribution population fit goals
        influence_population
        trust_fit held_out""",
    "assist.drawing": "subject states profile scene layout svg raster picture frames drawn files notebook",
    "assist.drawing.plots": """shown_figure style labels panels_by_name episode belief watched people policies
        trade_off study userstudy""",
    "assist.live": """causes continuations contrast explanation names live_setting live_task advice roster
        uncertain_actions beliefs seen_suggestions live_questions decision_point robot_places decisions
        knowledge desk lines views event_base events reports record assistant store people_store header history team
        session simulated_person trace_reasons""",
    "assist.studies": """statistics repeated_measures study plan_tables protocol own_code_trials cells runner
        own_code""",
    "assist.studies.userstudy": """forms questionnaires questionnaire_file assignment outcomes plan plan_file codes
        views participant_team roll teams events record cohort session csv_tables tables export
        forecast""",
    "assist.studies.reports": """watched_episode compared_policies policy_comparison wording
        report_files study_summary study_claims study_figures study_report userstudy_data
        userstudy_comparisons userstudy_summary preregistration userstudy_report""",
    "assist.web": """tokens cookies log_lines measures schemas watchers service authorization request_limits
        task_drawings event_routes request_faults routes metrics streams page_routes app connections server client""",
    "assist.web.user_study": "schemas service routes rehearsal server",
    "assist.connect": "observed pomdp pomdpx policyx pomdp_py teams rendering gymnasium pettingzoo",
    "assist.connect.bridges": """messages ordering session_client tasks transport errands kernel mqtt_settings
        mqtt_topics mqtt opcua_settings opcua opcua_nodes opcua_server ros2_settings ros2""",
    "assist.cli.terminal": "interrupts console",
    "assist.cli.options": """common settings config task policies population person travel goals team help bridges
        listening live log trust""",
    "assist.cli.output": """solve_records solve_progress person_bounds
        people_estimates trust_estimates comparisons""",
    "assist.cli": """domains check solve simulate policy bound export draw fit compare infer study user_study
        serve settings study_prepare study_report command_group""",
}
"""The folders in the order in which they build on each other, and the files of each likewise."""

ORDER = [module for room, files in ROOMS.items() for module in (*(f"{room}.{file}" for file in files.split()), room)]
ORDER.remove("planner")
# With all that is in them.
MAY_READ_PDDL = (
    *(f"assist.studies.{file}" for file in ("study", "plan_tables", "cells", "protocol", "own_code_trials")),
    "assist.drawing",
    "assist.connect.teams",
    "assist.connect.rendering",
    "assist.studies.userstudy.plan",
    "assist.studies.userstudy.plan_file",
    "assist.cli",
)
ARRAYS = {"planner", "planner.system", *(f"planner.system.{file}" for file in ROOMS["planner.system"].split())}
READING = {"load", "sweep", "cost_to_go", "find_instances", "instance", "Instance", "Task"}


@cache
def modules() -> dict[str, Path]:
    """Return the file of each module; packages count as modules, since their files contain code."""
    files = [f for package in ("planner", "assist") for f in sorted((ROOT / package).rglob("*.py"))]
    named = {".".join(f.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): f for f in files}
    return {name: f for name, f in named.items() if "." in name}


def within(module: str, package: str) -> bool:
    return f"{module}.".startswith(f"{package}.")


@cache
def is_package(module: str) -> bool:
    return any(within(other, module) for other in ORDER if other != module)


@cache
def imports(module: str, source: str) -> list[tuple[str, str]]:
    """Return the project's modules that a module imports, each with the imported name."""
    package = module.split(".")
    if not is_package(module):
        package.pop()
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*package[: len(package) + 1 - node.level], base]).rstrip(".")
            for alias in node.names:
                whole = f"{base}.{alias.name}"
                found.append((whole, "") if whole in ORDER else (base, alias.name))
        elif isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
    return [(name, what) for name, what in found if name.partition(".")[0] in ("planner", "assist")]


def faults(module: str, source: str) -> list[str]:
    wrong = []
    for name, what in imports(module, source):
        if name == "planner" and module.startswith("assist."):
            pass  # the package's own list of exports
        elif name not in ORDER or ORDER.index(name) >= ORDER.index(module):
            wrong.append(f"{module} imports {name}, which comes after it")
        may_read = any(within(module, one) for one in MAY_READ_PDDL)
        confined = module.startswith("assist.") and not may_read and name.startswith("planner")
        if confined and (name not in ARRAYS or what in READING):
            wrong.append(f"{module} takes {what or name} from the planner; only arrays may be used there")
    return wrong


def test_every_module_has_its_place() -> None:
    assert sorted(modules()) == sorted(ORDER)


def test_the_picture_shows_the_imports_that_there_are() -> None:
    """The order of the packages puts each below all that it imports from."""
    import drawn_rooms  # which imports this file

    assert drawn_rooms.FILE.read_text() == drawn_rooms.drawn(), "python tests/drawn_rooms.py draws it anew"


def test_the_map_has_a_sentence_for_each_room() -> None:
    """`planner/__init__.py`, `assist/__init__.py` and docs/contributing.md tell the same of each."""
    import drawn_rooms

    for file, text in drawn_rooms.maps().items():
        assert file.read_text(encoding="utf-8") == text, "python tests/drawn_rooms.py writes it anew"
        assert max(map(len, text.splitlines())) <= 120 or file.suffix == ".md"


def test_the_reading_list_is_as_short_as_it_says() -> None:
    """The files of the two lists are there, and have at most as many lines as the page tells."""
    page = (ROOT / "docs" / "contributing.md").read_text().partition("## A reading list")[2]
    for begin, end, files in (
        ("These 16 files", "What these use", 16),
        ("From there to a certified", "Words have one", 8),
    ):
        text = begin + page.partition(begin)[2].partition(end)[0]
        most = int(re.findall(r"at most ([\d,]+)", text)[0].replace(",", ""))
        while "(" in text:  # what is said of a file may name others
            text = re.sub(r"\([^()]*\)", "", text)
        named = []
        for line in re.findall(r"^- (?:.|\n )*", text, re.M):
            folder = "".join(re.findall(r"^- `(assist/\w+/)`", line))
            named += [folder + name for name in re.findall(r"`([\w/]+\.py)`", line)]
        assert len(set(named)) == files
        assert sum(len((ROOT / name).read_text().splitlines()) for name in named) <= most


def test_files_that_pages_name_are_there() -> None:
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = {
        file for page in pages for file in re.findall(r"`((?:assist|planner|tests)/[\w/.-]+\.\w+)`", page.read_text())
    }
    assert len(named) > 20
    assert sorted(file for file in named if not (ROOT / file).exists()) == []


def test_nothing_is_beside_the_rooms() -> None:
    for folder in ("planner", "assist"):
        rooms = {room.split(".")[1] for room in ROOMS if room.startswith(f"{folder}.")}
        files = {f"{file}.py" for file in ROOMS.get(folder, "").split()}
        # A folder that was moved can be left with the caches of its former modules.
        beside = {file.name for file in (ROOT / folder).iterdir() if file.is_file() or any(file.glob("[!_]*.py"))}
        assert beside == {*rooms, *files, "__init__.py", "__init__.pyi", "py.typed"}


def test_tests_mirror_the_rooms() -> None:
    files = [file for file in (ROOT / "tests").rglob("test_*.py") if file != Path(__file__)]
    folders = {".".join(file.parent.relative_to(ROOT / "tests").parts) for file in files}
    assert folders <= {*ROOMS, "together"}
    assert len({file.name for file in files}) == len(files)


def floors(folder: str) -> int:
    """Return the length of the longest chain of rooms of which each imports from the next."""
    below: dict[str, set[str]] = {}
    for module, file in modules().items():
        room = ".".join(module.split(".")[:2])
        names = {".".join(name.split(".")[:2]) for name, _ in imports(module, file.read_text()) if name in ORDER}
        below.setdefault(room, set()).update(name for name in names - {room} if within(name, folder))

    def floor(room: str) -> int:
        return 1 + max(map(floor, below[room]), default=0)

    return max(floor(room) for room in below if within(room, folder))


def test_rooms_stand_on_few_floors() -> None:
    assert floors("planner") <= 7
    assert floors("assist") <= 10


def handed_on(package: str) -> list[tuple[str, str]]:
    """Return the names that a package exports, each with the module that it is from."""
    folder = ROOT / package.replace(".", "/")
    found = []
    for node in ast.parse((folder / "__init__.pyi").read_text()).body:
        assert isinstance(node, ast.ImportFrom), f"{package}: its list imports and does nothing else"
        assert node.level == 1, f"{package}: exports what is its own"
        found += [(alias.name, f"{package}.{node.module}") for alias in node.names if alias.name == alias.asname]
        assert len(node.names) == 1, f"{package}: one name a line, under its own name"
    return found


PACKAGES = [
    "planner",
    "assist",
    *(room for room in ROOMS if "." in room and (ROOT / room.replace(".", "/") / "__init__.pyi").exists()),
]


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_only_hands_on(package: str) -> None:
    tree = ast.parse((ROOT / package.replace(".", "/") / "__init__.py").read_text()).body
    expected = "__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)"
    assert [type(node).__name__ for node in tree] == ["Expr", "ImportFrom", "Assign"]
    assert ast.unparse(tree[2]) == ast.unparse(ast.parse(expected))
    names = handed_on(package)
    assert len(names) == len(dict(names)) > 0
    for name, module in names:
        assert getattr(import_module(package), name) is getattr(import_module(module), name)


def test_what_a_package_hands_on_is_not_covered_by_a_module_of_that_name() -> None:
    script = "import planner.costtogo.astar, planner; from planner import astar; print(astar.__name__)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "astar\n"


SMALL = """
import sys
from pathlib import Path
for name in "numba scipy matplotlib pandas unified_planning fastapi networkx rich".split():
    sys.modules[name] = None  # an import of it fails
from click.testing import CliRunner
import planner
import assist
from assist.cli import main
from assist.cli.command_group import COMMANDS

assert "numpy" not in sys.modules
del sys.modules["rich"]  # which prints the help
for command in COMMANDS:
    assert CliRunner().invoke(main, [command, "--help"]).exit_code == 0, command
    assert "numpy" not in sys.modules, command

from planner.batch.solve_instance import solve_instance
record = solve_instance(planner.instance("kitting/tiny"), place=Path("FOLDER/tiny"))
assert (record["status"], record["cost"], record["verified"]) == ("solved", 6, 20), record
main(["draw", "kitting/tiny", "--out", "FOLDER/tiny.svg"], standalone_mode=False)
del sys.modules["scipy"]
main(["simulate", "kitting/tiny", "--humans", "2", "--policy", "reactive", "--episodes", "20"], standalone_mode=False)
"""


def test_small_work_loads_nothing_that_it_does_not_need(tmp_path: Path) -> None:
    """Nothing is compiled, either: the compiler takes longer to import than all else. Help does not need numpy."""
    script = SMALL.replace("FOLDER", str(tmp_path))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr


PLAIN = """
import sys
for name in "fastapi uvicorn websockets httpx2 aiomqtt asyncua matplotlib pandas jinja2".split():
    sys.modules[name] = None  # an import of it fails
from assist.cli import main
from assist.live import Assistant
from planner import load, sweep

tiny = "domains/kitting/tiny.pddl"
for words in (
    ["simulate", tiny, "--humans", "2", "--episodes", "2", "--policy", "priority", "--trace", "TRACE"],
    ["policy", tiny, "--gap", "0.5"],
    ["bound", tiny, "--humans", "1", "--policy", "none", "--value-episodes", "2", "--gap", "1"],
    ["fit", tiny, "TRACE"],
):
    main(words, standalone_mode=False)
desk = Assistant(sweep(load(tiny)), ["ann"])
desk.recommend()
print(tuple(desk.people))
"""


@pytest.mark.slow
def test_a_plain_installation_is_enough_for_commands_that_need_no_extra(tmp_path: Path) -> None:
    script = PLAIN.replace("TRACE", str(tmp_path / "trace.jsonl"))
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("('ann',)\n")


def test_the_overview_of_commands_says_what_they_say() -> None:
    for name, text in COMMANDS.items():
        command = main.get_command(None, name)
        assert command is not None
        assert command.get_short_help_str(300) == text
    assert [f"assist.cli.{name.replace('-', '_')}" in ORDER for name in COMMANDS] == [True] * len(COMMANDS)


def test_import_direction() -> None:
    assert [fault for module in ORDER for fault in faults(module, modules()[module].read_text())] == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("planner.pddl.instances", "import assist.people.human"),
        ("assist.person.pomdp", "from planner import load"),
        ("assist.person.qmdp", "from planner.pddl.validation import validate"),
        ("assist.drawing.plots.episode", "from ...cli.terminal.console import fail"),
        ("assist.cli.solve", "from .fit import fit"),
        ("assist.cli.options.person", "from .. import policy"),
        ("assist.cli.options.person", "from ... import cli"),
    ],
)
def test_a_wrong_import_is_found(module: str, line: str) -> None:
    assert faults(module, line)


HTTP = ("assist.web", "assist.connect.bridges")
WITHIN = dict.fromkeys(("fastapi", "starlette", "uvicorn", "websockets", "asyncio"), HTTP)
"""The rooms that import a library, wherever in a file they do. Everything else works without it."""
BEGIN = {
    **dict.fromkeys(("httpx2", "aiomqtt", "asyncua", "jinja2"), HTTP),
    "matplotlib": ("assist.drawing.plots",),
    "unified_planning": ("planner.engine",),
    "pandas": (),
}
"""The rooms whose files begin with the import of a library; others import it where it is used."""


def test_libraries_of_extras_are_imported_in_their_rooms() -> None:
    """Everything but the bridges works without the extra `web`, and without an event loop."""
    taken = [
        (module, name, (WITHIN if indent else WITHIN | BEGIN)[name])
        for module, file in modules().items()
        for indent, name in re.findall(r"^( *)(?:from|import) (\w+)", file.read_text(), re.MULTILINE)
        if name in (WITHIN if indent else WITHIN | BEGIN)
    ]
    assert {"fastapi", "asyncio", "matplotlib", "unified_planning"} <= {name for _, name, _ in taken}
    assert [one for one in taken if not any(within(one[0], room) for room in one[2])] == []
