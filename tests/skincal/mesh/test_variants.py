"""Mesh files as other programs write them: letters, marks, headers and ends."""

import re

import numpy as np
import pytest
from test_load import box_mesh, exported, load, off_bytes, stl_bytes

from skincal.mesh.findings import FindingKind
from skincal.model.errors import InputError
from tests.approved import approved

BOX_VOLUME_MM3 = 40.0**3


def box_volume(surface):
    return np.linalg.det(surface.corners * 1e3).sum() / 6


def stl_text(vertices, triangles):
    return exported(vertices, triangles, "stl_ascii")


def assert_box(surface):
    assert box_volume(surface) == pytest.approx(BOX_VOLUME_MM3, rel=1e-6)
    assert len(surface.triangles) == 12


@pytest.mark.parametrize("change", [bytes.upper, bytes.title, bytes.lower, lambda text: text.replace(b"\n", b"\r\n")])
def test_ascii_stl_in_any_letters(tmp_path, change):
    surface, found = load(tmp_path, change(stl_text(*box_mesh())), "part.stl")
    assert_box(surface)
    assert set(found) == {FindingKind.SIZE}


@pytest.mark.parametrize("after", [1, 16, 50, 1000])
def test_bytes_after_a_binary_stl_are_counted(tmp_path, after):
    surface, found = load(tmp_path, stl_bytes(*box_mesh()) + b"\x01" * after, "part.stl")
    assert_box(surface)
    assert found[FindingKind.BYTES_AFTER_END].sentence == approved("mesh.bytes_after_end", count=after)


def test_a_binary_stl_without_its_count_is_not_an_empty_mesh(tmp_path):
    data = stl_bytes(*box_mesh())
    with pytest.raises(InputError, match="no triangle is announced, and 600 bytes follow"):
        load(tmp_path, data[:80] + bytes(4) + data[84:], "part.stl")


def test_an_ascii_stl_that_was_cut_is_reported_or_refused(tmp_path):
    text = stl_text(*box_mesh())
    facets = [match.start() for match in re.finditer(b"facet normal", text)]
    surface, found = load(tmp_path, text[: facets[6]], "part.stl")
    assert len(surface.triangles) == 6
    assert found[FindingKind.NO_END].sentence == approved("mesh.no_end")
    with pytest.raises(InputError, match="corners in"):
        load(tmp_path, text[: facets[6] + 60], "part.stl")


def test_an_ascii_stl_with_four_corners_in_a_loop_is_refused(tmp_path):
    corner = "vertex 0 0 0\nvertex 40 0 0\nvertex 40 40 0\nvertex 0 40 0\n"
    text = "solid a\n" + f"facet normal 0 0 1\nouter loop\n{corner}endloop\nendfacet\n" * 3 + "endsolid a\n"
    with pytest.raises(InputError, match="12 corners in 3 triangles"):
        load(tmp_path, text.encode(), "part.stl")


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("suffix", [".stl", ".obj", ".off", ".ply"])
def test_a_byte_order_mark_is_no_part_of_the_mesh(tmp_path, suffix, encoding):
    kind = {".stl": "stl_ascii"}.get(suffix, suffix[1:])
    options = {"encoding": "ascii"} if suffix == ".ply" else {}
    text = exported(*box_mesh(), kind, **options).decode()
    surface, _ = load(tmp_path, text.encode(encoding), f"part{suffix}")
    assert_box(surface)


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".stl", "solid a\nfacet\nouter loop\nvertex 80,5 0 0\nvertex 0 9 0\nvertex 0 0 9\nendloop\nendfacet\nendsolid"),
        (".obj", "v 80,5 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\n"),
        (".off", "OFF\n3 1 0\n80,5 0 0\n0 9 0\n0 0 9\n3 0 1 2\n"),
        (
            ".ply",
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n80,5 0 0\n0 9 0\n0 0 9\n3 0 1 2\n",
        ),
    ],
)  # fmt: skip
def test_a_decimal_comma_is_named(tmp_path, suffix, text):
    with pytest.raises(InputError) as error:
        load(tmp_path, text.encode(), f"part{suffix}")
    assert approved("mesh.decimal_comma", number="80,5") in str(error.value)
    # The advice: the same file with points.
    surface, _ = load(tmp_path, text.replace(",", ".").encode(), f"mended{suffix}")
    assert surface.vertices[:, 0].max() == pytest.approx(0.0805)


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".stl", "solid a\nfacet\nouter loop\nvertex x 0 0\nvertex 0 9 0\nvertex 0 0 9\nendloop\nendfacet\nendsolid"),
        (".obj", "v x 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 3\n"), (".obj", "v 1 0 0\nv 0 9 0\nv 0 0 9\nf 1 2 x\n"),
        (".off", "OFF\n3 1 0\nx 0 0\n0 9 0\n0 0 9\n3 0 1 2\n"), (".off", "OFF\n3 x 0\n"), (".off", "OFF\n"),
        (".off", "4OFF\n3 1 0\n"), (".off", "OFF BINARY\n"),
    ],
)  # fmt: skip
def test_a_sentence_shows_words_as_the_file_has_them(tmp_path, suffix, text):
    with pytest.raises(InputError, match="not a readable") as error:
        load(tmp_path, text.encode(), f"part{suffix}")
    assert "b'" not in str(error.value)
    assert "np." not in str(error.value)


@pytest.mark.parametrize("counts_on_the_first_line", [False, True])
@pytest.mark.parametrize("kind", ["OFF", "COFF", "NOFF", "CNOFF", "NCOFF", "STOFF", "STCNOFF"])
def test_off_with_colours_normals_and_textures(tmp_path, kind, counts_on_the_first_line):
    _, counts, *lines = off_bytes(*box_mesh()).decode().splitlines()
    more = {"N": "0.1 0.2 0.9", "C": "255 0 128 255", "ST": "0.5 0.25"}
    extra = " ".join(more[word] for word in re.findall("ST|C|N", kind.removesuffix("OFF")))
    vertices = [f"{line} {extra}" for line in lines[:8]]
    start = f"{kind} {counts}" if counts_on_the_first_line else f"{kind}\n{counts}"
    surface, _ = load(tmp_path, "\n".join([start, *vertices, *lines[8:]]).encode())
    assert_box(surface)
