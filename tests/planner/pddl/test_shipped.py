"""Bundled tasks are found by folder and name from every working directory."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import click
import pytest
from conftest import DOMAINS, KITTING, ROOT, SHIPPED, invoke

from assist.cli import main
from planner import InputFileError, PDDLError, find_instances, instance, load
from planner.pddl.instances import bundled_tasks


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_every_task_has_a_name_that_finds_it() -> None:
    names = [one.name for one in bundled_tasks()]
    assert {file.problem for file in find_instances(names)} == {one.problem for one in SHIPPED}
    assert find_instances(["kitting/costs/ways"])[0].domain == KITTING / "costs" / "domain.pddl"


def test_a_file_comes_before_the_task_of_its_name(elsewhere: Path) -> None:
    own = elsewhere / "kitting" / "tiny"
    assert instance("kitting/tiny").problem == KITTING / "tiny.pddl"
    own.parent.mkdir()
    own.write_text("(define")
    assert instance("kitting/tiny").problem == Path("kitting/tiny")
    assert find_instances(["kitting/tiny"])[0].problem == Path("kitting/tiny")


def test_a_name_that_is_nearly_right_is_answered_with_those_that_are() -> None:
    with pytest.raises(InputFileError, match=r"^kiting/tinny: no such .*; with the package come kitting/tiny$"):
        find_instances(["kiting/tinny"])
    with pytest.raises(PDDLError, match=r"^paper: no such problem file; with the package come kitting/paper$"):
        load("paper")
    with pytest.raises(InputFileError, match=r"folder; `kitassist domains` lists the tasks that come"):
        find_instances(["something/else"])


def test_a_folder_of_the_package_stands_for_all_of_its_tasks(elsewhere: Path) -> None:
    assert find_instances("blocks") == find_instances(["blocks"]) == find_instances([DOMAINS / "blocks"])
    assert find_instances(["kitting/costs/"]) == find_instances([KITTING / "costs"])
    assert len(find_instances(["kitting", "kitting/tiny"])) == len(find_instances([KITTING]))
    for wrong, near in (("blcks", "blocks"), ("kitting/cost", "kitting/costs")):
        with pytest.raises(InputFileError, match=rf"^{wrong}: no such file or folder; with the package come {near}"):
            find_instances([wrong])
    with pytest.raises(PDDLError, match=r"^blocks: no such problem file; with the package come blocks/\S+, blocks/\S+"):
        load("blocks")
    for empty in ("", "."):
        with pytest.raises(InputFileError):
            find_instances([empty])
    (elsewhere / "blocks").mkdir()
    with pytest.raises(
        InputFileError, match=r"^blocks: no problem file"
    ):  # a folder in the working directory comes first
        find_instances(["blocks"])


def test_the_list_says_what_each_is() -> None:
    found = {one["name"]: one for one in json.loads(invoke("domains", "--json").stdout)}
    assert found["kitting/tiny"] == {
        "name": "kitting/tiny", "problem": str(KITTING / "tiny.pddl"), "states": 21, "cost": 6,
        "about": "Two containers with one item each, two slots that take both: small enough to be worked out by hand.",
    }  # fmt: skip
    assert found["kitting/unsolvable"]["states"] is None
    assert (found["timed/one-part"]["cost"], found["timed/cell"]["cost"]) == (2, 12.0417)  # minutes
    assert found["depot/two-boxes"]["about"].startswith("Kitting from stacked boxes")  # its file begins with no comment
    assert all(one["about"].endswith(".") for one in found.values())
    assert {folder.name for folder in DOMAINS.iterdir()} == {name.partition("/")[0] for name in found}


def test_the_citation_has_the_version_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    cited = (ROOT / "CITATION.cff").read_text().splitlines()
    assert f"version: {project['version']}" in cited
    assert f"license: {project['license']}" in cited


def test_the_container_serves_without_rights_with_options_that_there_are() -> None:
    lines = (ROOT / "Containerfile").read_text().splitlines()
    user, command = (next(line for line in reversed(lines) if line.startswith(word)) for word in ("USER ", "CMD "))
    assert int(user.split()[1]) >= 1000
    name, serve, *arguments = json.loads(command.removeprefix("CMD "))
    found = main.get_command(click.Context(main), serve)
    assert (name, serve) == ("kitassist", "serve")
    assert found is not None
    with found.make_context(serve, arguments) as context:
        assert context.params["host"] == "0.0.0.0"
        assert find_instances(context.params["instances"])[0].problem == KITTING / "paper.pddl"
