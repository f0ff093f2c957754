"""The page of a poke's thresholds, by keys: what it says, what it refuses, and what a change does to the pokes that follow."""

from __future__ import annotations

from dataclasses import fields, replace

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit

from app.dialogs.thresholds_dialog import ThresholdsDialog
from app.session.opening import OpenRequest
from skincal.contacts.outcome import Reason, Rejection
from skincal.contacts.thresholds import ThresholdUse
from skincal.model.actions import SetThresholds
from skincal.model.scene import ContactSettings
from skincal.session.replay import load, replay
from skincal.words.threshold_words import THRESHOLD_WORDS, objections, shown_value, typed_value, use_words
from tests.app.test_commands import dialog_of, tap
from tests.app.window_support import changed, pixels
from tests.approved import approved
from tests.skincal.poke_script import outcome_key

Key = Qt.Key
SHIFT = Qt.KeyboardModifier.ShiftModifier


def page(bench) -> ThresholdsDialog:
    bench.key(Key.Key_H, SHIFT)
    return dialog_of(bench, ThresholdsDialog)


def type_into(bench, dialog, name, text) -> None:
    """Go to a field by the Tab key and type; what stood there is selected, and goes."""
    for _ in range(40):
        if dialog.focusWidget() is dialog.rows[name].field:
            break
        tap(bench, Key.Key_Tab)
    field = dialog.focusWidget()
    assert field is dialog.rows[name].field
    field.selectAll()
    QTest.keyClicks(field, text)


def test_each_threshold_has_its_words_and_its_value_comes_back():
    settings = ContactSettings()
    assert set(THRESHOLD_WORDS) == {item.name for item in fields(ContactSettings)}
    for name in THRESHOLD_WORDS:
        value = getattr(settings, name)
        assert typed_value(name, shown_value(name, value)) == value
    assert shown_value("pitch_max", 0.008) == "8"
    assert typed_value("still_change", "7,5") == 0.075
    assert typed_value("force_min", "1_0") != typed_value("force_min", "1_0")


def test_values_that_no_rig_has_are_refused_at_their_field():
    good = {name: float(getattr(ContactSettings(), name)) for name in THRESHOLD_WORDS}
    assert objections(good) == {}
    for name, value, sentence in (
        ("slide_max", -0.001, approved("thresholds.above", unit="in mm")),
        ("force_max", float("nan"), approved("thresholds.above", unit="in N")),
        ("gap_factor", float("inf"), approved("thresholds.above", unit="in spacings")),
        ("quiet_s", 61.0, approved("thresholds.seconds")),
        ("taxels_max", 2.5, approved("thresholds.whole")),
        ("force_min", 15.0, approved("thresholds.rising", most="15 N", title="most force")),
        ("release_force", 1.0, approved("thresholds.rising", most="1 N", title="a poke begins above")),
    ):
        assert objections(good | {name: value}) == {name: sentence}


@pytest.mark.parametrize(
    ("name", "use", "words"),
    [
        ("pitch_max", ThresholdUse(0, 0, ()), "No poke yet."),
        ("pitch_max", ThresholdUse(10, 3, (0.0021, 0.0093, 0.004)), "Last 10 pokes: 2.1 to 9.3 mm, 3 rejected by it."),
        ("taxels_max", ThresholdUse(1, 0, (2.0,)), "Last 1 poke: 2, none rejected by it."),
        ("still_change", ThresholdUse(4, 1, (0.081,)), "Last 4 pokes: 8.1 %, 1 rejected by it."),
        ("gap_factor", ThresholdUse(4, 1, ()), "Last 4 pokes: 1 rejected by it."),
    ],
)
def test_what_is_said_of_the_newest_pokes(name, use, words):
    assert use_words(name, use) == words


def test_a_threshold_is_changed_by_keys_undone_and_put_back(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    scene, pokes = bench.window.session_view.workspace.part.scene.contacts, len(bench.snapshot.pokes)
    dialog = page(bench)
    assert isinstance(QApplication.focusWidget(), QLineEdit)
    assert dialog.rows["force_min"].field.hasFocus()
    assert all(row.used.text().startswith(f"Last {min(10, pokes)} poke") for row in dialog.rows.values())
    assert not dialog.use.isEnabled()
    before = pixels(dialog)
    type_into(bench, dialog, "pitch_max", "12,5")
    assert changed(before, pixels(dialog))
    tap(bench, Key.Key_Return)
    in_use = replace(scene, pitch_max=0.0125)
    assert bench.snapshot.decisions.thresholds == in_use
    assert bench.window.session_view.state.scene.contacts == in_use
    assert dialog.rows["pitch_max"].field.text() == "12.5"
    assert (dialog.use.isEnabled(), dialog.back.isEnabled()) == (False, True)
    tap(bench, Key.Key_Escape)

    bench.key(Key.Key_Z, Qt.KeyboardModifier.ControlModifier)
    assert bench.snapshot.decisions.thresholds == scene
    bench.key(Key.Key_Y, Qt.KeyboardModifier.ControlModifier)
    dialog = page(bench)
    assert dialog.rows["pitch_max"].field.text() == "12.5"
    while dialog.focusWidget() is not dialog.back:
        tap(bench, Key.Key_Tab)
    tap(bench, Key.Key_Space)
    assert bench.snapshot.decisions.thresholds == scene
    assert dialog.rows["pitch_max"].field.text() == shown_value("pitch_max", scene.pitch_max)
    assert not dialog.back.isEnabled()
    folder = bench.controller.folder
    bench.recording.pipeline.sync()
    assert load(folder).session.decisions.thresholds == scene
    assert load(folder).session.snapshot().can_undo == "return to the scene's thresholds"
    what_is_wrong_is_said_at_the_field_and_nothing_is_changed(bench, dialog)


def what_is_wrong_is_said_at_the_field_and_nothing_is_changed(bench, dialog):
    asked: list[SetThresholds] = []
    dialog.thresholds_wanted.connect(asked.append)
    row = dialog.rows["tare_change_max"]
    assert not row.objection.isVisible()
    type_into(bench, dialog, "tare_change_max", "little")
    assert row.objection.isVisible()
    assert approved("thresholds.above", unit="in N") in row.objection.text()
    type_into(bench, dialog, "quiet_s", "0")
    dialog.rows["force_min"].field.setFocus()
    tap(bench, Key.Key_Return)
    assert dialog.focusWidget() is dialog.rows["quiet_s"].field, "the first field that is wrong"
    top = dialog.rows["quiet_s"].objection.mapTo(dialog.area.viewport(), dialog.rows["quiet_s"].objection.rect().topLeft())
    assert 0 <= top.y() < dialog.area.viewport().height()
    assert asked == []
    assert bench.snapshot.decisions.thresholds == bench.window.session_view.workspace.part.scene.contacts
    type_into(bench, dialog, "tare_change_max", "2")
    assert not row.objection.isVisible()


def test_every_field_has_a_name_with_its_unit_for_a_screen_reader(qtbot):
    dialog = ThresholdsDialog(ContactSettings())
    qtbot.addWidget(dialog)
    names = {name: row.field.accessibleName() for name, row in dialog.rows.items()}
    assert len(set(names.values())) == len(names)
    assert names["slide_max"].endswith(", mm")
    assert all(row.field.accessibleDescription() for row in dialog.rows.values())


def test_a_rig_without_a_force_sensor_has_no_field_of_a_force(qtbot):
    dialog = ThresholdsDialog(ContactSettings(), has_sensor=False)
    qtbot.addWidget(dialog)
    assert set(dialog.rows) == {
        "still_s", "slide_max", "taxels_max", "response_min", "response_noises", "response_share", "gap_factor", "quiet_s",
    }  # fmt: skip
    assert "tip" in dialog.rows["slide_max"].field.accessibleName()
    dialog.rows["still_s"].field.setText("0.5")
    dialog._edited()
    with qtbot.waitSignal(dialog.thresholds_wanted) as wanted:
        dialog.use.click()
    assert wanted.args[0].names == ("still_s",)


def test_pokes_that_follow_are_judged_by_it_and_the_session_opens_the_same(bench, tmp_path):
    """Real bytes of a simulated rig: its hand pushes with some 8 N."""
    bench.open_served("flat-patch", folder=tmp_path / "s")
    bench.until(lambda: bool(bench.accepted()))
    dialog = page(bench)
    type_into(bench, dialog, "force_min", "14.5")
    tap(bench, Key.Key_Return)
    last = bench.snapshot.pokes[-1].outcome.poke

    def rejected() -> list[Rejection]:
        late = [record.outcome for record in bench.snapshot.pokes if record.outcome.poke > last + 1]
        return [outcome for outcome in late if isinstance(outcome, Rejection) and outcome.reason is Reason.TOO_SOFT]

    bench.until(lambda: bool(rejected()))
    assert rejected()[0].limit == 14.5
    bench.until(lambda: " rejected by it" in dialog.rows["force_min"].used.text().replace("none rejected", ""))
    bench.controller.pause()
    bench.until_all_is_taken_in()
    bench.recording.pipeline.sync()
    lived = [outcome_key(record.outcome) for record in bench.recording.pipeline.snapshot().pokes if record.outcome.final]
    for opened in (load(tmp_path / "s"), replay(tmp_path / "s")):
        assert opened.session.decisions.thresholds.force_min == 14.5
        assert [outcome_key(record.outcome) for record in opened.snapshot().pokes][: len(lived)] == lived
