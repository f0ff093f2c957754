"""The tutorial of the Python interface runs from top to bottom, in an empty folder."""

import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from skincal.interface.scene import PartEntries
from skincal.simulation import virtual_session
from tests.skincal.sim_support import SLOW_DEVICES

PAGE = Path(__file__).resolve().parents[3] / "docs" / "python.md"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """The names that there are after each block of the page's code, and the folder it ran in."""
    folder, names, after = tmp_path_factory.mktemp("python"), {}, []
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 9
    quick = partial(virtual_session.simulate_session, settings=SLOW_DEVICES)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(virtual_session, "simulate_session", quick)
        patch.setattr("skincal.reporting.drawings.render", lambda *_: [b"a picture"])  # tests of the report look at them
        for block in blocks:
            exec(compile(block, str(PAGE), "exec"), names)
            after.append(dict(names))
    return after, folder


def test_the_page_runs_and_its_numbers_are_right(ran):
    (*_, names), folder = ran
    assert sorted(path.name for path in folder.iterdir()) == [
        "arm", "ft.csv", "monday", "plate", "plate.obj", "r_forearm.txt", "report.html", "skin.csv", "taxels.png",
        "taxels.urdf",
    ]  # fmt: skip
    assert names["apart"].mean < 2e-3
    assert len(names["apart"].channel) == 84
    assert str(names["verdict"]).startswith(("All", "Not finished"))
    assert names["arm"].part.scene.robot.columns == ("bend",)
    assert np.allclose(names["plate"].plan.position[:, 2], 0.025)
    found = names["recorded"].taxels("surface").compare(names["plate"].plan)
    assert found.channel.tolist() == [names["plate"].plan.channel[names["taxel"]]]
    assert found.worst < 1e-4


def test_every_entry_of_a_part_is_described():
    described = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`.*?) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)))
    assert set(PartEntries.__annotations__) <= set(described)


def test_own_arrays_give_the_estimates_of_the_session_they_are_from(ran):
    (_, _, _, names, *_), _ = ran
    scene, simulated, solved = names["scene"], names["simulated"], names["session"]
    for method in scene.methods:
        assert solved.taxels(method).compare(simulated.taxels(method)).worst < 1e-12
