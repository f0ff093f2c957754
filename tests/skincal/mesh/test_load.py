import gc
import hashlib
import io
import re
import struct
import subprocess
import sys
import time
import weakref

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_support import tube

from skincal.mesh.findings import FindingKind
from skincal.mesh.geodesics import geodesics_of
from skincal.mesh.load import load_surface
from skincal.mesh.readers import read_mesh
from skincal.mesh.search import surface_in_solver
from skincal.mesh.surface import make_surface
from skincal.model.errors import InputError
from skincal.model.scene import SurfaceSpec
from tests.approved import approved, approved_pattern


def tube_mesh(**shape):
    """Vertices in mm and triangles of an open shell, normals away from the axis."""
    surface = tube(**shape)
    return 1e3 * surface.vertices, surface.triangles


def box_mesh(side=40.0, middle=(0.0, 0.0, 0.0)):
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * side - side / 2 + middle
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def off_bytes(vertices, triangles):
    lines = [f"OFF\n{len(vertices)} {len(triangles)} 0"]
    lines += [" ".join(repr(float(x)) for x in v) for v in vertices]
    lines += [f"3 {a} {b} {c}" for a, b, c in triangles]
    return "\n".join(lines).encode()


def stl_bytes(vertices, triangles):
    records = np.zeros(len(triangles), np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    records["c"] = vertices[triangles]
    return b"binary".ljust(80) + struct.pack("<I", len(triangles)) + records.tobytes()


def load(folder, data, name="part.off", scale=1e-3, pose=None, replaces_unit=False):
    path = folder / name
    path.write_bytes(data)
    surface, findings = load_surface(SurfaceSpec(path, scale, np.eye(4) if pose is None else pose, replaces_unit))
    return surface, {finding.kind: finding for finding in findings}


def test_a_mesh_stays_ready_until_its_file_or_its_place_changes(tmp_path, monkeypatch):
    data, moved = off_bytes(*box_mesh()), np.eye(4)
    moved[2, 3] = 0.1
    first, _ = load(tmp_path, data)
    assert load(tmp_path, data)[0] is first
    assert load(tmp_path, data, pose=moved)[0].vertices[:, 2].min() == pytest.approx(0.08)
    assert load(tmp_path, data, scale=2e-3)[0].size == pytest.approx(2 * first.size)
    assert load(tmp_path, off_bytes(*box_mesh(side=50.0)))[0].size == pytest.approx(1.25 * first.size)
    monkeypatch.setattr("skincal.mesh.load.KEPT_MESH_MAX_BYTES", 10)
    assert load(tmp_path, data)[0] is not load(tmp_path, data)[0], "a large mesh would fill the memory"


def test_a_clean_shell_is_kept_as_it_is(tmp_path):
    vertices, triangles = tube_mesh()
    data = off_bytes(vertices, triangles)
    surface, found = load(tmp_path, data)
    np.testing.assert_allclose(surface.vertices, vertices * 1e-3, atol=1e-15)
    np.testing.assert_array_equal(surface.triangles, triangles)
    assert surface.sha256 == hashlib.sha256(data).hexdigest()
    assert set(found) == {FindingKind.SIZE, FindingKind.OPEN_EDGES}
    assert found[FindingKind.OPEN_EDGES].count == 2 * (24 + 12)
    assert found[FindingKind.OPEN_EDGES].sentence == approved("mesh.open_rims", edges=72)
    radial = surface.centres.T * [1, 1, 0]
    assert (np.einsum("ij,ij->i", surface.normals, radial) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(surface.normals, axis=1), 1)


def test_the_pose_and_the_unit_carry_the_mesh_into_the_link_frame(tmp_path):
    vertices, triangles = tube_mesh()
    pose = np.array([[0, -1, 0, 0.1], [1, 0, 0, -0.2], [0, 0, 1, 0.3], [0, 0, 0, 1.0]])
    surface, _ = load(tmp_path, off_bytes(vertices, triangles), pose=pose)
    np.testing.assert_allclose(surface.vertices, vertices * 1e-3 @ pose[:3, :3].T + pose[:3, 3], atol=1e-15)


def test_a_soup_of_unshared_cracked_vertices_is_merged(tmp_path):
    vertices, triangles = tube_mesh()
    rng = np.random.default_rng(0)
    corners = vertices[triangles].reshape(-1, 3) + rng.uniform(-2e-4, 2e-4, size=(3 * len(triangles), 3))
    surface, found = load(tmp_path, off_bytes(corners, np.arange(len(corners)).reshape(-1, 3)))
    assert len(surface.vertices) == len(vertices)
    assert found[FindingKind.MERGED].count == len(corners) - len(vertices)
    assert found[FindingKind.OPEN_EDGES].count == 2 * (24 + 12)
    assert FindingKind.COMPONENTS not in found


def test_merging_stops_at_the_distance(tmp_path):
    vertices, triangles = box_mesh()
    shifts = np.array([[0, 0, 0], [0, 0.0009, 0], [60, 0, 0], [60, 0.0011, 0]])
    near = (vertices + shifts[:, None]).reshape(-1, 3)
    surface, found = load(tmp_path, off_bytes(near, np.concatenate([triangles + 8 * i for i in range(4)])))
    assert found[FindingKind.MERGED].count == 8, "0.9 um is merged, 1.1 um is not"
    assert found[FindingKind.DUPLICATES].count == 12
    assert len(surface.vertices) == 24


def test_duplicates_zero_areas_and_slivers_are_counted(tmp_path):
    vertices, triangles = tube_mesh()
    extra = np.array([[100.0, 0, 0], [130.0, 0, 0], [115.0, 0.05, 0], [110.0, 0, 0], [120.0, 1e-5, 0]])
    n = len(vertices)
    odd = [[n, n + 1, n + 2], [n, n + 1, n + 3], [n, n + 4, n + 1], triangles[0][[1, 2, 0]], triangles[1][[1, 0, 2]]]
    surface, found = load(tmp_path, off_bytes(np.concatenate([vertices, extra]), np.concatenate([triangles, odd])))
    assert found[FindingKind.SLIVERS].count == 1
    assert found[FindingKind.ZERO_AREA].count == 2
    assert found[FindingKind.DUPLICATES].count == 2
    assert found[FindingKind.COMPONENTS].count == 2
    assert len(surface.triangles) == len(triangles) + 1
    assert np.isfinite(surface.normals).all()


@pytest.mark.parametrize("turned", [0.1, 0.45, 0.9])
def test_turned_triangles_are_turned_back(tmp_path, turned):
    vertices, triangles = tube_mesh()
    rng = np.random.default_rng(1)
    wrong = rng.random(len(triangles)) < turned
    mixed = np.where(wrong[:, None], triangles[:, [0, 2, 1]], triangles)
    surface, found = load(tmp_path, off_bytes(vertices, mixed))
    clean, _ = load(tmp_path, off_bytes(vertices, triangles), "clean.off")
    np.testing.assert_allclose(surface.normals, clean.normals, atol=1e-12)
    assert found[FindingKind.WINDING].count == min(wrong.sum(), (~wrong).sum())
    assert (FindingKind.TURNED in found) == (turned > 0.5)


@pytest.mark.parametrize("mesh", [tube_mesh(), tube_mesh(turn=0.05), box_mesh()], ids=["cover", "shallow cap", "closed"])
def test_a_mesh_turned_inside_out_is_turned_and_said(tmp_path, mesh):
    vertices, triangles = mesh
    right, found = load(tmp_path, off_bytes(vertices, triangles))
    assert FindingKind.TURNED not in found
    surface, found = load(tmp_path, off_bytes(vertices, triangles[:, ::-1]), "inside-out.off")
    assert found[FindingKind.TURNED].count == len(triangles)
    np.testing.assert_allclose(surface.normals, right.normals, atol=1e-12)


@pytest.mark.parametrize("flip", [False, True])
def test_a_flat_patch_keeps_its_winding(tmp_path, flip):
    vertices = np.array([[0.0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    surface, found = load(tmp_path, off_bytes(vertices, triangles[:, ::-1] if flip else triangles))
    assert surface.normals[:, 2].tolist() == pytest.approx([-1, -1] if flip else [1, 1])
    assert found[FindingKind.FLAT].count == 1
    assert FindingKind.TURNED not in found


def test_flat_panels_round_a_part_are_judged_by_the_whole_part(tmp_path):
    """Six unconnected sides of a box, one of them turned."""
    vertices, triangles = box_mesh()
    corners = vertices[triangles]
    corners[4:6] = corners[4:6, ::-1]
    quads = corners + np.repeat(np.arange(6), 2)[:, None, None] * 0.002  # panels 2 um apart do not merge
    surface, found = load(tmp_path, off_bytes(quads.reshape(-1, 3), np.arange(36).reshape(-1, 3)))
    assert found[FindingKind.COMPONENTS].count == 6
    assert found[FindingKind.TURNED].count == 2
    assert (np.einsum("ij,ij->i", surface.normals, surface.centres.T) > 0).all()


def test_the_inner_wall_of_a_thick_cover_keeps_facing_inward(tmp_path):
    vertices, triangles = box_mesh()
    inner, inward = vertices * 0.9, triangles[:, ::-1]
    surface, found = load(tmp_path, off_bytes(np.concatenate([vertices, inner]), np.concatenate([triangles, inward + 8])))
    assert FindingKind.TURNED not in found
    facing_out = np.einsum("ij,ij->i", surface.normals, surface.centres.T) > 0
    assert facing_out.tolist() == [True] * 12 + [False] * 12


def test_a_moebius_strip_and_a_fin_are_survived_and_said(tmp_path):
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = [
        [(40 + s * 8 * np.cos(a / 2)) * np.cos(a), (40 + s * 8 * np.cos(a / 2)) * np.sin(a), s * 8 * np.sin(a / 2)]
        for a in angle for s in (-1, 1)
    ]  # fmt: skip
    triangles = []
    for i in range(24):
        a, b = 2 * i, 2 * i + 1
        c, d = (2 * i + 2, 2 * i + 3) if i < 23 else (1, 0)
        triangles += [(a, c, b), (b, c, d)]
    _, found = load(tmp_path, off_bytes(np.array(ring), np.array(triangles)))
    assert found[FindingKind.ONE_SIDED].count == 1
    vertices, shell = tube_mesh()
    fin = np.concatenate([vertices, [[60.0, 0, 75.0]]])
    _, found = load(tmp_path, off_bytes(fin, np.concatenate([shell, [[*shell[100][:2], len(vertices)]]])))
    assert found[FindingKind.NON_MANIFOLD].count == 1


def likely(*units):
    return "; ".join(approved("mesh.unit_would_give", unit=unit, diagonal=diagonal) for unit, diagonal in units)


@pytest.mark.parametrize(
    ("size", "scale", "said"),
    [
        (1.0, 1.0, approved("mesh.too_large", seen="177.9 m", unit="m", likely=likely(("cm", "1.779 m"), ("mm", "177.9 mm")))),
        (1e-3, 1e-3, approved("mesh.too_large", seen="0.1779 mm", unit="mm", likely=likely(("m", "177.9 mm")))),
        (1e6, 1e-3, approved("mesh.no_unit_fits")),
    ],
)
def test_a_thousand_times_wrong_is_refused_with_the_likely_unit(tmp_path, size, scale, said):
    vertices, triangles = tube_mesh()
    with pytest.raises(InputError, match=re.escape(said)) as error:
        load(tmp_path, off_bytes(vertices * size, triangles), scale=scale)
    assert "part.off" in str(error.value)


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        *((f"part.{kind}", b"", "empty") for kind in ("off", "stl", "obj", "ply")),
        ("part.stl", stl_bytes(np.zeros((3, 3)), np.empty((0, 3), int)), "empty"),
        ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "3 vertices, no triangle"),
        ("part.step", b"ISO-10303", approved("mesh.unknown_suffix", suffix=".step")),
        ("part", b"ISO-10303", "suffix"),
        ("part.stl", stl_bytes(*tube_mesh())[:-60], approved("mesh.stl_cut", count=576)),
        ("part.obj", b"\x00\x01garbage", approved("mesh.not_readable", format="OBJ")),
        (
            "part.ply",
            b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nend_header\n0\n",
            approved("mesh.not_readable", format="PLY"),
        ),
        ("part.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n", approved("mesh.no_such_vertex", last=7, count=3)),
        ("part.off", b"OFF\n3 1 0\n0 0 0\n1 0 nan\n0 1 0\n3 0 1 2\n", approved("mesh.not_finite", bad=1, count=3)),
        ("part.off", b"OFF\n3 1 0\n0 0 0\n10 0 0\n30 0 0\n3 0 1 2\n", approved("mesh.no_area")),
    ],
)
def test_bad_files_are_named_with_what_to_do(tmp_path, name, data, said):
    with pytest.raises(InputError, match=re.escape(said)) as error:
        load(tmp_path, data, name)
    assert name in str(error.value)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    for name, said in (("none.stl", approved_pattern("mesh.missing")), ("folder.stl", "is a folder")):
        with pytest.raises(InputError, match=said):
            load_surface(SurfaceSpec(tmp_path / name, 1e-3, np.eye(4)))


@settings(max_examples=120, deadline=None)
@given(st.sampled_from([".stl", ".obj", ".ply", ".off"]), st.binary(max_size=300), st.integers(0, 400), st.booleans())
def test_garbage_never_escapes_as_anything_but_a_sentence(tmp_path_factory, suffix, noise, cut, whole):
    vertices, triangles = box_mesh()
    good = {".stl": stl_bytes(vertices, triangles), ".off": off_bytes(vertices, triangles)}.get(suffix, b"")
    if suffix in (".obj", ".ply"):
        good = exported(vertices, triangles, suffix[1:])
    data = noise if whole else good[:cut] + noise + good[cut + len(noise) :]
    path = tmp_path_factory.getbasetemp() / f"noise{suffix}"
    path.write_bytes(data)
    try:
        surface, _ = load_surface(SurfaceSpec(path, 1e-3, np.eye(4)))
    except InputError:
        return
    assert np.isfinite(surface.vertices).all()
    assert np.isfinite(surface.normals).all()


def exported(vertices, triangles, kind, **options):
    """Write a mesh with another program."""
    trimesh = pytest.importorskip("trimesh")
    made = trimesh.Trimesh(vertices, triangles, process=False).export(file_type=kind, **options)
    return made.encode() if isinstance(made, str) else made


@pytest.mark.parametrize(
    ("suffix", "kind", "options"),
    [
        (".stl", "stl", {}), (".stl", "stl_ascii", {}), (".obj", "obj", {}), (".off", "off", {}),
        (".ply", "ply", {"encoding": "binary"}), (".ply", "ply", {"encoding": "ascii"}),
    ],
)  # fmt: skip
def test_reads_what_another_program_writes(tmp_path, suffix, kind, options):
    vertices, triangles = tube_mesh()
    mesh = read_mesh(tmp_path / f"part{suffix}", exported(vertices, triangles, kind, **options))
    np.testing.assert_allclose(mesh.vertices[mesh.triangles], vertices[triangles], atol=2e-5)
    assert mesh.findings == ()


def test_obj_polygons_negative_indices_textures_and_groups(tmp_path):
    text = b"""# a comment
mtllib none.mtl
o part
v 0 0 0 1.0
v 10 0 0
v 10 10 0
v 0 10 0
vt 0 0
vn 0 0 1
usemtl steel
f 1/1/1 2/1/1 3//1 \\
 4
g other
v 0 0 5
f -1 -2 -3
"""
    mesh = read_mesh(tmp_path / "part.obj", text)
    assert mesh.vertices.shape == (5, 3)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 3, 2]]


def test_off_polygons_comments_and_counts_on_the_first_line(tmp_path):
    text = b"# made by hand\nOFF 5 2 0\n0 0 0\n10 0 0 # a corner\n\n15 5 0\n10 10 0\n0 10 0\n5 0 1 2 3 4 255 0 0\n3 4 1 0\n"
    mesh = read_mesh(tmp_path / "part.off", text)
    assert mesh.vertices[2].tolist() == [15, 5, 0]
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [4, 1, 0]]


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_polygons_other_elements_and_both_byte_orders(tmp_path, order):
    head = (
        f"ply\nformat {order} 1.0\ncomment made by hand\nelement vertex 4\nproperty uchar red\nproperty double x\n"
        "property float y\nproperty float z\nelement edge 1\nproperty int v1\nproperty list uchar int more\n"
        "element face 2\nproperty list uchar int vertex_indices\nproperty uchar quality\nend_header\n"
    )
    points = [(0, 0, 0), (10, 0, 0), (10, 10, 0), (0, 10, 1)]
    faces = [(0, 1, 2, 3), (3, 1, 0)]
    if order == "ascii":
        body = "".join(f"9 {x} {y} {z}\n" for x, y, z in points) + "7 2 5 6\n"
        body = (body + "".join(f"{len(f)} {' '.join(map(str, f))} 1\n" for f in faces)).encode()
    else:
        mark = "<" if "little" in order else ">"
        body = b"".join(struct.pack(mark + "Bdff", 9, *p) for p in points) + struct.pack(mark + "iBii", 7, 2, 5, 6)
        body += b"".join(struct.pack(f"{mark}B{len(f)}iB", len(f), *f, 1) for f in faces)
    mesh = read_mesh(tmp_path / "part.ply", head.encode() + body)
    np.testing.assert_array_equal(mesh.vertices, points)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3], [3, 1, 0]]


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
def test_a_hundred_thousand_triangles_load_in_about_a_second(tmp_path, suffix):
    vertices, triangles = tube_mesh(around=250, along=200)
    if suffix == ".stl":
        data = stl_bytes(vertices, triangles)
    else:
        text = io.StringIO()
        np.savetxt(text, vertices, fmt="v %.6f %.6f %.6f")
        np.savetxt(text, triangles + 1, fmt="f %d %d %d")
        data = text.getvalue().encode()
    (tmp_path / f"big{suffix}").write_bytes(data)
    begin = time.process_time()
    surface, _ = load_surface(SurfaceSpec(tmp_path / f"big{suffix}", 1e-3, np.eye(4)))
    took = time.process_time() - begin
    assert len(surface.triangles) == 100_000
    assert len(surface.vertices) == 251 * 201
    # Measured 0.4 s (STL) and 0.7 s (OBJ) alone; the bar on the processor's time allows for a busy machine.
    assert took < 3.0


def test_a_mesh_is_read_without_scipy_or_a_mesh_library():
    """Their import costs every command about as much as a solve does (docs/decisions/mesh-readers.md)."""
    script = (
        "import sys\n"
        "from skincal.mesh.load import load_surface\n"
        "from skincal.model.scene import load_scene, resource\n"
        "load_surface(load_scene(resource('scenes/icub-forearm/scene.toml')).surface)\n"
        "print(sorted({'scipy', 'trimesh', 'vtkmodules'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout == "[]\n"


def test_what_is_worked_out_on_a_surface_is_kept_with_it_and_gone_with_it():
    vertices, triangles = tube_mesh()
    surface = make_surface(vertices * 1e-3, triangles)
    made = geodesics_of(surface), surface_in_solver(surface)
    assert made[0] is geodesics_of(surface)
    assert made[1] is surface_in_solver(surface)
    gone = [weakref.ref(surface), weakref.ref(made[0]), weakref.ref(made[1][0])]
    del surface, made
    gc.collect()
    assert [reference() for reference in gone] == [None, None, None]
