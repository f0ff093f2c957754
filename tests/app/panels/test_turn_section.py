"""Turns of taxels of three axes in the window: the Taxel tab and the Compare tab; and none of it for one axis."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from app.panels.compare_panel import ComparePanel
from app.panels.inspect_panel import InspectPanel
from skincal.axes.axis_checks import DeadAxis
from skincal.axes.turn_differences import compare_turns
from skincal.contacts.value_order import OrderOfValues, ValueOrderCounts
from skincal.files.reference import Origin, TaxelPositions
from skincal.geometry import rotation_by
from skincal.model.skin_axes import ValueOrder
from skincal.words.turn_words import IN_PLANE_UNKNOWN, NO_TURN_YET, TURN_ROWS, turn_cells, turn_difference_words
from skincal.words.units import DASH
from tests.app.scene3d_support import estimate, laid
from tests.app.three_axes_support import THREE_AXES_SCENE
from tests.app.window_support import PLAN, context, frame, part, session, shown
from tests.skincal.axes.turn_support import QUARTER, turn_of, turns_of

UP = np.array([0.0, 0.0, 1.0])
PLACES = laid(PLAN).places


def at(turns, **changes):
    known = {channel: estimate(channel, PLACES[channel]) for channel in range(24)}
    return frame(replace(session(1, known), turns=turns), where=THREE_AXES_SCENE, **changes)


def test_the_taxel_tab_says_where_the_axes_point_and_what_is_unknown(qtbot):
    turns = turns_of({3: turn_of(3, QUARTER), 4: turn_of(4, QUARTER, lean_deg=0.0)})
    panel = shown(qtbot, InspectPanel(context(part(THREE_AXES_SCENE))), (420, 700))
    panel.show_state(at(turns, selected=3))
    assert panel.turn.isVisible()
    cells = [label.text() for label in panel.turn.cells]
    x, y, z = (np.array([float(word.replace("\N{MINUS SIGN}", "-")) for word in cells[row].split()]) for row in range(3))
    assert np.abs(np.stack([x, y, z], axis=1) - QUARTER).max() < 0.05
    assert IN_PLANE_UNKNOWN not in cells[-1]
    assert "10 pokes" in cells[-1]
    panel.show_state(at(turns, selected=4))
    cells = [label.text() for label in panel.turn.cells]
    assert cells[0] == cells[1] != cells[2]
    assert IN_PLANE_UNKNOWN in cells[-1]
    panel.show_state(at(turns, selected=5))
    assert panel.turn.cells[-1].text() == NO_TURN_YET


def test_readings_that_show_no_turn_say_why(qtbot):
    """A dead axis of this taxel, or values of other taxels: no direction is given, and none is drawn."""
    turns = turns_of({3: turn_of(3, QUARTER)})
    panel = shown(qtbot, InspectPanel(context(part(THREE_AXES_SCENE))), (420, 700))
    turns.__dict__["dead_axes"] = (DeadAxis(3, "x", is_stuck=False, pokes=10),)
    panel.show_state(at(turns, selected=3))
    assert [label.text() for label in panel.turn.cells][:3] == [DASH] * 3
    assert panel.turn.cells[-1].text() == "unknown: an axis does not answer"
    state = at(turns_of({3: turn_of(3, QUARTER)}), selected=3)
    wrong = OrderOfValues(ValueOrderCounts(20, on_z_by_taxel=0, on_z_by_axis=20), ValueOrder.BY_TAXEL)
    panel = shown(qtbot, InspectPanel(context(part(THREE_AXES_SCENE))), (420, 700))
    panel.show_state(replace(state, snapshot=replace(state.snapshot, value_order=wrong)))
    assert panel.turn.cells[-1].text() == "unknown: order of values wrong"


def test_a_taxel_tab_of_one_axis_has_no_such_section(qtbot):
    assert shown(qtbot, InspectPanel(context())).turn is None


def test_nothing_of_three_axes_is_loaded_for_one_axis():
    script = (
        "import sys; from tests.app.window_support import context; from app.panels.inspect_panel import InspectPanel;"
        "from app.panels.compare_panel import ComparePanel; from PySide6.QtWidgets import QApplication; a = QApplication([]);"
        "InspectPanel(context()); ComparePanel(context());"
        "print([m for m in sys.modules if m.startswith('skincal.axes.') or m.endswith(('turn_section', 'turn_words'))])"
    )
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert found.stdout.strip() == "[]"


def test_the_error_of_a_module_contains_the_scatter_of_its_taxels():
    turns = turns_of({3: turn_of(3, QUARTER), 4: turn_of(4, QUARTER)}, {7: (3, 4)})
    alike = turns.of_channel(4)
    assert alike.module is turns.modules[7]
    scattered = replace(alike, module=replace(alike.module, spread=0.05))
    assert scattered.normal_sd == pytest.approx(np.hypot(alike.fit.normal_sd, 0.05 / np.sqrt(2)), rel=1e-9)
    assert "that of its module" in turn_cells(alike, UP)[-1]
    assert len(turn_cells(alike, UP)) == len(TURN_ROWS)


def test_turns_that_differ_by_known_angles_are_compared():
    lean, about = rotation_by(np.array([0.03, 0.0, 0.0])), rotation_by(np.array([0.0, 0.0, -0.2]))
    z_alone = np.where([[False, False, True]], np.eye(3), np.nan)
    first = {1: np.eye(3), 2: QUARTER, 3: np.eye(3), 4: np.eye(3), 9: np.eye(3)}
    second = {1: lean, 2: QUARTER @ about, 3: z_alone, 4: np.diag([1.0, -1.0, 1.0])}
    found = compare_turns(first, second)
    assert found.channels == (1, 2, 3, 4)
    assert found.normals == pytest.approx([0.03, 0.0, 0.0, 0.0], abs=1e-7)
    assert found.in_plane[:2] == pytest.approx([0.0, 0.2], abs=1e-9)
    assert np.isnan(found.in_plane[2:]).all()
    words = turn_difference_words(found, lambda channel: f"taxel {channel}")
    assert "1.7\N{DEGREE SIGN} at most, taxel 1" in words
    assert "2 turns in the plane by" in words
    assert "11.5\N{DEGREE SIGN} at most, taxel 2" in words
    assert turn_difference_words(compare_turns({}, second), str) == ""


def test_compare_shows_turns_against_a_truth_that_has_them(qtbot):
    off = rotation_by(np.array([0.0, 0.0, np.radians(6.0)]))
    panel = ComparePanel(context(part(THREE_AXES_SCENE)))
    places = dict(enumerate(PLACES))
    panel.add_reference(TaxelPositions("truth.json", "link", places, origin=Origin.TRUTH, axes={3: QUARTER @ off}))
    shown(qtbot, panel, (420, 700))
    panel._chosen = ("Free method", "Truth")
    state = at(turns_of({3: turn_of(3, QUARTER)}))
    panel.show_state(state)
    assert panel.turns.isVisible()
    angle = float(panel.turns.text().split("plane by ")[1].split("\N{DEGREE SIGN}")[0])
    assert angle == pytest.approx(6.0, abs=3.0)
    assert panel.turns.text().endswith("Axes in the picture: Free method thin, Truth broad and pale.")
    drawn = []
    panel.comparison_changed.connect(drawn.append)
    panel._chosen = ("Free method", "Layout")
    panel.show_again()
    assert panel.turns.text() == "Axes in the picture: Free method thin."
    first, second = drawn[-1].axes
    row = panel._channels.tolist().index(3)
    assert first.axes[row] == pytest.approx(QUARTER, abs=0.1)
    assert np.isnan(second.axes).all()
    panel._chosen = ("Free method", "Truth")
    panel.show_again()
    assert drawn[-1].axes[1].axes[row] == pytest.approx(QUARTER @ off)
