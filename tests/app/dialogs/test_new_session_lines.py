"""The last line of a link without readings in the dialog for a new session, with what is understood of it coloured."""

import sys

import pytest

from app.dialogs.new_session import NewSessionDialog, line_markup
from app.session.opening import OpenRequest
from app.theme import DARK, LIGHT
from skincal.model.readings import Stream
from skincal.model.scene import resource
from skincal.streams.decoders.line_parts import PartKind, split_parts
from tests.approved import approved

WAIT_MS = 30_000
PRINTER = "import time\nwhile True:\n    print({line!r}, flush=True)\n    time.sleep(0.02)\n"


@pytest.mark.parametrize(
    ("line", "values", "names", "unknown"),
    [
        ("T0:1,T1:2;x", ["1", "2"], ["T0", "T1"], ["x"]),
        ("I (1200) skin: 1,2 3.5e2", ["1", "2", "3.5e2"], [], []),
        ("r0c0=12 x1=13", ["12", "13"], ["r0c0", "x1"], []),
        ("x0y0=12", ["12"], [], ["x0y0"]),
        ("1F 02 0A", ["1F", "02", "0A"], [], []),
        ("$SKIN;1;2*ZZ", ["1", "2"], [], ["$SKIN", "*ZZ"]),
        ('{"skin": "1 2"}', ["1", "2"], ["skin"], []),
        (f"{'1,' * 28}T...", ["1"] * 28, [], []),
        ("<b>booting</b>", [], [], ["<b>booting</b>"]),
    ],
)
def test_parts_of_a_line(line, values, names, unknown):
    parts = split_parts(line)
    assert "".join(part.text for part in parts) == line
    for kind, expected in ((PartKind.VALUE, values), (PartKind.NAME, names), (PartKind.UNKNOWN, unknown)):
        assert [part.text for part in parts if part.kind is kind] == expected


@pytest.mark.usefixtures("qapp")
def test_a_line_is_shown_as_it_is_and_coloured():
    markup = line_markup("T0:1 <b>")
    assert markup.startswith("Last line (1 number, 1 name, 1 unknown part):")
    assert "&lt;b&gt;" in markup
    assert any(f"color:{colours.accent}; font-weight:bold" in markup for colours in (DARK, LIGHT))
    assert line_markup("") == ""


def test_the_last_line_of_a_link_without_readings_is_shown_and_hidden_with_readings(qtbot, tmp_path):
    line = "T0: 1,5 T1: 2,5 T2: 3,5"
    for name, text in (("unread", line), ("read", ",".join(map(str, range(64))))):
        (tmp_path / f"{name}.py").write_text(PRINTER.format(line=text), encoding="utf-8")
    dialog = NewSessionDialog(OpenRequest(scene=resource("scenes/flat-patch/scene.toml"), folder=tmp_path / "new"))
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.open()
    row = dialog.rows[Stream.SKIN]
    assert not row.line.isVisible()
    row.set_address(f'run:"{sys.executable}" "{tmp_path / "unread.py"}"', agreed=True)
    row.agree()
    qtbot.waitUntil(row.line.isVisible, timeout=WAIT_MS)
    nearest = "T0:1,00;T1:2,00;T2:3,00;T3:4,00"
    assert row.verdict.text() == approved("links.no_reading_nearest", nearest=nearest)
    assert row.line.text() == line_markup(line)
    assert row.field.accessibleDescription().endswith(f"Last line: {line}")
    row.set_address(f'run:"{sys.executable}" "{tmp_path / "read.py"}"', agreed=True)
    row.agree()
    qtbot.waitUntil(lambda: not row.line.isVisible() and row.verdict.text().startswith("good"), timeout=WAIT_MS)
    dialog.reject()
