"""Every decoder and reader with what nobody would write: success, or the program's own error. Seeded; see docs/security.md."""

import os
import random
import re
import shutil
import warnings
import zlib

import pytest

from skincal.cli import main
from skincal.files.icub import read_icub
from skincal.files.importers.csv_log import read_csv
from skincal.files.reference import read_reference
from skincal.journal.documents import lines_path
from skincal.journal.writer import create_session
from skincal.mesh.load import read_mesh
from skincal.model.errors import SENTENCE_MOST, InputError
from skincal.model.readings import Stream
from skincal.model.scene import load_scene
from skincal.model.skin import read_layout
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.streams.decoders.detect import NAMES, LinkDecoder
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene

INPUTS = int(os.environ.get("SKINCAL_FUZZ", "300"))
"""Inputs of each reader; a session's costs twenty times as much, and has a twentieth."""
pytestmark = pytest.mark.timeout(0 if INPUTS > 1000 else 120)
PIECES = (b"", b"0", b"-1", b"1e308", b"nan", b"inf", b"9" * 30, b"\x00", b"\xff\xfe", b"\n", b'"', b"[[", b"]]", b"=", b"{}")

SCENE = b"""name = "n"
link = "l"
[skin]
channels = 24
polarity = "up"
range = [0, 255]
[sensor]
pose = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]
[wrench]
sign = 1
[contacts]
force_min = 4.0
[noise]
force = 0.1
[[landmarks]]
name = "a"
place = [0.0, 0.0, 0.1]
normal = [0, 0, 1]
"""
LAYOUT = b"""[kinds.own]
pads_mm = [[0, 0], [5, 0], [0, 5]]
outline_mm = [[-5, -5], [5, -5], [0, 9]]
centre_pad = 0
[[modules]]
id = 0
kind = "own"
first_channel = 0
place_mm = [1.0, 2.0]
angle_deg = 30.0
mirror = true
[[modules]]
id = 1
kind = "triangle_12"
first_channel = 12
"""
TRUTH = b'{"link": "l", "taxels": [{"channel": 0, "position_m": [0.1, 0.2, 0.3]}, {"channel": 1, "position_m": [0, 0, 1]}]}'
ICUB = b"name a\ntaxel2Repr (0 0)\n[calibration]\n0.1 0.2 0.3 0 0 1\n0 0 0 0 0 0\n# end\n"
OBJ = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1/1 2/2 4/4 3\nf -1 -2 -3\n"
OFF = b"OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n4 0 1 2 3\n"
PLY = b"""ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
3 0 1 2
"""
PLY_BYTES = PLY[: PLY.index(b"0 0 0\n")].replace(b"ascii", b"binary_little_endian") + bytes(36) + b"\x03" + bytes(12)
STL = b"x" * 80 + (2).to_bytes(4, "little") + bytes(100)
STL_WORDS = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
CSV = b"t_s,fx,fy,fz,mx,my,mz\n" + b"".join(b"%d.5,1,2,3,4,5,6\n" % k for k in range(20))


def twisted(rng: random.Random, data: bytes) -> bytes:
    """Flip, cut, swap, repeat, and put in what means something."""
    out = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at, end = sorted((rng.randrange(len(out) + 1), rng.randrange(len(out) + 1)))
        match rng.randrange(6):
            case 0 if out:
                out[min(at, len(out) - 1)] ^= 1 << rng.randrange(8)
            case 1:
                del out[at : at + rng.randint(1, 40)]
            case 2:
                out = out[:at]
            case 3:
                out[at:at] = rng.choice(PIECES)
            case 4:
                out[at:at] = out[at:end][:2000]
            case _:
                numbers = list(re.finditer(rb"-?\d+(\.\d+)?", bytes(out)))
                if numbers:
                    one = rng.choice(numbers)
                    out[one.start() : one.end()] = rng.choice(PIECES)
    return bytes(out)


def try_all(name, seed, work, inputs):
    """Do `work` with each input; anything but success or the program's error fails, with the seed that shows it."""
    for count in range(inputs):
        rng = random.Random(f"{name} {seed} {count}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                work(rng)
        except InputError as error:
            said = str(error)
        except Exception as error:
            raise AssertionError(f"{name}: input {count} of seed {seed}: {error!r}") from error
        else:
            said = ""
        assert len(said) <= SENTENCE_MOST


def file_reader(read, *suffixed):
    def work_in(folder):
        def work(rng):
            name, data = rng.choice(suffixed)
            path = folder / name
            path.write_bytes(twisted(rng, data))
            read(path)

        return work

    return work_in


def read_all_csv(path):
    _, chunks, _ = read_csv(path, path)
    for _ in chunks:
        pass


FILES = {
    "scene": file_reader(load_scene, ("a.toml", SCENE)),
    "layout": file_reader(lambda path: read_layout(path.read_bytes().decode("utf-8", "replace"), path, 24), ("a.toml", LAYOUT)),
    "truth": file_reader(read_reference, ("a.json", TRUTH)),
    "icub": file_reader(read_icub, ("a.txt", ICUB)),
    "csv": file_reader(read_all_csv, ("a.csv", CSV)),
    "obj": file_reader(lambda path: read_mesh(path, path.read_bytes()), ("a.obj", OBJ)),
    "off": file_reader(lambda path: read_mesh(path, path.read_bytes()), ("a.off", OFF)),
    "ply": file_reader(lambda path: read_mesh(path, path.read_bytes()), ("a.ply", PLY), ("b.ply", PLY_BYTES)),
    "stl": file_reader(lambda path: read_mesh(path, path.read_bytes()), ("a.stl", STL), ("b.stl", STL_WORDS)),
}


@pytest.mark.parametrize("name", FILES)
def test_files(name, tmp_path):
    try_all(name, 1, FILES[name](tmp_path), INPUTS)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    scene = write_scene(folder / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(folder / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 1).samples)
    for item in items:
        pipeline.feed(item)
    pipeline.close()
    return folder / "s", b"".join(item.data for item in items if hasattr(item, "data"))


@pytest.mark.parametrize("name", NAMES)
def test_decoders(name, recorded):
    def work(rng):
        decoder = LinkDecoder(name, 24, tuple(Stream))
        begin = rng.randrange(len(recorded[1]))
        data = rng.randbytes(500) if rng.random() < 0.3 else twisted(rng, recorded[1][begin : begin + 2000])
        cut = rng.randrange(len(data) + 1)
        for count, piece in enumerate((data[:cut], data[cut:])):
            decoder.feed(piece, count * 400_000_000)
        decoder.finish()

    try_all(name, 1, work, INPUTS)


def sealed(lines):
    """Right checksums over lines that were changed, as a stranger would make them."""
    found, out = 0, []
    for line in lines:
        body = line[12:]
        found = zlib.crc32(body, found)
        out.append(b'["%08x",' % found + body)
    return b"".join(out)


@pytest.mark.parametrize("kind", ["bytes", "lines", "sealed lines"])
def test_sessions(kind, recorded, tmp_path):
    def work(rng):
        folder = shutil.copytree(recorded[0], tmp_path / "s", dirs_exist_ok=True)
        path = folder / "segment-0001.mcap"
        if kind == "bytes":
            path.write_bytes(twisted(rng, path.read_bytes()))
            lines_path(path).unlink()
        else:
            lines = lines_path(path).read_bytes().splitlines(keepends=True)
            at = rng.randrange(len(lines))
            lines[at] = twisted(rng, lines[at].rstrip(b"\n")).replace(b"\n", b"") + b"\n"
            lines_path(path).write_bytes(sealed(lines) if kind == "sealed lines" else b"".join(lines))
        (load if rng.random() < 0.7 else replay)(folder).snapshot()

    try_all(kind, 1, work, max(INPUTS // 20, 5))


WORDS = [
    *[
        "solve",
        "export",
        "record",
        "simulate",
        "import",
        "csv",
        "yarp",
        "study",
        "landmarks",
        "--out",
        "--scene",
        "--wrench",
        "--skin",
        "--format",
        "--json",
        "--pose",
    ],
    *[
        "flat-patch",
        "icub-forearm",
        "/dev/null",
        "none",
        "-1",
        "1e9",
        "--pokes",
        "spy:///dev/null",
        "socket://[::1",
        "file:none",
        "--at",
        "1=a",
        "--",
        "--seed",
    ],
    *("", "x" * 300, "\udcff", "a\nb"),
]


def test_bad_command_lines(tmp_path, monkeypatch, capsys):
    """130 of them, none of which could record anything."""
    monkeypatch.chdir(tmp_path)
    for count in range(130):
        rng = random.Random(f"words {count}")
        words = [rng.choice(WORDS) for _ in range(rng.randint(1, 7))]
        words += ["--no-such-option"]
        assert main(words) in (0, 2), words
        assert "Traceback" not in capsys.readouterr().err, words
