"""Each panel on a real (virtual) display: what its pixels and its words do, and that it draws nothing for nothing."""

from __future__ import annotations

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QObject, Qt, QTimer
from PySide6.QtGui import QColor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QComboBox, QDoubleSpinBox, QLineEdit, QSpinBox, QWidget

from app.dialogs.export_dialog import ExportDialog
from app.dialogs.form_widgets import shipped_scenes
from app.dialogs.new_session import NewSessionDialog
from app.panels.devices import DevicesPanel, LinkChips
from app.panels.inspect_panel import InspectPanel
from app.panels.message_bar import MessageBar
from app.panels.now_panel import NowPanel
from app.panels.plot_panels import PlotPanel, ReadingsPanel
from app.panels.plots import CurvesPanel
from app.panels.pokes_panel import HEADINGS, PokesPanel
from app.panels.rig_panel import ArmPanel
from app.panels.taxel_map import TaxelMap
from app.panels.widgets import Painted, theme_colours
from app.session_view import RIGHT_PX
from app.state.running import Running
from app.text.guidance_text import BETWEEN
from app.text.message import Message
from app.theme import DARK, LIGHT, Choice, Colours
from app.window import Theme, qpalette, style_sheet
from skincal.contacts.outcome import PressPhase, Reason
from skincal.files.formats import ExportFormat
from skincal.model.readings import TEMPERATURE, LinkState, SideReading, Stream
from skincal.taxels.result import Method
from skincal.words.poke_words import REASON_WORDS
from tests.app.scene3d_support import estimate
from tests.app.window_support import (
    NAMES,
    PLAN,
    SCENE,
    arm_scene,
    changed,
    frame,
    link,
    pixels,
    reading,
    session,
    show_in,
    slip,
    touch,
)
from tests.approved import approved

BOTH = (Method.SURFACE, Method.FREE)


class Paints(QObject):
    """Counts how often a widget is painted."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__()
        self.count = 0
        widget.installEventFilter(self)

    def eventFilter(self, _watched, event):
        self.count += event.type() == QEvent.Type.Paint
        return False


def shown(qtbot, widget, size=(420, 300)):
    show_in(DARK)
    widget.resize(*size)
    qtbot.addWidget(widget)
    with qtbot.waitExposed(widget):
        widget.show()
    return widget


def test_a_widget_survives_twenty_thousand_updates(qtbot):
    """Some Qt bindings lose a reference to None in every void call and abort the program within seconds."""
    widget = shown(qtbot, QWidget(), (50, 50))
    for _ in range(20_000):
        widget.update()
    qtbot.wait(1)
    assert widget.isVisible()


def luminance(colour: str | QColor) -> float:
    parts = np.array(QColor(colour).getRgbF()[:3])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def contrast(ink: str | QColor, ground: str) -> float:
    high, low = sorted([luminance(ink), luminance(ground)], reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("colours", [DARK, LIGHT], ids=["dark", "light"])
def test_text_can_be_read_on_everything_it_stands_on(colours: Colours):
    for ink in (colours.text, colours.muted, colours.accent, colours.bad, colours.warn, *colours.axes):
        for ground in (colours.window, colours.panel):
            assert contrast(ink, ground) >= 4.5, (ink, ground)
    assert contrast(colours.accent, colours.on_accent) >= 4.5


@pytest.mark.parametrize(("choice", "colours"), [(Choice.DARK, DARK), (Choice.LIGHT, LIGHT)], ids=["dark", "light"])
@pytest.mark.parametrize("kind", [QLineEdit, QComboBox, QSpinBox, QDoubleSpinBox])
def test_the_border_of_a_field_is_seen(qtbot, choice, colours, kind):
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


def test_now_says_what_happens_and_the_ring_fills(qtbot):
    panel = shown(qtbot, NowPanel(), (700, 80))
    panel.begin(session())
    panel.show_state(frame(view=reading(PressPhase.PRESSING, 8.0, still=0.1)))
    assert panel.headline.text() == "Hold still"
    little = pixels(panel.sign)
    panel.show_state(frame(view=reading(PressPhase.STILL, 8.0, still=0.9)))
    assert changed(little, pixels(panel.sign)) > 200
    gauge = pixels(panel.gauge)
    panel.show_state(frame(view=reading(PressPhase.STILL, 14.0, still=0.9)))
    assert changed(gauge, pixels(panel.gauge)) > 200
    panel.show_state(frame(session(2, pokes=[slip(1)]), reading(PressPhase.TARING)))
    assert panel.result.text().endswith(approved("now.rejected_slid", poke=1, seen_mm=2.1, most_mm=1.5))
    bad = QColor(DARK.bad).getRgb()[:3]
    assert (pixels(panel)[..., :3] == bad).all(axis=2).sum() > 100


def test_while_no_device_is_read_no_force_is_told(qtbot):
    panel = shown(qtbot, NowPanel(), (900, 160))
    pictures = []
    for running, force in ((Running.STREAMING, 0.0), (Running.PAUSED, 8.0), (Running.STREAMING, 8.0)):
        panel.show_state(frame(view=reading(PressPhase.STILL, force), running=running))
        pictures.append(pixels(panel.gauge))
    assert changed(pictures[0], pictures[1]) == 0
    assert changed(pictures[1], pictures[2]) > 200


def test_which_part_has_the_focus_is_seen(qtbot):
    """Around the map and around a panel that scrolls."""
    first = shown(qtbot, TaxelMap(SCENE, PLAN.channels, NAMES))
    panel = shown(qtbot, InspectPanel(BOTH, NAMES))
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


def test_the_same_frame_draws_nothing(qtbot):
    at = frame(session(1, {3: estimate(3, (0, 0, 0))}, [touch(1)]), view=reading(links=(link(),)))
    panels = [
        NowPanel(), TaxelMap(SCENE, PLAN.channels, NAMES), PokesPanel(NAMES), InspectPanel(BOTH, NAMES), DevicesPanel(),
    ]  # fmt: skip
    for panel in panels:
        shown(qtbot, panel)
        panel.show_state(at)
        qtbot.wait(30)
    watched = [child for panel in panels for child in (panel, *panel.findChildren(QWidget))]
    paints = [Paints(widget) for widget in watched]
    for _ in range(20):
        for panel in panels:
            panel.show_state(at)
    qtbot.wait(30)
    assert sum(paint.count for paint in paints) == 0


def test_pokes_are_listed_newest_first_and_keep_the_selection(qtbot):
    panel = shown(qtbot, PokesPanel(NAMES))
    known = {3: estimate(3, (0, 0, 0))}
    panel.show_state(frame(session(1, known, [touch(1), slip(2)])))
    row = [panel.model.index(1, column).data() for column in range(6)]
    assert row == ["1", "\N{CHECK MARK} accepted", "10-03", "11.2", "0", "2.0"]
    assert panel.model.index(0, 1).data() == "\N{BALLOT X} slid 2.1 mm"
    assert panel.model.index(0, 1).data(Qt.ItemDataRole.ToolTipRole) == approved("now.too_slid", seen_mm=2.1, most_mm=1.5)
    assert panel.tally.text() == "2 pokes, 1 rejected (slid: 1)"
    with qtbot.waitSignal(panel.taxel_wanted) as wanted:
        panel.select(1)
    assert wanted.args == [3]
    panel.show_state(frame(session(2, known, [touch(1), slip(2), touch(3)], excluded=[1])))
    assert panel.selected() == (1,)
    assert panel.model.index(2, 1).data() == "\N{CIRCLED MINUS} excluded"
    assert panel.model.index(0, 0).data() == "3"


@pytest.mark.parametrize(("count", "excluded"), [(3, [3]), (4, [])], ids=["a poke is excluded", "a poke more"])
def test_what_follows_the_estimates_is_read_anew_for_every_poke(qtbot, count, excluded):
    panel = shown(qtbot, PokesPanel(NAMES))
    pokes = [touch(poke) for poke in (1, 2, 3, 4)]
    panel.show_state(frame(session(1, pokes=pokes[:3])))
    changed = set()
    panel.model.dataChanged.connect(
        lambda first, last: changed.update(
            (row, column) for row in range(first.row(), last.row() + 1) for column in range(first.column(), last.column() + 1)
        )
    )
    panel.show_state(frame(session(2, {3: estimate(3, (0, 0, 0))}, pokes[:count], excluded)))
    assert changed == {(row, column) for row in range(count) for column in range(len(HEADINGS))}


@pytest.mark.parametrize("reason", list(Reason))
def test_every_reason_can_be_read_in_the_list_as_wide_as_the_window_makes_it(qtbot, reason):
    panel = shown(qtbot, PokesPanel(NAMES), (RIGHT_PX, 250))
    panel.show_state(frame(session(2, pokes=[*(touch(n) for n in range(1, 40)), slip(40, reason, 0.0345, 0.001, "m")])))
    index = panel.model.index(0, 1)
    words = index.data()
    assert words.startswith("\N{BALLOT X} ")
    assert panel.table.sizeHintForIndex(index).width() <= panel.table.columnWidth(1), words
    assert REASON_WORDS[reason] in index.data(Qt.ItemDataRole.ToolTipRole), "in full where the pointer is"


def test_another_session_replaces_the_list(qtbot):
    panel = shown(qtbot, PokesPanel(NAMES))
    panel.show_state(frame(session(1, pokes=[touch(1), touch(2)])))
    panel.show_state(frame(session(2, pokes=[slip(5)])))
    assert [panel.model.index(r, 0).data() for r in range(panel.model.rowCount())] == ["5"]


def test_inspect_shows_both_methods_the_reason_and_who_needs_pokes(qtbot):
    panel = shown(qtbot, InspectPanel(BOTH, NAMES), (420, 500))
    at = session(1, {3: estimate(3, (0.001, 0.002, 0.003))}, dead={4: "stuck at 255"})
    panel.show_state(frame(at, selected=3))
    assert panel.cells[Method.FREE][0].text() == "1.0  2.0  3.0"
    assert panel.cells[Method.FREE][3].text() == "1.0 mm"
    assert "apart" in panel.reason.text()
    assert panel.worst.item(0).text().endswith("not pressed yet")
    with qtbot.waitSignal(panel.mark_dead_requested) as asked:
        QTest.mouseClick(panel.use, Qt.MouseButton.LeftButton)
    assert asked.args == [3]
    panel.show_state(frame(at, selected=4))
    assert panel.reason.text() == "stuck at 255"
    with qtbot.waitSignal(panel.revive_requested) as back:
        QTest.mouseClick(panel.use, Qt.MouseButton.LeftButton)
    assert back.args == [4]
    with qtbot.waitSignal(panel.taxel_wanted):
        panel.worst.itemActivated.emit(panel.worst.item(2))


def test_devices_show_rate_losses_and_what_is_wrong(qtbot):
    panel, chips = shown(qtbot, DevicesPanel()), shown(qtbot, LinkChips(), (300, 24))

    def show(health, now_s):
        at = frame(view=reading(links=(health,), losses_unpaired=2), now_s=now_s)
        panel.show_state(at)
        chips.show_state(at)
        return panel.cards["wrench"]

    card = show(link(address="/dev/ttyUSB0"), 100.1)
    assert card.rate.text() == "1000 Hz"
    assert "/dev/ttyUSB0" in card.about.text()
    assert approved("now.checksum_count", count=3) in card.losses.text()
    assert approved("now.frames_without_wrench", count=2) in card.losses.text()
    good = pixels(card.sign)
    card = show(link(state=LinkState.LOST, text="/dev/ttyUSB0 vanished; plug it in again."), 100.2)
    assert card.detail.text() == "/dev/ttyUSB0 vanished; plug it in again."
    assert changed(good, pixels(card.sign)) > 50
    card = show(link(), 105.0)
    assert card.rate.text() == "silent"


@pytest.mark.parametrize(("height", "beside"), [(250, True), (440, False)])
def test_each_plot_of_the_readings_is_160_pixels_high_on_a_small_screen_too(qtbot, height, beside):
    panel = shown(qtbot, CurvesPanel(), (428, height))
    qtbot.wait(20)
    assert min(curves.plot.height() for curves in (panel.force, panel.moment)) >= 160
    assert (panel.force.geometry().top() == panel.moment.geometry().top()) is beside
    assert ("<br>" in panel.force.header.text()) is beside
    for curves in (panel.force, panel.moment):
        curves.show_numbers(np.array([-18.66, -2.95, 24.14]))
        assert curves.header.sizeHint().width() <= curves.width()


def test_three_devices_without_losses_are_seen_whole_at_720_pixels(qtbot):
    panel = shown(qtbot, DevicesPanel(), (428, 260))
    one = link(units="Fx Fy Fz in N, Mx My Mz in N m", losses={})
    links = one, link("skin", units="raw values", losses={}), link("joints", units="joint angles in degrees", losses={})
    panel.show_state(frame(view=reading(links=links)))
    qtbot.wait(20)
    assert len(panel.cards) == 3
    assert all(card.visibleRegion().boundingRect() == card.rect() for card in panel.cards.values())


def test_devices_show_what_a_sensor_measures_beside_its_readings(qtbot):
    panel = shown(qtbot, DevicesPanel())
    warm = link(beside={TEMPERATURE: SideReading(30.5, 33.25, 31.0)}, units="Fx Fy Fz in N, Mx My Mz in N m")
    for health, expected in ((link(), False), (warm, True)):
        panel.show_state(frame(view=reading(links=(health,)), now_s=200.0 + expected))
        said = panel.cards["wrench"].losses.text()
        beside = ("Fx Fy Fz in N, Mx My Mz in N m", "temperature 31.0 degC (30.5 to 33.2)", "5")
        assert said.startswith(BETWEEN.join(beside)) is expected


def test_arm_poses_are_chosen_or_shown_as_they_stream(qtbot):
    scene = arm_scene()
    panel = shown(qtbot, ArmPanel(scene.arm))
    panel.show_state(frame(session(1, pokes=[touch(1)]), where=scene))
    low, high = panel.rows["low"], panel.rows["high"]
    assert (low.text(1), low.text(2), high.text(2)) == ("0.0", "1", "0")
    with qtbot.waitSignal(panel.pose_requested) as chosen:
        panel.poses.itemClicked.emit(high, 0)
    assert chosen.args == ["high"]
    joints = link("joints", carries=(Stream.JOINTS,))
    panel.show_state(frame(view=reading(links=(joints,)), where=scene))
    with qtbot.assertNotEmitted(panel.pose_requested):
        panel.poses.itemClicked.emit(high, 0)


def test_curves_draw_every_axis_and_stop_with_the_stream(qtbot):
    panel = shown(qtbot, CurvesPanel(), (420, 320))
    panel.recolour()
    times = np.linspace(90.0, 100.0, 10_000)
    wrench = np.stack([np.sin(times + i) * (5 if i < 3 else 0.3) for i in range(6)], axis=1)
    wrench[5000, 0] = np.nan
    panel.show_state(frame(view=reading(wrench_s=times, wrench=wrench)))
    seen = pixels(panel)[..., :3].astype(int)
    for axis in DARK.axes:
        near = np.abs(seen - QColor(axis).getRgb()[:3]).sum(axis=2) < 60
        assert near.sum() > 300
    assert "5." in panel.force.header.text() or "4." in panel.force.header.text()
    paints = [Paints(widget) for widget in (panel.force.plot.viewport(), panel.moment.plot.viewport())]
    qtbot.wait(50)
    before = [paint.count for paint in paints]
    for _ in range(10):
        panel.show_state(frame(view=reading(wrench_s=times, wrench=wrench)))
    qtbot.wait(50)
    assert [paint.count for paint in paints] == before


def test_errors_stay_until_they_are_read_and_news_goes_by_itself(qtbot):
    bar = shown(qtbot, MessageBar(), (500, 40))
    bar.show_newest()
    assert not bar.isVisible()
    bar.tell(Message("The disk is full.", error=True))
    bar.tell(Message("Written."))
    assert "Written." in bar.text.text()
    bar.findChild(QTimer).timeout.emit()
    assert "The disk is full." in bar.text.text()
    bar.findChild(QTimer).timeout.emit()
    assert bar.isVisible()
    QTest.mouseClick(bar.close_button, Qt.MouseButton.LeftButton)
    assert not bar.isVisible()
    bar.stop()


def test_a_message_begins_with_the_sign_of_its_kind(qtbot):
    bar = shown(qtbot, MessageBar(), (500, 40))
    kinds = ({"error": True}, {"asks": True}, {"found": True}, {})
    signs = []
    for kind in kinds:
        bar.tell(Message("It is so.", **kind))
        signs.append(bar.text.text().split()[0])
    assert signs == ["\N{BALLOT X}", "\N{RIGHTWARDS ARROW}", "\N{BULLET}", "\N{CHECK MARK}"]
    bar.stop()


def test_export_asks_for_format_method_and_place_and_shows_what_was_found(qtbot, tmp_path):
    dialog = shown(qtbot, ExportDialog(BOTH, Method.FREE, tmp_path / "part"))
    assert dialog.path.text() == str(tmp_path / "part-free.txt")
    assert [dialog.format.itemData(row) for row in range(dialog.format.count())] == list(ExportFormat)
    dialog.format.setCurrentIndex(list(ExportFormat).index(ExportFormat.MJCF))
    assert dialog.path.text() == str(tmp_path / "part-free.xml")
    dialog.format.setCurrentIndex(1)
    assert dialog.path.text() == str(tmp_path / "part.json")
    assert not dialog.method.isEnabled()
    with qtbot.waitSignal(dialog.write_requested) as asked:
        QTest.mouseClick(dialog.start, Qt.MouseButton.LeftButton)
    assert asked.args == ["json", tmp_path / "part.json", Method.FREE]
    dialog.show_written(("3 taxels have no position",))
    assert "1 remark" in dialog.outcome.text()
    assert dialog.remarks.item(0).text() == "3 taxels have no position"
    dialog.show_failure("cannot be written")
    assert dialog.outcome.text().startswith("\N{BALLOT X}")


@pytest.mark.parametrize("change", ["format", "method", "path"])
def test_what_was_written_is_not_said_of_what_would_be_written_next(qtbot, tmp_path, change):
    dialog = shown(qtbot, ExportDialog(BOTH, Method.FREE, tmp_path / "part"))
    QTest.mouseClick(dialog.start, Qt.MouseButton.LeftButton)
    dialog.show_written(("3 taxels have no position",))
    assert "Written to" in dialog.outcome.text()
    if change == "path":
        QTest.keyClicks(dialog.path, "x")
    else:
        box = getattr(dialog, change)
        box.setCurrentIndex(1 - box.currentIndex())
    assert dialog.outcome.text() == ""
    assert not dialog.remarks.isVisible()


def test_a_new_session_is_checked_before_it_starts(qtbot, tmp_path):
    dialog = shown(qtbot, NewSessionDialog(None, tmp_path / "new"))
    # It is closed here, and once more by the fixture.
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, False)
    assert len(shipped_scenes()) >= 3
    dialog.fields["wrench"].setText("/dev/ttyUSB0")
    with qtbot.assertNotEmitted(dialog.request_chosen):
        dialog.buttons.accepted.emit()
    assert "No skin device" in dialog.objection.text()
    dialog.fields["skin"].setText("spy:///dev/ttyACM0?file=x")
    with qtbot.assertNotEmitted(dialog.request_chosen):
        dialog.buttons.accepted.emit()
    assert approved("links.refused_scheme_clause", scheme="spy") in dialog.objection.text()
    dialog.fields["skin"].setText("/dev/ttyACM0")
    with qtbot.waitSignal(dialog.request_chosen) as chosen:
        dialog.buttons.accepted.emit()
    plan = chosen.args[0]
    assert (plan.addresses.wrench, plan.addresses.skin, plan.folder) == ("/dev/ttyUSB0", "/dev/ttyACM0", tmp_path / "new")


def test_a_panel_that_only_its_subclasses_make_whole_cannot_be_made_itself(qtbot):
    for kind in (Painted, PlotPanel):
        with pytest.raises(TypeError, match="is made by its subclasses"):
            kind()
    qtbot.addWidget(ReadingsPanel())
