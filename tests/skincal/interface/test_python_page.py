"""The tutorial of the Python interface runs from top to bottom, in an empty folder."""

import re
from functools import partial
from pathlib import Path

import pytest

from skincal.simulation import virtual_session
from tests.skincal.sim_support import SLOW_DEVICES

PAGE = Path(__file__).resolve().parents[3] / "docs" / "python.md"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The names that there are after each block of the page's code, and the folder it ran in."""
    folder, names, after = tmp_path_factory.mktemp("python"), {}, []
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 6
    quick = partial(virtual_session.simulate_session, settings=SLOW_DEVICES)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(virtual_session, "simulate_session", quick)
        for block in blocks:
            exec(compile(block, str(PAGE), "exec"), names)
            after.append(dict(names))
    return after, folder


def test_the_page_runs_and_its_numbers_are_right(ran):
    (*_, names), folder = ran
    assert {path.name for path in folder.iterdir()} == {"taxels.png", "r_forearm.txt", "report.html", "monday"}
    assert names["apart"].mean < 2e-3
    assert len(names["apart"].channel) == 84
    assert str(names["verdict"]).startswith(("All", "Not finished"))


def test_own_arrays_give_the_estimates_of_the_session_they_are_from(ran):
    (_, names, *_), _ = ran
    scene, simulated, solved = names["scene"], names["simulated"], names["session"]
    for method in scene.methods:
        assert solved.taxels(method).compare(simulated.taxels(method)).worst < 1e-12
