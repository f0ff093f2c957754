"""The example notebook runs from top to bottom in an empty folder, and has no stored output that could become old."""

import json
from functools import partial
from xml.etree import ElementTree

import numpy as np

from skincal.model.scene import resource
from skincal.simulation import virtual_session
from tests.skincal.sim_support import SLOW_DEVICES

NOTEBOOK = resource("examples/own_arrays.ipynb")


def test_the_notebook_leads_from_arrays_to_a_plot_and_a_urdf(tmp_path, monkeypatch):
    document = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    cells = [cell for cell in document["cells"] if cell["cell_type"] == "code"]
    assert [(cell["outputs"], cell["execution_count"]) for cell in cells] == [([], None)] * len(cells)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(virtual_session, "simulate_session", partial(virtual_session.simulate_session, settings=SLOW_DEVICES))
    names = {}
    for cell in cells:
        exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    taxels = names["taxels"]
    assert taxels.compare(names["simulated"].truth).mean < 2e-3
    assert len(names["figure"].axes) == 3
    robot = ElementTree.parse(tmp_path / "taxels.urdf").getroot()
    places = [list(map(float, joint.find("origin").get("xyz").split())) for joint in robot.findall("joint")]
    assert len(places) == taxels.is_known.sum() > 10
    np.testing.assert_allclose(sorted(places), sorted(taxels.position[taxels.is_known].tolist()), atol=1e-6)
    assert [path.name for path in tmp_path.iterdir()] == ["taxels.urdf"]
