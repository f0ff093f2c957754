"""Every page and panel at small sizes and with large text.

Nothing is cut, nothing lies outside the window, no letter with Alt stands for two things, and each leads to a field.
"""

from __future__ import annotations

import pytest
import trimesh
from PySide6.QtCore import QRect, Qt
from PySide6.QtWidgets import QHeaderView, QLabel, QPushButton, QWidget

from app.panels import widgets
from app.panels.widgets import put_rows, table
from app.text_size import TEXT_SIZES_PERCENT
from app.theme import Choice
from tests.app.cut_texts import cut_texts, outside
from tests.app.every_page import builder_steps, every_page
from tests.app.letters import collisions, labels_that_lead_nowhere
from tests.app.whole_window import OPEN_MS

SIZES = [((1366, 768), 100), ((1024, 700), 150)]
"""`tests/app/long` tries those between."""
SIZE_NAMES = ["1366x768", "1024x700 at 150 %"]


@pytest.mark.timeout(400)
@pytest.mark.parametrize(("size", "percent"), SIZES, ids=SIZE_NAMES)
def test_nothing_is_cut_on_any_page_and_each_letter_with_alt_leads_to_one_thing(bench, recorded, monkeypatch, size, percent):
    look_at_every_page(bench, recorded, monkeypatch, size, percent)


def look_at_every_page(bench, recorded, monkeypatch, size, percent):
    window = bench.window
    bench.theme.choose(Choice.DARK if percent == 100 else Choice.LIGHT)
    # The display of the tests is larger.
    monkeypatch.setattr(widgets, "room_of", lambda _: QRect(0, 0, *size))
    window.resize(*size)
    window.text_size.choose(percent)
    found, names = {}, set()
    for name, page in every_page(bench, recorded, monkeypatch):
        names.add(name)
        bench.qtbot.wait(30)
        problems = cut_texts(page) + outside(page) + labels_that_lead_nowhere(page)
        problems += [f"{letter} stands for {texts}" for letter, texts in collisions(page).items()]
        if page is window:
            if window.size().toTuple() != size:
                problems.append(f"the window has grown to {window.size().toTuple()}")
        elif page.width() > size[0] or page.height() > size[1]:
            problems.append(f"larger than the window: {page.size().toTuple()}")
        if problems:
            found[name] = problems
    assert found == {}
    assert len(names) > 25


@pytest.mark.timeout(400)
@pytest.mark.parametrize(("size", "percent"), [((1024, 700), 150), ((1366, 768), TEXT_SIZES_PERCENT[-1])])
def test_nothing_of_a_new_part_is_cut_when_the_text_grows_while_it_is_described(bench, tmp_path, size, percent):
    trimesh.creation.cylinder(40.0, 120.0).export(tmp_path / "tube.stl")
    bench.window.resize(*size)
    bench.window.ask_part(tmp_path / "tube.stl")
    bench.until(lambda: bench.window.builder.is_settled, OPEN_MS)
    bench.window.text_size.choose(percent)
    found = {}
    for name, page in builder_steps(bench):
        if problems := cut_texts(page.builder) + outside(page):
            found[name] = problems
    assert found == {}
    assert bench.window.size().toTuple() == size


def test_cut_things_are_found(qtbot):
    window = QWidget()
    qtbot.addWidget(window)
    window.resize(300, 200)
    label, button = QLabel("A sentence that is much too long for its room", window), QPushButton("Save and start", window)
    label.setGeometry(0, 0, 60, 20)
    button.setGeometry(250, 50, 90, 24)
    tree = table("pokes", ["Shape, mm", "x"])
    tree.setParent(window)
    put_rows(tree, [("1", "2")] * 5)
    # The table's own header shares its room.
    tree.setHeader(QHeaderView(Qt.Orientation.Horizontal))
    tree.setGeometry(0, 100, 90, 60)
    window.show()
    qtbot.wait(20)
    tree.header().resizeSection(0, 30)
    cuts = "\n".join(cut_texts(window))
    assert "A sentence" in cuts
    assert "header 'Shape, mm'" in cuts
    assert "table pokes" in cuts
    assert "Save and start" in "\n".join(outside(window))
