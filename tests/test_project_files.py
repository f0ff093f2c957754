"""Files that other programs read of a project: the citation and the workflow that runs README's commands."""

import re
import tomllib
from pathlib import Path

import pytest

from skincal.version import __version__
from tools.launch import CHECK_ARGUMENTS, TIMING_FILES

CHECKOUT = Path(__file__).resolve().parent.parent
README = (CHECKOUT / "README.md").read_text(encoding="utf-8")


def read_yaml(path):
    return pytest.importorskip("yaml").safe_load((CHECKOUT / path).read_text(encoding="utf-8"))


def test_the_citation_names_this_version_and_the_paper():
    citation = read_yaml("CITATION.cff")
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["cff-version"] == "1.2.0"
    assert (citation["title"], citation["license"]) == (project["name"], project["license"])
    assert citation["version"] == __version__
    assert [each["name"] for each in citation["authors"]] == [each["name"] for each in project["authors"]]
    (paper,) = citation["references"]
    assert f'{paper["authors"][0]["family-names"]} et al., "{paper["title"]}" (IROS {paper["year"]})' in README


def test_the_workflow_runs_the_commands_of_the_readme_on_each_system():
    (job,) = read_yaml(".github/workflows/checks.yml")["jobs"].values()
    matrix = job["strategy"]["matrix"]
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "windows", "macos"}
    assert job["runs-on"] == "${{ matrix.os }}"
    project = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert f">={matrix['python'][0]}" == project["requires-python"]
    commands = re.findall(r"^python3 (\w+\.py) +#", README, re.MULTILINE)
    run = [step["run"] for step in job["steps"] if "run" in step]
    assert [command.split()[:2] for command in run] == [["python", name] for name in commands]
    assert all((CHECKOUT / name).is_file() for name in commands)


def test_each_test_that_must_run_alone_is_in_a_file_that_the_check_runs_alone():
    marked = [path for path in (CHECKOUT / "tests").rglob("*.py") if "@pytest.mark.quiet" in path.read_text(encoding="utf-8")]
    marked.remove(Path(__file__).resolve())
    assert {path.relative_to(CHECKOUT).as_posix() for path in marked} == set(TIMING_FILES)


def test_each_file_of_tests_is_in_one_group_of_the_check():
    run_by_their_names = tuple(f"tests/{folder}/" for folder in ("benchmarks", "consumers/by_name", "long"))
    groups = [words for words in CHECK_ARGUMENTS.values() if "not quiet" in words]
    for path in (CHECKOUT / "tests").rglob("test_*.py"):
        name = path.relative_to(CHECKOUT).as_posix()
        if name.startswith(run_by_their_names):
            continue
        above = [folder.as_posix() for folder in Path(name).parents]
        running = [words for words in groups if any(each in words and f"--ignore={each}" not in words for each in above)]
        left_out = [words for words in running if any(f"--ignore={each}" in words for each in above)]
        assert len(running) - len(left_out) == 1, name
