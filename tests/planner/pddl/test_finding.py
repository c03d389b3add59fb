"""Domain files are found by their content, whatever their names and usual locations."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from conftest import KITTING, invoke

from planner import InputFileError, PDDLError, find_instances, instance, load

DOMAIN, PROBLEM = (KITTING / "domain.pddl").read_text(), (KITTING / "tiny.pddl").read_text()


def written(folder: Path, *names: str, domain: str = "kitting") -> None:
    """Write files: a domain if the name contains "domain", otherwise a problem."""
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        text = DOMAIN if "domain" in name.lower() else PROBLEM
        (folder / name).write_text(
            text.replace("(domain kitting)", f"(domain {domain})").replace(":domain kitting", f":domain {domain}")
        )


@pytest.mark.parametrize(
    ("files", "problem", "domain"),
    [
        (["packing_domain.pddl", "packing_problem.pddl"], "packing_problem.pddl", "packing_domain.pddl"),
        (["Domain.pddl", "p.pddl"], "p.pddl", "Domain.pddl"),
        (["domain.PDDL", "p.pddl"], "p.pddl", "domain.PDDL"),
        (["domain.txt", "p.txt"], "p.txt", "domain.txt"),
        (["p01-domain.pddl", "p01.pddl"], "p01.pddl", "p01-domain.pddl"),
        (["p01-domain.pddl", "p02-domain.pddl", "p02.pddl"], "p02.pddl", "p02-domain.pddl"),
        (["p1-domain.pddl", "p10-domain.pddl", "p1.pddl", "p10.pddl"], "p1.pddl", "p1-domain.pddl"),
        (["p01-domain.pddl", "p02-domain.pddl", "p01-airport1-p1.pddl"], "p01-airport1-p1.pddl", "p01-domain.pddl"),
        (["domain_p01.pddl", "domain_p02.pddl", "p02.pddl"], "p02.pddl", "domain_p02.pddl"),
        (["domain.pddl", "p01-domain.pddl", "p01.pddl"], "p01.pddl", "domain.pddl"),
        (["domain.pddl", "instances/p01.pddl"], "instances/p01.pddl", "domain.pddl"),
        (["domain-one.pddl", "instances/p01.pddl"], "instances/p01.pddl", "domain-one.pddl"),
        (["domains/x-domain.pddl", "p01.pddl"], "p01.pddl", "domains/x-domain.pddl"),
        (["domains/x-domain.pddl", "problems/p01.pddl"], "problems/p01.pddl", "domains/x-domain.pddl"),
        (["domains/domain-1.pddl", "domains/domain-2.pddl", "instances/instance-2.pddl"],
         "instances/instance-2.pddl", "domains/domain-2.pddl"),
        (["domain.pddl", "a/near-domain.pddl", "a/p.pddl"], "a/p.pddl", "a/near-domain.pddl"),
    ],
)  # fmt: skip
def test_the_usual_layouts(tmp_path: Path, files: list[str], problem: str, domain: str) -> None:
    written(tmp_path, *files)
    assert instance(tmp_path / problem).domain == tmp_path / domain
    assert find_instances([tmp_path / problem])[0].domain == tmp_path / domain


def test_a_domain_of_another_name_does_not_count(tmp_path: Path) -> None:
    written(tmp_path, "domain.pddl", "first-domain.pddl", domain="other")
    written(tmp_path, "second-domain.pddl", "first.pddl")
    assert instance(tmp_path / "first.pddl").domain == tmp_path / "second-domain.pddl"


def test_relative_names_find_the_folder_above(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path, "my-domain.pddl", "problems/p.pddl")
    monkeypatch.chdir(tmp_path / "problems")
    assert len(load("p.pddl").actions) == len(load("../problems/p.pddl").actions) > 0


@pytest.mark.parametrize(
    "begin",
    [
        "; a note (:domain other)\n",
        ";" * 20_000 + "\n",
        "\ufeff",
        "\n\r\r\n\t",
        "; (define (domain kitting))\n",
        "; ü\n",
    ],
)
def test_what_stands_before_the_name(tmp_path: Path, begin: str) -> None:
    (tmp_path / "any.pddl").write_text(
        begin + DOMAIN.replace("(define (domain kitting)", "( DEFINE\n( Domain KITTING )")
    )
    (tmp_path / "p.pddl").write_text(begin + PROBLEM)
    (found,) = find_instances([tmp_path])
    assert (found.problem.name, found.domain.name) == ("p.pddl", "any.pddl")


def test_several_domains_are_listed(tmp_path: Path) -> None:
    written(tmp_path, "a-domain.pddl", "b-domain.pddl", "tiny.pddl")
    expected = "2 files define the domain 'kitting': {0}/a-domain.pddl, {0}/b-domain.pddl; choose one with --domain"
    line = 1 + PROBLEM[: PROBLEM.index("(:domain")].count("\n")
    with pytest.raises(PDDLError) as error:
        load(tmp_path / "tiny.pddl")
    assert (error.value.file, error.value.line) == (tmp_path / "tiny.pddl", line)
    assert expected.format(tmp_path) in str(error.value)
    done = invoke("solve", tmp_path)
    assert (done.exit_code, done.stdout) == (1, "")
    assert expected.format(tmp_path) in done.stderr
    assert load(tmp_path / "tiny.pddl", tmp_path / "b-domain.pddl").instance.domain == tmp_path / "b-domain.pddl"
    assert find_instances([tmp_path], tmp_path / "b-domain.pddl")[0].domain == tmp_path / "b-domain.pddl"


def test_no_domain_is_said_with_the_option(tmp_path: Path) -> None:
    written(tmp_path / "in", "tiny.pddl")
    with pytest.raises(PDDLError, match=r"tiny.pddl:\d+: no file beside .* 'kitting'; give it with --domain") as error:
        load(tmp_path / "in" / "tiny.pddl")
    assert "other domains" not in str(error.value)
    written(tmp_path / "in", "my-domain.pddl", domain="kiting")
    with pytest.raises(PDDLError, match=r"other domains are there: .*my-domain.pddl \('kiting'\)$"):
        load(tmp_path / "in" / "tiny.pddl")
    done = invoke("simulate", tmp_path / "in" / "tiny.pddl", "--humans", 2)
    assert (done.exit_code, done.stdout, len(done.stderr.splitlines())) == (1, "", 1)
    assert "give it with --domain (in Python: domain=)" in done.stderr


def test_a_domain_pddl_of_another_name_is_said_so(tmp_path: Path) -> None:
    written(tmp_path, "domain.pddl", domain="other")
    written(tmp_path, "tiny.pddl")
    with pytest.raises(PDDLError, match=r"written for domain 'kitting', but .*domain.pddl defines 'other'"):
        load(tmp_path / "tiny.pddl")


def test_a_domain_in_place_of_a_problem(tmp_path: Path) -> None:
    written(tmp_path, "my-domain.pddl", "tiny.pddl")
    for domain in (None, tmp_path / "my-domain.pddl"):
        with pytest.raises(
            PDDLError, match=r"my-domain.pddl:\d+: this file defines the domain 'kitting'; expected a pro"
        ):
            load(tmp_path / "my-domain.pddl", domain)
    done = invoke("solve", tmp_path / "my-domain.pddl")
    assert (done.exit_code, len(done.stderr.splitlines())) == (1, 1)
    with pytest.raises(PDDLError, match="swap them"):
        load(tmp_path / "my-domain.pddl", tmp_path / "tiny.pddl")


def test_domains_in_a_folder_are_no_problems(tmp_path: Path) -> None:
    written(tmp_path, "a/packing_domain.pddl", "a/p.pddl", "b/p01-domain.pddl", "b/p01.pddl", "domains/domain2.pddl")
    (tmp_path / "b" / "broken.pddl").write_text("(define (problem broken) (:domain kitting)")
    found = [(one.problem.name, one.domain.name) for one in find_instances([tmp_path])]
    assert found == [
        ("p.pddl", "packing_domain.pddl"),
        ("broken.pddl", "p01-domain.pddl"),
        ("p01.pddl", "p01-domain.pddl"),
    ]
    assert find_instances([tmp_path]) == find_instances([f"{tmp_path}/**/*.pddl"])
    assert find_instances([tmp_path / "a"]) == find_instances(sorted((tmp_path / "a").iterdir()))
    with pytest.raises(InputFileError, match="no problem file"):
        find_instances([tmp_path / "domains"])


def test_a_domain_that_no_problem_uses_is_told_of(tmp_path: Path) -> None:
    """If a user names both files, another domain is not used without a message."""
    written(tmp_path, "domain.pddl", "my-domain.pddl", "tiny.pddl")
    found = find_instances([tmp_path / "my-domain.pddl", tmp_path / "tiny.pddl"])
    assert [one.problem.name for one in found] == ["my-domain.pddl", "tiny.pddl"]


@pytest.mark.slow
def test_a_folder_of_many_problems(tmp_path: Path) -> None:
    numbers = range(1000)
    for number in numbers:
        (tmp_path / f"p{number:03}.pddl").write_text(f"(define (problem p{number}) (:domain d{number // 2}))")
        if number % 2 == 0:
            (tmp_path / f"d{number // 2}.pddl").write_text(f"(define (domain D{number // 2}))")
    found = find_instances([tmp_path])
    assert [one.problem.name for one in found] == [f"p{number:03}.pddl" for number in numbers]
    assert [one.domain.name for one in found] == [f"d{number // 2}.pddl" for number in numbers]


def test_records_name_the_domain_that_was_found(tmp_path: Path) -> None:
    written(tmp_path, "a/packing_domain.pddl", "a/tiny.pddl", "b/p.pddl")
    done = invoke("solve", tmp_path, "--jobs", 1, "--verify", 1, "--json")
    records = json.loads(done.stdout)
    assert [(record["status"], Path(record["domain"]).name) for record in records] == [
        ("solved", "packing_domain.pddl"), ("invalid", "domain.pddl"),
    ]  # fmt: skip
    assert "b/p.pddl" in done.stderr


@pytest.mark.parametrize("folder", ["", "."])
def test_a_folder_without_a_name_is_no_problem_file(folder: str) -> None:
    with pytest.raises(PDDLError, match="is a folder; expected the file of a problem"):
        load(folder)
