"""The corrected layout's file: what changes in it, what stays, and what is refused."""

import os
import tomllib

import numpy as np
import pytest

from skincal.files.layout_file import corrected_text, write_layout
from skincal.model.errors import InputError
from skincal.model.scene import resource
from skincal.model.skin import Layout, Module, load_layout
from skincal.modules.health import LayoutRepair, ModuleChange, changes_of
from tests.approved import approved_pattern

TEXT = """\
# My skin.
[kinds.own]  # a kind
pads_mm = [[-3, 0],
  [3, 0]]    # two
outline_mm = [[-6, -6], [6, -6], [0, 6]]
centre_pad = 0

[[modules]]
id = 3       # first
kind = "own"
first_channel = 0x2   # hexadecimal
place_mm = [1.50, 2]
angle_deg = -180.0   # turned
mirror = false # not

# Between the two.
[[modules]]
id = 4
kind = 'own'
first_channel = 0

# Between.
[[modules]]
id = 5
kind = "own"
first_channel = 4
[modules.anchor]
at_mm = [0, 0]
point_mm = [0, 0, 0]
x = [1, 0, 0]
normal = [0, 0, 1]
# The end.
"""
CHANGES = (
    ModuleChange(3, angle=float(np.radians(60.0)), mirror=True, first_channel=0),
    ModuleChange(4, angle=float(np.radians(12.5)), first_channel=2),
    ModuleChange(5, mirror=True),
)


def test_what_changes_is_changed_in_its_line_and_all_else_stays():
    assert corrected_text(TEXT, CHANGES).splitlines() == [
        *TEXT.splitlines()[:10],
        "first_channel = 0   # hexadecimal",
        "place_mm = [1.50, 2]",
        "angle_deg = 60   # turned",
        "mirror = true # not",
        "",
        "# Between the two.",
        "[[modules]]",
        "id = 4",
        "kind = 'own'",
        "first_channel = 2",
        "angle_deg = 12.5",
        "",
        "# Between.",
        "[[modules]]",
        "id = 5",
        'kind = "own"',
        "first_channel = 4",
        "mirror = true",
        "",
        *TEXT.splitlines()[-6:],
    ]


def test_without_a_change_not_a_byte_differs():
    for name in ("icub-forearm", "flat-patch", "whole-body"):
        text = resource(f"scenes/{name}/modules.toml").read_text(encoding="utf-8")
        assert corrected_text(text, ()) == text
        assert tomllib.loads(corrected_text(text, (ModuleChange(1, mirror=True),)))["modules"]


def test_ends_of_line_stay_as_they_are():
    windows = corrected_text(TEXT.replace("\n", "\r\n"), CHANGES)
    assert windows.replace("\r\n", "") == corrected_text(TEXT, CHANGES).replace("\n", "")
    assert "\n" not in windows.replace("\r\n", "")


def test_modules_in_a_list_of_inline_tables_are_changed_too():
    text = 'modules = [{id = 3, kind = "triangle_12", first_channel = 0}, # one\n  {id = 4, mirror = true}]\n'
    done = corrected_text(text, (ModuleChange(3, mirror=True), ModuleChange(4, mirror=False)))
    assert "# one" in done
    assert [table["mirror"] for table in tomllib.loads(done)["modules"]] == [True, False]


@pytest.fixture
def layout(tmp_path):
    path = tmp_path / "modules.toml"
    path.write_text(TEXT, encoding="utf-8")
    return load_layout(path, 6)


def mended(layout: Layout, **of_first) -> LayoutRepair:
    one, *others = layout.modules
    values = {name: getattr(one, name) for name in ("id", "kind", "first_channel", "place", "angle", "mirror", "anchor")}
    after = Layout((Module(**(values | of_first)), *others), layout.width, layout.path, layout.text)
    return LayoutRepair((), after, changes_of(layout, after), ())


def test_the_file_that_is_written_is_the_layout_that_was_meant(layout, tmp_path):
    mend = mended(layout, angle=float(np.radians(100.0 / 3.0)), mirror=True)
    path = tmp_path / "corrected.toml"
    path.write_text("older", encoding="utf-8")
    write_layout(layout, mend, path)
    read = load_layout(path, 6)
    np.testing.assert_allclose(read.places, mend.layout.places, atol=1e-9)
    assert (tmp_path / "corrected.toml.bak").read_text(encoding="utf-8") == "older"
    assert layout.path.read_text(encoding="utf-8") == TEXT
    assert sorted(each.name for each in tmp_path.iterdir()) == ["corrected.toml", "corrected.toml.bak", "modules.toml"]


def test_the_file_that_was_read_is_never_written(layout, tmp_path):
    mend = mended(layout, mirror=True)
    (tmp_path / "link.toml").symlink_to(layout.path)
    os.link(layout.path, tmp_path / "other-name.toml")
    for path in (layout.path, tmp_path / "." / "modules.toml", tmp_path / "link.toml", tmp_path / "other-name.toml"):
        with pytest.raises(InputError, match=approved_pattern("layout_file.the_same")):
            write_layout(layout, mend, path)
    assert layout.path.read_text(encoding="utf-8") == TEXT
    made = Layout(layout.modules, layout.width)
    with pytest.raises(InputError, match=approved_pattern("layout_file.no_file")):
        write_layout(made, mend, tmp_path / "new.toml")


def test_what_would_be_read_otherwise_is_not_written(layout, tmp_path):
    meant = mended(layout, mirror=True)
    silent = LayoutRepair((), meant.layout, (ModuleChange(3, angle=1.0),), ())
    with pytest.raises(InputError, match=approved_pattern("layout_file.not_as_meant", module=3)):
        write_layout(layout, silent, tmp_path / "new.toml")
    short = LayoutRepair((), Layout(layout.modules[:2], layout.width), (), ())
    with pytest.raises(InputError, match=approved_pattern("layout_file.module_count", read=3, expected=2)):
        write_layout(layout, short, tmp_path / "new.toml")
    assert not (tmp_path / "new.toml").exists()


def test_a_folder_that_is_not_there_is_said(layout, tmp_path):
    with pytest.raises(InputError, match=approved_pattern("layout_file.no_folder")):
        write_layout(layout, mended(layout, mirror=True), tmp_path / "none" / "new.toml")
