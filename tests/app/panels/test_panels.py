"""The panels on a real (virtual) display: what their pixels and words show, and that the same state draws nothing."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from PySide6.QtCore import QSettings, Qt
from PySide6.QtGui import QColor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QDoubleSpinBox, QLineEdit, QSpinBox, QTableView, QTreeWidget, QWidget

from app.dialogs.history_dialog import HistoryDialog
from app.panels.devices import DevicesPanel, LinkChips
from app.panels.inspect_panel import InspectPanel
from app.panels.panel import Panel
from app.panels.pokes_panel import HEADINGS, PokesPanel
from app.panels.readings_panel import ReadingsPanel
from app.panels.recent_menu import MAX_SESSIONS, RECENT_SETTING, RecentMenu
from app.panels.rig_panel import RigPanel
from app.panels.taxel_map import TaxelMap
from app.panels.widgets import put_rows, rows_text, table, theme_colours
from app.session.opening import OpenRequest
from app.session_view import PANEL_TYPES
from app.state.memo import Memo, is_same
from app.text.guidance_text import DOT_SEPARATOR
from app.theme import DARK, LIGHT, Choice, Colours
from app.window import Theme, qpalette, style_sheet
from app.workspace import RIGHT_PX
from skincal.contacts.outcome import Reason
from skincal.model.actions import SetPose
from skincal.model.pose_form import PoseForm, RotationForm, SentPose
from skincal.model.readings import TEMPERATURE_NAME, LinkState, SideReading, Stream
from skincal.words.poke_words import REASON_WORDS, short_rejection
from tests.app.scene3d_support import estimate
from tests.app.window_support import (
    NAMES,
    PLAN,
    SCENE,
    arm_scene,
    changed,
    context,
    contrast,
    frame,
    ink,
    link,
    paints_from_now,
    part,
    pixels,
    reading,
    session,
    shown,
    slip,
    touch,
)
from tests.approved import approved

# Themes and widgets


def test_a_widget_survives_twenty_thousand_updates(qtbot):
    """Some Qt bindings lose a reference to None in every void call, and abort the program within seconds."""
    widget = shown(qtbot, QWidget(), (50, 50))
    for _ in range(20_000):
        widget.update()
    qtbot.wait(1)
    assert widget.isVisible()


@pytest.mark.parametrize("colours", [DARK, LIGHT], ids=["dark", "light"])
def test_text_is_readable_on_every_background(colours: Colours):
    for text in (colours.text, colours.muted, colours.accent, colours.bad, colours.warn, *colours.axes):
        for ground in (colours.window, colours.panel):
            assert contrast(text, ground) >= 4.5, (text, ground)
    assert contrast(colours.accent, colours.on_accent) >= 4.5


@pytest.mark.parametrize(("choice", "colours"), [(Choice.DARK, DARK), (Choice.LIGHT, LIGHT)], ids=["dark", "light"])
@pytest.mark.parametrize("kind", [QLineEdit, QComboBox, QSpinBox, QDoubleSpinBox])
def test_the_border_of_a_field_is_visible(qtbot, choice, colours, kind):
    Theme(choice)
    widget = kind()
    if isinstance(widget, QComboBox):
        widget.setEditable(True)
    image = shown(qtbot, widget, (160, 30)).grab().toImage()
    border = [image.pixelColor(at, image.height() // 2) for at in range(3)]
    for ground in (colours.window, colours.panel):
        assert max(contrast(pixel, ground) for pixel in border) >= 3.0


def test_the_theme_is_the_operators_or_the_desktops(qapp, qtbot):
    theme = Theme(Choice.DARK)
    assert qapp.palette().window().color() == QColor(DARK.window)
    assert theme_colours() is DARK
    with qtbot.waitSignal(theme.changed):
        theme.choose(Choice.LIGHT)
    assert qapp.palette().windowText().color() == qpalette(LIGHT).windowText().color()
    assert theme_colours() is LIGHT
    theme.choose(Choice.SYSTEM)
    assert theme_colours() in (DARK, LIGHT)


def test_the_part_with_the_focus_is_visible(qtbot):
    first = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    panel = shown(qtbot, InspectPanel(context()))
    panel.setStyleSheet(style_sheet(theme_colours()))
    for view, other in ((first, panel), (panel, first)):
        other.setFocus()
        other.activateWindow()
        qtbot.waitUntil(lambda view=view: not view.hasFocus())
        before = pixels(view)
        view.activateWindow()
        view.setFocus()
        qtbot.waitUntil(view.hasFocus)
        qtbot.wait(20)
        assert changed(before, pixels(view)) > 500


# What all panels have in common

ONE = np.zeros(3)


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ((1, "a" * 30, None), (1, "".join(["a"] * 30), None), True),
        (((300, ONE),), ((int("300"), ONE),), True),
        ((ONE,), (np.zeros(3),), False),
        ((1,), (True,), False),
        ((1, 2), (1,), False),
        ((Choice.DARK,), (Choice.LIGHT,), False),
    ],
)
def test_plain_values_are_compared_by_value_and_objects_by_identity(first, second, same):
    assert is_same(first, second) is same
    memo = Memo[int]()
    assert [memo.get(first, lambda: 1), memo.get(second, lambda: 2)] == [1, 1 if same else 2]


class Counting(Panel):
    """Counts how often it is drawn."""

    title = "Counting"
    depends, drawn = ("x",), 0

    def depends_on(self, _state):
        return self.depends

    def update_view(self, _state):
        self.drawn += 1


def test_a_panel_is_drawn_after_a_change_and_when_it_is_shown_again(qtbot):
    panel = shown(qtbot, Counting())
    panel.show_again()
    assert panel.drawn == 0
    for depends, drawn in ((("x",), 1), (("x",), 1), (("y",), 2)):
        panel.depends = depends
        panel.show_state(frame())
        assert panel.drawn == drawn
    panel.show_again()
    assert panel.drawn == 3


@pytest.mark.parametrize("kind", PANEL_TYPES, ids=lambda kind: kind.title)
def test_every_panel_can_be_made_draws_once_and_follows_the_theme(qtbot, kind):
    panel = shown(qtbot, kind(context(part(arm_scene()))))
    times, wrench = np.linspace(90.0, 100.0, 1000), np.ones((1000, 6))
    view = reading(links=(link(),), wrench_s=times, wrench=wrench)
    at = frame(session(1, {3: estimate(3, (0, 0, 0))}, [touch(1)]), view=view, where=arm_scene())
    panel.show_state(at)
    paints = paints_from_now(qtbot, panel)
    for _ in range(20):
        panel.show_state(at)
    qtbot.wait(40)
    assert paints.count == 0
    panel.recolour()
    assert panel.whatsThis()
    assert panel.accessibleName() == kind.title


# Pokes


def test_pokes_are_listed_newest_first_and_keep_the_selection(qtbot):
    panel = shown(qtbot, PokesPanel(context()))
    known = {3: estimate(3, (0, 0, 0))}
    panel.show_state(frame(session(1, known, [touch(1), slip(2)])))
    row = [panel.model.index(1, column).data() for column in range(6)]
    assert row == ["1", "\N{CHECK MARK} accepted", "3", "11.2", "0", "2.0"]
    assert panel.model.index(0, 1).data() == f"\N{BALLOT X} {short_rejection(slip(2))}"
    assert panel.model.index(0, 1).data(Qt.ItemDataRole.ToolTipRole) == approved("now.too_slid", seen_mm=2.1, most_mm=1.5)
    assert panel.tally.text().startswith("2 pokes: 1 accepted, 1 rejected (")
    with qtbot.waitSignal(panel.taxel_wanted) as wanted:
        panel.select(1)
    assert wanted.args == [3]
    panel.show_state(frame(session(2, known, [touch(1), slip(2), touch(3)], excluded=[1])))
    assert panel.selected() == (1,)
    assert panel.model.index(2, 1).data() == "\N{CIRCLED MINUS} excluded"
    assert panel.model.index(0, 0).data() == "3"
    panel.show_state(frame(session(3, pokes=[slip(5)])))
    assert [panel.model.index(r, 0).data() for r in range(panel.model.rowCount())] == ["5"], "another session"


@pytest.mark.parametrize(("count", "excluded"), [(3, [3]), (4, [])], ids=["a poke is excluded", "a poke more"])
def test_cells_that_follow_the_estimates_are_read_again_for_every_poke(qtbot, count, excluded):
    panel = shown(qtbot, PokesPanel(context()))
    pokes = [touch(poke) for poke in (1, 2, 3, 4)]
    panel.show_state(frame(session(1, pokes=pokes[:3])))
    read = set()
    panel.model.dataChanged.connect(
        lambda first, last: read.update(
            (row, column) for row in range(first.row(), last.row() + 1) for column in range(first.column(), last.column() + 1)
        )
    )
    panel.show_state(frame(session(2, {3: estimate(3, (0, 0, 0))}, pokes[:count], excluded)))
    assert read == {(row, column) for row in range(count) for column in range(len(HEADINGS))}


@pytest.mark.parametrize("reason", list(Reason))
def test_every_reason_fits_into_the_list(qtbot, reason):
    panel = shown(qtbot, PokesPanel(context()), (RIGHT_PX, 250))
    panel.show_state(frame(session(2, pokes=[*(touch(n) for n in range(1, 40)), slip(40, reason, 0.0345, 0.001, "m")])))
    index = panel.model.index(0, 1)
    words = index.data()
    assert words.startswith("\N{BALLOT X} ")
    assert panel.table.sizeHintForIndex(index).width() <= panel.table.columnWidth(1), words
    assert REASON_WORDS[reason] in index.data(Qt.ItemDataRole.ToolTipRole)


# Devices


def test_devices_show_rate_losses_and_faults(qtbot):
    panel, chips = shown(qtbot, DevicesPanel()), shown(qtbot, LinkChips(), (300, 24))

    def show(health, now_s):
        at = frame(view=reading(links=(health,), losses_unpaired=2), now_s=now_s)
        panel.show_state(at)
        chips.show_state(at)
        return next(iter(panel.cards.values()))

    card = show(link(address="/dev/ttyUSB0"), 100.1)
    assert card.rate.text() == "1000 Hz"
    assert "/dev/ttyUSB0" in card.about.text()
    assert approved("now.checksum_count", count=3) in card.losses.text()
    assert approved("now.frames_without_wrench", count=2) in card.losses.text()
    good = pixels(card.sign)
    card = show(link(state=LinkState.LOST, text="/dev/ttyUSB0 was lost; plug it in again."), 100.2)
    assert card.detail.text() == "/dev/ttyUSB0 was lost; plug it in again."
    assert changed(good, pixels(card.sign)) > 50
    assert show(link(losses={}), 100.3).losses.text().split("\n")[0].endswith("good, none lost")
    lost = show(link(state=LinkState.LOST, losses={}), 100.4)
    assert lost.rate.text() == "lost"
    assert lost.losses.text().split("\n")[0].endswith("good"), "nothing in the card says the opposite of its state"
    assert show(link(), 105.0).rate.text() == "silent"
    warm = link(beside={TEMPERATURE_NAME: SideReading(30.5, 33.25, 31.0)}, units="Fx Fy Fz in N, Mx My Mz in N m")
    said = show(warm, 200.0).losses.text()
    assert said.startswith(DOT_SEPARATOR.join(("Fx Fy Fz in N, Mx My Mz in N m", "temperature 31.0 degC (30.5 to 33.2)")))
    late = "Poses of the tool come 16 ms later than the skin."
    assert show(link(pose_delay=late), 300.0).losses.text().endswith(late)
    metres, matrix = PoseForm(RotationForm.QUATERNION_XYZW), PoseForm(RotationForm.MATRIX_COLUMNS)
    for sent in (
        SentPose((0.1, -0.2, 0.3, 0.0, 0.0, 0.0, 1.0), metres, 1.0),
        SentPose((*np.eye(4).ravel()[:12].tolist(), 100.0, -200.0, 300.0, 1.0), matrix, 1e-3),
    ):
        assert "tool at (100.0  \N{MINUS SIGN}200.0  300.0) mm" in show(link(sent_pose=sent), 400.0).losses.text()
    with qtbot.waitSignal(panel.command_wanted) as wanted:
        panel.change.click()
    assert wanted.args == ["addresses"]


def test_three_devices_without_losses_fit_into_720_pixels(qtbot):
    panel = shown(qtbot, DevicesPanel(), (428, 260))
    one = link(units="Fx Fy Fz in N, Mx My Mz in N m", losses={})
    links = one, link("skin", units="raw values", losses={}), link("joints", units="joint angles in degrees", losses={})
    panel.show_state(frame(view=reading(links=links)))
    qtbot.wait(20)
    assert len(panel.cards) == 3
    assert all(card.visibleRegion().boundingRect() == card.rect() for card in panel.cards.values())


def test_arm_poses_are_chosen_or_shown_as_they_stream(qtbot):
    scene = arm_scene()
    panel = shown(qtbot, RigPanel(context(part(scene))))
    panel.show_state(frame(session(1, pokes=[touch(1)]), where=scene))
    low, high = panel.arm.rows["low"], panel.arm.rows["high"]
    assert (low.text(1), low.text(2), high.text(2)) == ("0.0", "1", "0")
    with qtbot.waitSignal(panel.action_wanted) as chosen:
        panel.arm.poses.itemClicked.emit(high, 0)
    assert chosen.args == [SetPose("high")]
    panel.show_state(frame(view=reading(links=(link("joints", carries=(Stream.JOINTS,)),)), where=scene))
    with qtbot.assertNotEmitted(panel.action_wanted):
        panel.arm.poses.itemClicked.emit(high, 0)


# Readings


def test_a_rig_without_a_sensor_shows_no_empty_curves(qtbot):
    panel = shown(qtbot, ReadingsPanel(), (420, 360))
    scene = SimpleNamespace(has_sensor=False)
    panel.update_view(SimpleNamespace(scene=scene))
    assert panel.no_sensor.isVisible()
    assert not panel.force.isVisible()
    assert not panel.moment.isVisible()


def test_curves_draw_every_axis_and_stop_with_the_stream(qtbot):
    panel = shown(qtbot, ReadingsPanel(), (420, 360))
    panel.recolour()
    times = np.linspace(90.0, 100.0, 10_000)
    wrench = np.stack([np.sin(times + i) * (5 if i < 3 else 0.3) for i in range(6)], axis=1)
    wrench[5000, 0] = np.nan
    panel.show_state(frame(view=reading(wrench_s=times, wrench=wrench)))
    seen = pixels(panel)
    assert all(ink(seen, axis, 30) > 300 for axis in DARK.axes)
    assert "5." in panel.force.header.text() or "4." in panel.force.header.text()
    paints = paints_from_now(qtbot, panel.force.plot.viewport(), panel.moment.plot.viewport())
    for _ in range(10):
        panel.show_state(frame(view=reading(wrench_s=times, wrench=wrench)))
    qtbot.wait(50)
    assert paints.count == 0


@pytest.mark.parametrize(("height", "side_by_side"), [(250, True), (440, False)])
def test_each_plot_of_the_readings_is_160_pixels_high_on_a_small_screen_too(qtbot, height, side_by_side):
    panel = shown(qtbot, ReadingsPanel(), (428, height))
    qtbot.wait(20)
    assert min(curves.plot.height() for curves in (panel.force, panel.moment)) >= 160
    assert (panel.force.geometry().top() == panel.moment.geometry().top()) is side_by_side
    assert ("<br>" in panel.force.header.text()) is side_by_side
    for curves in (panel.force, panel.moment):
        curves.show_numbers(np.array([-18.66, -2.95, 24.14]))
        assert curves.header.sizeHint().width() <= curves.width()


# Messages


# Tables are copied by Ctrl+C


def copied(bench, view) -> list[list[str]]:
    """Press Ctrl+C in a table and return the cells of a spreadsheet."""
    QApplication.clipboard().setText("")
    view.window().activateWindow()
    view.setFocus()
    bench.until(view.hasFocus, 5000)
    QTest.keyClick(view, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    text = QApplication.clipboard().text()
    assert not text or text.endswith("\n")
    return [line.split("\t") for line in text.splitlines()]


def test_every_table_is_copied_as_it_is_shown(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    workspace, panel = bench.window.session_view.workspace, bench.panel(PokesPanel)
    workspace.show_tab("Pokes")
    whole = copied(bench, panel.table)
    assert whole[0] == ["#", "Outcome", "Taxel", "Force, N", "Tilt, \N{DEGREE SIGN}", "Twist, mm"]
    assert [int(row[0]) for row in whole[1:]] == [record.outcome.poke for record in bench.snapshot.pokes][::-1]
    panel.select(2)
    assert copied(bench, panel.table) == [whole[0], whole[-2]]
    panel.table.selectAll()
    assert copied(bench, panel.table) == whole
    bench.key(Qt.Key.Key_H)
    tables = bench.window.findChildren(QTreeWidget) + bench.window.findChildren(QTableView)
    wanted = {"pokes", "landmarks", "modules", "arm poses", "pokes of the taxel", "history"}
    assert wanted <= {each.accessibleName() for each in tables}
    for view in tables:
        view.show()  # a table without rows is hidden
        workspace.show_tab(next((tab for tab, each in workspace.panels.items() if each.isAncestorOf(view)), ""))
        assert copied(bench, view)[0] == rows_text(view).splitlines()[0].split("\t"), view.accessibleName()
    bench.window.findChild(HistoryDialog).reject()


@pytest.mark.usefixtures("qapp")
def test_a_name_with_a_tab_stays_one_cell():
    view = table("names", ("Name", "Off by, mm"))
    put_rows(view, [("wrist\ttop\n", "1.3")])
    assert rows_text(view) == "Name\tOff by, mm\nwrist?top?\t1.3\n"


# Recent sessions


@pytest.mark.usefixtures("qapp")
def test_recent_sessions_are_kept_by_plain_names_and_missing_ones_are_dropped(tmp_path):
    settings = QSettings("skincal", "test")
    menu = RecentMenu(settings)

    def names() -> list[str]:
        menu.fill()
        return [action.text() for action in menu.actions()]

    folders = [tmp_path / f"s{number}" for number in range(MAX_SESSIONS + 2)]
    for folder in folders:
        folder.mkdir()
        menu.remember(folder)
    assert names() == [f"&{n % 10}  s{MAX_SESSIONS + 2 - n}" for n in range(1, MAX_SESSIONS + 1)]
    folders[5].rmdir()
    assert "s5" not in "".join(names())
    assert len(settings.value(RECENT_SETTING)) == MAX_SESSIONS - 1
    for folder in folders:
        if folder.exists():
            folder.rmdir()
    assert names() == ["None yet"]
    stranger = tmp_path / "<b>R&D\tCtrl+Q"
    stranger.mkdir()
    menu.remember(stranger)
    assert names() == ["&1  <b>R&&D?Ctrl+Q"]
    assert "&lt;b&gt;" in menu.actions()[0].toolTip()


@pytest.mark.usefixtures("qapp")
def test_recent_sessions_name_their_parts_also_beside_those_of_older_settings(tmp_path):
    settings = QSettings("skincal", "test")
    for name in ("old", "new", "kept"):
        (tmp_path / name).mkdir()
    settings.setValue(RECENT_SETTING, [str(tmp_path / "old")])
    menu = RecentMenu(settings)
    menu.remember(tmp_path / "new", "left & right\tpalm")
    menu.remember(tmp_path / "kept", "forearm")
    menu.remember(tmp_path / "kept")
    menu.fill()
    texts = [action.text() for action in menu.actions()]
    assert texts == ["&1  kept   forearm", "&2  new   left && right?palm", "&3  old"]
    (tmp_path / "kept").rmdir()
    menu.fill()
    assert [action.text() for action in menu.actions()] == ["&1  new   left && right?palm", "&2  old"]
