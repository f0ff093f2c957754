import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.files.icub import NO_TAXEL, THERMAL_PAD, icub_text, parse_icub, read_icub, representatives, skin_part
from skincal.model.errors import InputError, list_channels
from skincal.taxels.result import Method
from tests.approved import approved_pattern
from tests.skincal.files.files_support import CHANNELS, make_calibration

ROW = "0.01 0.02 0.03 0 0 1\n"


def yarp_property_rows(text: str) -> list[list[str]]:
    """Rows of [calibration] by the rules of YARP's Property::fromConfig, written from its source, not from ours."""
    rows: list[list[str]] = []
    tag = ""
    pending = ""
    for raw in text.split("\n"):
        pending += raw
        if pending.count("(") != pending.count(")") or pending.count('"') % 2:
            continue
        line, pending = pending, ""
        comment = re.search(r"//|(?:(?<=[ \t])|^)#", line)
        if comment is not None:
            line = line[: max(comment.start() - (comment.group() == "#"), 0)]
        if line.startswith("[") and "]" in line:
            tag = line[1 : line.index("]")]
        elif line.split() and tag == "calibration":
            rows.append(line.split())
    assert not pending
    return rows


def keys_of(text: str) -> dict[str, str]:
    """The keys before the rows."""
    lines = [line.partition(" ") for line in text.partition("[calibration]")[0].splitlines()]
    return {key: value.strip() for key, _, value in lines}


def test_a_written_file_reads_back_what_was_estimated(part):
    calibration = make_calibration(part, unseen=(5, 13), blind=(2,))
    text = icub_text(calibration, Method.SURFACE)
    rows = parse_icub(text, "file")
    assert rows.shape == (CHANNELS, 6)
    without = [5, 13, 2, 18, 22, *range(24, 36)]
    known = np.setdiff1d(np.arange(CHANNELS), without)
    np.testing.assert_allclose(rows[known, :3], part.places[known], atol=0.51e-6)
    np.testing.assert_allclose(rows[known, 3:], part.normals[known], atol=1e-6)
    assert not rows[without].any()
    keys = keys_of(text)
    assert [keys[key] for key in ("name", "frame", "spatial_sampling")] == ["r_forearm", "r_forearm_dh_frame", "taxel"]


def test_taxel2repr_has_one_entry_a_channel_by_the_module_plan(part):
    mapping = keys_of(icub_text(make_calibration(part), Method.FREE))["taxel2Repr"]
    pads = [15] * 12
    pads[6] = pads[10] = THERMAL_PAD
    assert [int(word) for word in mapping.strip("()").split()] == [3] * 12 + pads + [NO_TAXEL] * 12 + [39] * 12


def test_without_a_layout_a_taxel_stands_for_itself():
    assert representatives(None, 5, np.array([1, 4])).tolist() == [NO_TAXEL, 1, NO_TAXEL, NO_TAXEL, 4]


def test_yarp_reads_as_many_rows_as_there_are_channels(part):
    text = icub_text(make_calibration(part, unseen=(47,)), Method.SURFACE)
    rows = yarp_property_rows(text)
    assert len(rows) == CHANNELS
    assert all(len(row) == 6 for row in rows)
    assert [float(word) for word in rows[0][:3]] == pytest.approx(part.places[0], abs=0.51e-6)
    assert "-0.000000" not in text


def test_a_comment_among_the_rows_adds_none():
    text = "[calibration]\n" + ROW + "# said\n" + ROW + "  # said\n// said\n" + ROW
    assert len(yarp_property_rows(text)) == 3
    assert len(parse_icub(text, "file")) == 3


def test_there_is_no_negative_zero(part):
    calibration = make_calibration(part)
    first, *others = calibration.estimates[Method.FREE]
    first = replace(first, position=np.array([-1e-9, -0.0, 0.04]), normal=np.array([-1e-8, 0.0, 1.0]))
    text = icub_text(replace(calibration, estimates={Method.FREE: (first, *others)}), Method.FREE)
    assert "0.000000 0.000000 0.040000 0.000000 0.000000 1.000000\n" in text
    assert "-0.000000" not in text


def test_every_row_of_positions_has_six_decimals(part):
    rows = icub_text(make_calibration(part), Method.FREE).partition("[calibration]\n")[2].splitlines()[:CHANNELS]
    assert all(re.fullmatch(r"(-?\d+\.\d{6})( -?\d+\.\d{6}){5}", row) for row in rows)


@pytest.mark.parametrize(
    ("link", "name", "wanted"),
    [
        ("r_forearm_dh_frame", "any", "r_forearm"),
        ("l_upper_arm", "any", "l_upper_arm"),
        ("chest_skin", "any", "chest"),
        ("r_forearmish", "my part (2)", "my_part_2_"),
        ("table", "flat-patch", "flat-patch"),
    ],
)
def test_the_part_is_named_by_the_link(part, link, name, wanted):
    calibration = make_calibration(part)
    moved = replace(calibration, scene=replace(calibration.scene, link=link, name=name))
    assert skin_part(moved) == wanted
    assert skin_part(moved, "l_hand") == "l_hand"
    assert keys_of(icub_text(moved, Method.FREE))["name"] == wanted


def test_tabs_and_spaces_read_the_same():
    spaces = "name  chest\nspatial_sampling taxel\ntaxel2Repr ( 0  -1 )\n[calibration]\n0.1 0.2 0.3 0 1 0\n0 0 0 0 0 0\n"
    tabs = "name\tchest\nspatial_sampling\ttaxel\ntaxel2Repr\t(0\t-1)\n[calibration]\n0.1\t0.2\t0.3\t0\t1\t0 \n"
    tabs += "0\t0\t0\t0\t0\t0\t\n\n"
    np.testing.assert_array_equal(parse_icub(spaces, "a"), [[0.1, 0.2, 0.3, 0, 1, 0], [0] * 6])
    np.testing.assert_array_equal(parse_icub(tabs, "b"), parse_icub(spaces, "a"))


def test_the_old_format_is_bare_rows():
    np.testing.assert_array_equal(parse_icub(ROW * 3, "old.txt"), [[0.01, 0.02, 0.03, 0, 0, 1]] * 3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no rows"),
        ("hello\nworld\n", "line 1 is 'hello'"),
        ("[calibration]\n1 2 3\n", "line 2 is '1 2 3'"),
        ("[calibration]\n1 2 3 nan 0 0\n", "line 2"),
    ],
)
def test_what_is_no_position_file_is_said_with_its_line(text, said):
    with pytest.raises(InputError, match=re.escape(said)):
        parse_icub(text, "file")


def test_a_missing_file_is_said(tmp_path):
    with pytest.raises(InputError, match=approved_pattern("layout_file.no_such_file")):
        read_icub(tmp_path / "none.txt")


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused_with_a_sentence(text):
    try:
        rows = parse_icub(text, "f")
    except InputError:
        return
    assert len(rows) > 0
    assert np.isfinite(rows).all()


@given(st.sets(st.integers(0, 400), max_size=60))
def test_ranges_name_every_channel(channels):
    words = list_channels(channels, max_ranges=1000)
    named: set[int] = set()
    for word in words.split(", ") if words else []:
        first, _, last = word.partition("-")
        named |= set(range(int(first), int(last or first) + 1))
    assert named == channels


REAL = os.environ.get("SKINCAL_ICUB_FILES")


@pytest.mark.skipif(REAL is None, reason="SKINCAL_ICUB_FILES names no folder of icub-main's position files")
@pytest.mark.parametrize(
    ("name", "rows", "placed"),
    [
        ("left_forearm_mesh.txt", 384, 276),
        ("left_forearm_nomesh.txt", 384, 275),
        ("left_forearm_V2.txt", 384, 240),
        ("left_hand_V2_1.txt", 192, 48),
        ("torso.txt", 768, 528),
    ],
)
def test_the_robots_own_files(name, rows, placed):
    path = Path(str(REAL)) / name
    if not path.exists():
        pytest.skip(f"no {name}")
    read = read_icub(path)
    assert len(read) == rows
    assert np.count_nonzero(read[:, :3].any(axis=1)) == placed
    assert len(yarp_property_rows(path.read_text())) == rows
