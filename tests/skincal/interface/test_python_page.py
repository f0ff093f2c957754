"""The tutorial of the Python interface runs from top to bottom, in an empty folder."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).resolve().parents[3] / "docs" / "python.md"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The names that the page's code makes, and the folder it ran in."""
    folder, names = tmp_path_factory.mktemp("python"), {}
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 6
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(compile("\n".join(blocks), str(PAGE), "exec"), names)
    return names, folder


def test_the_page_runs_and_its_numbers_are_right(ran):
    names, folder = ran
    assert {path.name for path in folder.iterdir()} == {"taxels.png", "r_forearm.txt", "report.html", "monday"}
    assert names["apart"].mean < 2e-3
    assert len(names["apart"].channel) == 84
    assert str(names["verdict"]).startswith(("All", "Not finished"))


def test_own_arrays_give_the_estimates_of_the_session_they_are_from(ran):
    names, _ = ran
    scene, skincal = names["scene"], names["skincal"]
    made = skincal.simulate(scene, pokes=60, seed=1)
    solved = skincal.solve(scene, names["wrenches"], names["responses"], names["poses"])
    for method in scene.methods:
        assert solved.taxels(method).compare(made.taxels(method)).worst < 1e-12
