"""Rows of tables as text: what is selected, or all, below the headings, by Ctrl+C in every table of the window."""

from __future__ import annotations

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractItemView, QApplication, QTableView, QTableWidget, QTreeWidget

from app.dialogs.history_dialog import HistoryDialog
from app.panels.copying import make_copyable, rows_text
from app.panels.widgets import put_rows, table
from app.session.opening import OpenRequest

Key = Qt.Key
NAMES = {"pokes", "landmarks", "modules", "arm poses", "pokes of the taxel", "history"}
CONTROL = Qt.KeyboardModifier.ControlModifier


def copied(bench, view: QAbstractItemView) -> list[list[str]]:
    """Press Ctrl+C in a table and return what a spreadsheet would take."""
    QApplication.clipboard().setText("")
    view.window().activateWindow()
    view.setFocus()
    bench.until(view.hasFocus, 5000)
    QTest.keyClick(view, Key.Key_C, CONTROL)
    text = QApplication.clipboard().text()
    assert not text or text.endswith("\n")
    return [line.split("\t") for line in text.splitlines()]


def test_pokes_are_copied_as_they_are_shown(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    panel = bench.window.session_view.workspace.pokes
    bench.window.session_view.workspace.show_tab("Pokes")
    whole = copied(bench, panel.table)
    assert whole[0] == ["#", "Outcome", "Taxel", "Force, N", "Tilt, \N{DEGREE SIGN}", "Pitch, mm"]
    assert [int(row[0]) for row in whole[1:]] == [record.outcome.poke for record in bench.snapshot.pokes][::-1]
    force, tilt, pitch = (float(text) for text in whole[1][3:])
    assert (force > 1.0, 0.0 <= tilt <= 90.0, abs(pitch) < 100.0) == (True, True, True)
    panel.select(2)
    assert copied(bench, panel.table) == [whole[0], whole[-2]]
    panel.table.selectAll()
    assert copied(bench, panel.table) == whole


def test_every_table_has_the_key(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    workspace = bench.window.session_view.workspace
    bench.key(Key.Key_H)
    tables = bench.window.findChildren(QTreeWidget) + bench.window.findChildren(QTableView)
    assert {"pokes", "landmarks", "modules", "arm poses", "pokes of the taxel", "history"} <= {
        t.accessibleName() for t in tables
    }
    for view in tables:
        # A table that has no rows yet is not shown.
        view.show()
        tab = next((tab for tab, panel in workspace.panels.items() if panel.isAncestorOf(view)), "")
        workspace.show_tab(tab)
        assert copied(bench, view)[0] == rows_text(view).splitlines()[0].split("\t"), view.accessibleName()
    bench.window.findChild(HistoryDialog).reject()


def test_a_table_of_the_verdict_gives_its_rows_in_order(qtbot):
    view = QTableWidget(3, 1)
    qtbot.addWidget(view)
    view.setSelectionBehavior(QTableWidget.SelectionBehavior.SelectRows)
    view.setHorizontalHeaderLabels(["Taxel"])
    make_copyable(view)
    view.selectRow(2)
    assert rows_text(view) == "Taxel\n\n"


@pytest.mark.usefixtures("qapp")
def test_a_name_with_a_tab_stays_one_cell():
    view = table("names", ("Name", "Off by, mm"))
    put_rows(view, [("wrist\ttop\n", "1.3")])
    assert rows_text(view) == "Name\tOff by, mm\nwrist?top?\t1.3\n"
