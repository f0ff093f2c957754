"""Sounds in the whole window: what a poke is heard as, the key that mutes, and a machine without a sound device."""

from __future__ import annotations

from PySide6.QtCore import QSettings, Qt

from app.session.opening import OpenRequest
from app.sound.player import NoSoundError, Player
from tests.app.whole_window import Bench
from tests.approved import approved


def test_a_poke_is_heard_in_its_order_and_muting_ends_it(bench):
    bench.open_served("flat-patch")
    action = bench.window.commands.actions["sounds"]
    assert action.isEnabled()
    assert action.isChecked()

    def is_a_whole_poke_heard():
        # A busy machine leaves out sounds that are late.
        heard = " ".join(name for name, _ in bench.player.played)
        return "CONTACT HELD ACCEPTED" in heard or "CONTACT HELD DONE" in heard

    bench.until(is_a_whole_poke_heard, 100_000)
    bench.key(Qt.Key.Key_M)
    assert not action.isChecked()
    bench.player.played.clear()
    pokes = len(bench.accepted())
    bench.until(lambda: len(bench.accepted()) > pokes)
    assert bench.player.played == []


def test_mute_and_speech_are_remembered(bench, qtbot, tmp_path):
    assert bench.player.on
    assert not bench.player.speaks
    bench.key(Qt.Key.Key_M)
    bench.key(Qt.Key.Key_M, Qt.KeyboardModifier.ShiftModifier)
    assert (bench.player.on, bench.player.speaks) == (False, True)
    bench.window.close()
    QSettings("skincal", "test").sync()
    other = Bench(qtbot, tmp_path / "again")
    assert (other.player.on, other.player.speaks) == (False, True)
    other.key(Qt.Key.Key_M)
    assert other.player.on
    other.window.close()


def test_no_sound_device_disables_the_entry_with_the_reason_and_nothing_else(qtbot, tmp_path, recorded):
    def nothing():
        raise NoSoundError("no sound device")

    bench = Bench(qtbot, tmp_path, Player(nothing, speech=("true",)))
    sounds, speech = (bench.window.commands.actions[name] for name in ("sounds", "speech"))
    assert sounds.isEnabled(), "nothing is known before a session is open"
    bench.open(OpenRequest(session=recorded))
    bench.until(lambda: not sounds.isEnabled(), 5000)
    assert sounds.text() == approved("sound.in_menu", reason="no sound device")
    assert not speech.isEnabled()
    assert not [m for m in bench.messages if m.error]
    bench.window.close()
