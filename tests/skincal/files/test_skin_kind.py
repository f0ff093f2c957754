"""What the skin is, in a layout's file: rigid boards or a soft sheet. What older files mean, and how the answer is written."""

import json
import re
import tomllib
from pathlib import Path

import pytest
import trimesh

from skincal.cli import main
from skincal.files.layout_sources import Grid, parse_layout, repeated_modules, text_of_ini, text_of_table, text_with_kind
from skincal.model.errors import InputError
from skincal.model.scene import load_scene, resource
from skincal.model.skin import SkinKind
from skincal.words.layout_words import unsaid_kind_finding

FILE = Path("modules.toml")
OWN = """\
# My skin.
# Two lines.
[kinds.patch]
pads_mm = [[0, 0], [5, 0]]
outline_mm = [[-3, -3], [8, -3], [8, 3]]
centre_pad = 0

[[modules]]
id = 1
kind = "patch"
first_channel = 0
"""


def read(text: str):
    return parse_layout(text, FILE)


def test_a_layout_of_before_that_names_no_kind_is_of_boards_and_says_so_unless_it_is_of_triangles():
    layout = read(OWN)
    assert (layout.kind, layout.given_kind) == (SkinKind.BOARD, None)
    assert 'kind = "sheet"' in unsaid_kind_finding(layout)
    triangles = repeated_modules("triangle_12", 1, 2).replace('kind = "board"', "")
    assert unsaid_kind_finding(read(triangles)) == ""


def test_grids_and_tables_are_sheets_and_modules_are_boards():
    ini = "triangle_10pad 3 192.38 -20.00 -150.00 5 1\n"
    kinds = {
        "grid": Grid(6, 8, 9.0).layout_text(),
        "grid of boards": Grid(6, 8, 9.0, SkinKind.BOARD).layout_text(),
        "table": text_of_table("0, 0\n5, 0\n", FILE),
        "modules": repeated_modules("triangle_12", 1, 2),
        "ini": text_of_ini(ini, FILE),
    }
    assert {name: read(text).given_kind.value for name, text in kinds.items()} == {
        "grid": "sheet", "grid of boards": "board", "table": "sheet", "modules": "board", "ini": "board"
    }  # fmt: skip


@pytest.mark.parametrize(
    "text", [OWN, OWN.replace("\n", "\r\n"), OWN.split("[kinds", maxsplit=1)[0].rstrip() + "\n" + Grid(2, 2, 5.0).layout_text()]
)
def test_the_kind_is_written_above_the_tables_and_changes_nothing_else(text):
    for kind in (SkinKind.SHEET, SkinKind.BOARD):
        changed = text_with_kind(text, kind)
        document = tomllib.loads(changed)
        assert document.pop("kind") == kind.value
        before = tomllib.loads(text)
        before.pop("kind", None)
        assert document == before, "the modules keep the names of their own kinds"
        again = text_with_kind(changed, SkinKind.SHEET)
        assert text_with_kind(again, kind) == changed, "it goes to and fro"
        assert text_with_kind(changed, kind) == changed
    assert changed.startswith("# My skin."), "the title stays on top"
    assert unsaid_kind_finding(read(changed)) == ""


def test_another_kind_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="kind is 'foam'; expected one of board, sheet"):
        read('kind = "foam"\n' + OWN)


def make_scene(tmp_path, capsys, *options):
    """Write a scene of a box with the command, and return what `scene show` says of it, as text and as JSON."""
    part = tmp_path / "part.stl"
    trimesh.creation.box((80.0, 80.0, 40.0)).export(part)
    out = tmp_path / "scenes" / "-".join(options).replace("/", "").replace(" ", "") / "scene.toml"
    code = main(["scene", "new", "--mesh", str(part), "--unit", "mm", *options, "--out", str(out)])
    error = capsys.readouterr().err
    if code:
        return code, error, out
    assert main(["scene", "show", str(out)]) == 0
    text = capsys.readouterr().out
    assert main(["scene", "show", str(out), "--json"]) == 0
    return text, json.loads(capsys.readouterr().out), out


def test_the_command_writes_and_shows_what_the_skin_is(tmp_path, capsys):
    text, shown, out = make_scene(tmp_path, capsys, "--grid", "3x4@8mm")
    assert "12 taxels on a soft sheet" in text
    assert shown["kind"] == "sheet"
    assert load_scene(out).skin.layout.kind is SkinKind.SHEET
    text, shown, out = make_scene(tmp_path, capsys, "--grid", "3x4@8mm", "--kind", "board")
    assert "12 taxels on rigid boards" in text
    assert load_scene(out).skin.layout.kind is SkinKind.BOARD


def test_a_layout_that_names_no_kind_is_a_finding_and_its_advice_removes_it(tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(OWN)
    text, shown, out = make_scene(tmp_path, capsys, "--layout", str(file))
    (finding,) = [finding for finding in shown["findings"] if "does not say what the skin is" in finding]
    advice = re.search(r'write (kind = "sheet") at the top', finding).group(1)
    layout = out.parent / "modules.toml"
    layout.write_text(f"{advice}\n{layout.read_text()}")
    assert main(["scene", "show", str(out)]) == 0
    text = capsys.readouterr().out
    assert "2 taxels on a soft sheet" in text
    assert "does not say" not in text


def test_a_kind_without_a_layout_is_refused_and_leaves_nothing(tmp_path, capsys):
    code, error, out = make_scene(tmp_path, capsys, "--channels", "4", "--kind", "sheet")
    assert code == 2
    assert "--kind says what the skin of a layout is" in error
    assert not out.parent.exists()


def test_known_distances_of_a_sheet_are_refused(tmp_path, capsys):
    *_, out = make_scene(tmp_path, capsys, "--grid", "3x4@8mm")
    out.write_text(out.read_text() + "\n[[distances]]\ntaxels = [0, 11]\nmm = 30\nsd_mm = 1\n")
    with pytest.raises(InputError, match="between rigid boards, and the layout is a soft sheet"):
        load_scene(out)


def test_a_sheet_without_a_mesh_is_said_with_its_remedies_where_its_pokes_are_solved(tmp_path, capsys):
    for kind, said in (("sheet", 1), ("board", 0)):
        text = f'kind = "{kind}"\n' + (resource("scenes/flat-patch/modules.toml")).read_text(encoding="utf-8")
        folder = tmp_path / kind
        folder.mkdir()
        (folder / "modules.toml").write_text(text, encoding="utf-8")
        scene = resource("scenes/flat-patch/scene.toml").read_text(encoding="utf-8")
        (folder / "scene.toml").write_text(scene, encoding="utf-8")
        command = ["simulate", "--scene", str(folder / "scene.toml"), "--pokes", "4", "--careful", "--out", str(folder / "s")]
        assert main(command) == 0
        capsys.readouterr()
        assert main(["solve", str(folder / "s")]) == 0
        assert capsys.readouterr().out.count("--kind board") == said
