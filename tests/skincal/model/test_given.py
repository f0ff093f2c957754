"""Files and documents of a stranger: what is no file, too large, too deep or too long ends in one plain sentence, at once."""

import json
import os
import sys

import numpy as np
import pytest

from skincal.files.icub import read_icub
from skincal.files.reference import read_reference
from skincal.mesh.load import load_surface
from skincal.mesh.readers import read_mesh
from skincal.model import given
from skincal.model.errors import ERROR_SENTENCE_MAX_CHARS, InputError, plain_text
from skincal.model.scene import SurfaceSpec, load_scene
from skincal.model.skin import read_layout
from skincal.streams.links import LinkError, LinkSpec, open_link
from tests.skincal.import_support import read_recording

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in folders")


def sentence_of(work, *arguments):
    with pytest.raises(InputError) as raised:
        work(*arguments)
    text = str(raised.value)
    assert len(text) <= ERROR_SENTENCE_MAX_CHARS
    assert plain_text(text) == text
    return text


def scene(folder, text):
    path = folder / "scene.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


GOOD = 'name = "n"\nlink = "l"\n[skin]\nchannels = 4\n'


def mesh_of(path):
    return load_surface(SurfaceSpec(path, 1e-3, np.eye(4)))


@needs_pipes
@pytest.mark.timeout(10)
@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("a.toml", load_scene),
        ("a.stl", mesh_of),
        ("a.json", read_reference),
        ("a.txt", read_icub),
        ("a.csv", lambda path: read_recording("csv", path, path)),
    ],
)
def test_a_pipe_and_a_device_are_not_read(tmp_path, name, read):
    path = tmp_path / name
    os.mkfifo(path)
    assert "a device or a pipe" in sentence_of(read, path)
    path.unlink()
    path.symlink_to("/dev/zero")
    assert "a device or a pipe" in sentence_of(read, path)
    path.unlink()
    path.mkdir()
    assert "is a folder" in sentence_of(read, path)


@needs_pipes
@pytest.mark.timeout(10)
def test_a_link_of_a_file_reads_no_pipe(tmp_path):
    os.mkfifo(tmp_path / "a")
    with pytest.raises(LinkError, match="a device or a pipe"):
        open_link(LinkSpec("wrench", f"file:{tmp_path / 'a'}", ()))


def test_what_has_no_suffix_of_a_mesh_is_not_opened(tmp_path):
    assert "not a mesh format" in sentence_of(mesh_of, tmp_path / "secret.key")


def test_a_file_beyond_the_limit_is_refused_before_it_is_read(tmp_path):
    for name, read, most in (("a.toml", load_scene, given.MAX_TEXT_BYTES), ("a.stl", mesh_of, given.MAX_MESH_BYTES)):
        path = tmp_path / name
        with path.open("wb") as file:
            file.truncate(most + 1)
        text = sentence_of(read, path)
        assert str(most) in text
        assert str(most + 1) in text


@pytest.mark.parametrize("at", ["[40, 0]", "[-50, -5]", "[1, 2]"])
def test_a_layout_of_four_million_metres(tmp_path, at):
    text = """[kinds.own]
pads_mm = [[0, 0], [40, 0]]
outline_mm = [[-50, -5], [5, -5], [0, 9]]
centre_pad = 0
[[modules]]
id = 0
kind = "own"
first_channel = 0
place_mm = [1, 2]
"""
    assert read_layout(text, tmp_path / "l.toml", 4)
    assert "has a length of 4e+09" in sentence_of(read_layout, text.replace(at, "[4e9, 0]"), tmp_path / "l.toml", 4)


OF_OTHERS = [r"\\h\a.stl", "//h/s/a.stl", r"\/h/a.stl", r"/\h/a.stl", r"\\.\pipe\a.stl", r"\??\UNC\h\a.stl", r"\\?\UNC\h\a.stl"]


@pytest.mark.parametrize("name", OF_OTHERS)
def test_no_file_of_another_machine_is_looked_for(tmp_path, name):
    """Windows sends the user's name and a hash of the password to whoever it names."""
    mesh, layout = f"[surface]\nunit = 'mm'\nmesh = '{name}'\n", f"modules = '{name}'\n"
    assert "on another machine" in sentence_of(load_scene, scene(tmp_path, GOOD + mesh))
    assert "on another machine" in sentence_of(load_scene, scene(tmp_path, GOOD + layout))


def test_names_that_the_system_refuses(tmp_path):
    assert "cannot be read" in sentence_of(load_scene, tmp_path / ("x" * 300))
    assert "cannot be read" in sentence_of(mesh_of, tmp_path / "a\0b.stl")
    text = GOOD + '[surface]\nunit = "mm"\nmesh = "a\\u0000b.stl"\n'
    assert "control character" in sentence_of(load_scene, scene(tmp_path, text))


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    "text",
    [
        GOOD + "range = " + "[" * 5000 + "]" * 5000,
        GOOD + "range = [" + "9" * 5000 + ", 1]",
        GOOD + "range = [0x" + "f" * 40000 + ", 1]",
        GOOD.replace("channels = 4", "channels = 0x" + "f" * 40000),
        GOOD.replace("channels = 4", "channels = " + "9" * 400),
        GOOD + "range = [" + "1, " * 50_000 + "1]",
        GOOD + "[" + "a." * 200_000 + "b]",
        GOOD + "a." * 200_000 + "b = 1",
        GOOD + "x" * 1_000_000 + " = 1",
        GOOD.replace('"n"', '"' + "n" * 100_000 + '\\u0007"'),
        GOOD.replace('"l"', "7" * 4000),
    ],
)
def test_scenes_that_go_on_and_on(tmp_path, text):
    sentence_of(load_scene, scene(tmp_path, text))


@pytest.mark.parametrize("letter", ["\\u001b[2J", "\\n", "\\u202e", "\\u0000", "\\u009b"])
@pytest.mark.parametrize("key", ["name", "link", "landmark", "pose", "kind"])
def test_no_name_of_a_scene_holds_a_control_character(tmp_path, letter, key):
    """They reach the terminal, headers of files and the robot's configuration."""
    joints = "[arm]\njoints = [0]\ndh = [[0.0, 0.1, 0.0, 0.0]]\nbase_from_sensor = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n"
    text = {
        "name": GOOD.replace('"n"', f'"n{letter}"'),
        "link": GOOD.replace('"l"', f'"l{letter}"'),
        "landmark": GOOD + f'[[landmarks]]\nname = "a{letter}"\nplace = [0, 0, 0]\n',
        "pose": GOOD + joints + f'[arm.poses]\n"a{letter}" = [0.0]\n',
        "kind": "",
    }[key]
    if key == "kind":
        layout = f'[kinds."a{letter}"]\npads_mm = [[0, 0]]\noutline_mm = []\ncentre_pad = 0\n'
        assert "control character" in sentence_of(read_layout, layout, tmp_path / "l.toml", 4)
    else:
        assert "control character" in sentence_of(load_scene, scene(tmp_path, text))


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000,
        '{"taxels": ' + "[" * 5000 + "]" * 5000 + "}",
        '{"taxels": [{"channel": ' + "9" * 5000 + ', "position_m": [0, 0, 0]}]}',
        '{"taxels": [{"channel": 1, "position_m": [1' + "0" * 400 + ", 0, 0]}]}",
        '{"taxels": [{"channel": 1e400, "position_m": [0, 0, 0]}]}',
        '{"taxels": {"channel": 1}}',
        "[1, 2]",
        "7",
    ],
)
def test_a_truth_that_is_none(tmp_path, text):
    (tmp_path / "truth.json").write_text(text, encoding="utf-8")
    sentence_of(read_reference, tmp_path / "truth.json")


def test_a_document_has_whole_numbers_of_64_bits():
    assert given.parse_json(json.dumps([2**63 - 1, -(2**63)])) == [2**63 - 1, -(2**63)]
    for number in (2**63, -(2**63) - 1, 10**30):
        with pytest.raises(ValueError, match="whole number"):
            given.parse_json(json.dumps(number))


def ply(*lines, form="ascii", body=b""):
    return "\n".join(["ply", f"format {form} 1.0", *lines, "end_header", ""]).encode() + body


@pytest.mark.timeout(10)
@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.ply", ply("element nothing 1000000000000", "element vertex 0", "property float x")),
        ("a.ply", ply("element nothing -1", "element vertex 0", "property float x")),
        ("a.ply", ply("element other 1000000000000", "property float x", body=b"1 2 3\n" * 10)),
        ("a.ply", ply("element vertex 3", "property float x", body=b"1 " * 100_000 + b"1" * 200_000)),
        ("a.stl", b"solid a\n" + b"vertex 1 2 3\n" * 60_000 + b"vertex 1 2 " + b"1" * 200_000),
        ("a.obj", b"v 1 2 " + b"1" * 200_000 + b"x\n"),
    ],
)
def test_a_mesh_that_claims_much(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    import tracemalloc

    tracemalloc.start()
    sentence_of(mesh_of, tmp_path / name)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200 << 20


@pytest.mark.timeout(30)
def test_thousands_of_vertices_in_a_micrometre(tmp_path):
    rng = np.random.default_rng(1)
    points = rng.uniform(0, 1e-4, (60_000, 3))
    points[0], points[1] = (0, 0, 0), (40, 40, 40)
    text = "\n".join(f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist())
    text += "\n" + "\n".join(f"f {k} {k + 1} {k + 2}" for k in range(1, 59_998))
    (tmp_path / "a.obj").write_text(text)
    assert "pairs" in sentence_of(mesh_of, tmp_path / "a.obj")


def test_text_meshes_have_a_limit(monkeypatch, tmp_path):
    monkeypatch.setattr("skincal.mesh.file_numbers.MAX_TEXT_MESH_BYTES", 100)
    for name, data in (("a.obj", b"v 1 2 3\n" * 20), ("a.off", b"OFF 1 1\n" * 20), ("a.stl", b"solid " * 20)):
        assert "bytes of text" in sentence_of(read_mesh, tmp_path / name, data)


def test_a_sentence_keeps_its_beginning_and_its_end():
    error = InputError(f"/{'x' * 400}/{'y ' * 400}: is \x1b[2Jlong; make it short.")
    assert len(str(error)) <= ERROR_SENTENCE_MAX_CHARS
    assert str(error).startswith("/xxx")
    assert str(error).endswith("make it short.")
    assert "\x1b" not in str(error)
    assert str(InputError("as it is\N{BULLET}")) == "as it is\N{BULLET}"


@pytest.mark.skipif(sys.platform == "win32", reason="rights are others there")
def test_a_file_without_rights_or_behind_itself(tmp_path):
    (tmp_path / "a.stl").symlink_to(tmp_path / "a.stl")
    assert "cannot be read" in sentence_of(mesh_of, tmp_path / "a.stl")
