"""Every decoder and reader with what nobody would write: success, or the program's own error. Seeded; see docs/security.md."""

import contextlib
import os
import random
import re
import shlex
import shutil
import sys
import time
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest

from skincal.cli import main
from skincal.devices.decoding import pack
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.netft import RECORDS
from skincal.devices.registry import FAMILIES, load_family, parse_device
from skincal.files.icub import read_icub
from skincal.files.reference import read_reference
from skincal.journal.line_file import lines_path
from skincal.journal.writer import create_session
from skincal.mesh.load import read_mesh
from skincal.model.errors import ERROR_SENTENCE_MAX_CHARS, InputError, plain_text
from skincal.model.readings import Stream
from skincal.model.scene import load_scene
from skincal.model.skin import read_layout
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.simulation.emulated_devices import MAKERS, NameTalk, PageTalk, PlainTalk, RtdeTalk, YarpTalk
from skincal.simulation.emulated_skins import InspireTalk, LeptrinoTalk, PaxiniModuleTalk, PaxiniTalk, Tsf85Talk
from skincal.simulation.emulated_trackers import NdiTalk, QtmTalk
from skincal.streams import opening
from skincal.streams.decoders.auto_detect import NAMES, LinkDecoder
from tests.skincal.import_support import read_recording
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene

INPUTS = int(os.environ.get("SKINCAL_FUZZ", "300"))
"""Inputs of each reader."""
SESSIONS = INPUTS if "SKINCAL_FUZZ" in os.environ else 20
"""Inputs of what reads sessions: each costs twenty times as much."""
MOST_S = 5.0
"""s of processor time that an input may cost."""
MOST_BYTES = 500 << 20
"""Memory that an input may ask for, beyond what the process has when its reader is called first."""
pytestmark = pytest.mark.timeout(max(120, INPUTS // 10))
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
DAE = b"""<COLLADA><asset><unit meter="0.01"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="s"><float_array id="a" count="12">0 0 0 1 0 0 0 1 0 0 0 1</float_array><technique_common>
<accessor source="#a" count="4" stride="3"/></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
<polylist count="2"><input semantic="VERTEX" source="#v" offset="0"/><vcount>3 4</vcount><p>0 1 2 0 1 2 3</p></polylist>
<triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
</library_geometries><library_visual_scenes><visual_scene id="w"><node><translate>1 0 0</translate><rotate>0 0 1 30</rotate>
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#w"/></scene></COLLADA>"""
GLTF = b"""{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "scale": [1, 2, 3], "children": [1]},
{"mesh": 0, "rotation": [0, 0, 0, 1]}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1},
{"attributes": {"POSITION": 0}, "mode": 5}]}], "accessors": [
{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
{"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
"buffers": [{"byteLength": 60}],
"bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}]}"""
GLB_NUMBERS = np.eye(4, 3, dtype="<f4").tobytes() + bytes([0, 0, 1, 0, 2, 0, 1, 0, 2, 0, 3, 0])
GLB = b"".join(
    (
        b"glTF", (2).to_bytes(4, "little"), (28 + len(GLTF) + len(GLB_NUMBERS)).to_bytes(4, "little"),
        len(GLTF).to_bytes(4, "little"), b"JSON", GLTF, len(GLB_NUMBERS).to_bytes(4, "little"), b"BIN\0", GLB_NUMBERS,
    )
)  # fmt: skip
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


@contextlib.contextmanager
def bounded_memory():
    """Refuse the process more than `MOST_BYTES` beyond what it has: more ends as a `MemoryError`. Linux alone holds that."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def try_all(name, seed, work, inputs):
    """Do `work` with each input: it succeeds or raises the program's error, within the limits; what fails names its input."""
    with bounded_memory(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for count in range(inputs):
            begun_s = time.process_time()
            try:
                said = outcome_of(work, random.Random(f"{name} {seed} {count}"))
                assert len(said) <= ERROR_SENTENCE_MAX_CHARS
                assert time.process_time() - begun_s < MOST_S
            except BaseException as error:  # also the one by which a test that takes too long is ended
                error.add_note(f"{name}: input {count} of seed {seed}")
                raise


def outcome_of(work, rng):
    """What the program said of the input; empty where it took it."""
    try:
        work(rng)
    except (InputError, LinkError) as error:
        return str(error)
    return ""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no other system refuses memory")
def test_an_input_that_takes_too_much_memory_is_told():
    with pytest.raises(MemoryError) as raised:
        try_all("memory", 1, lambda _: bytearray(2 * MOST_BYTES), 1)
    assert raised.value.__notes__ == ["memory: input 0 of seed 1"]
    try_all("memory", 1, lambda _: bytearray(MOST_BYTES // 2), 3)


def test_an_input_that_takes_too_long_is_told(monkeypatch):
    monkeypatch.setitem(globals(), "MOST_S", 0.05)

    def work(_):
        begun_s = time.process_time()
        while time.process_time() - begun_s < 0.06:
            pass

    with pytest.raises(AssertionError) as raised:
        try_all("time", 1, work, 1)
    assert raised.value.__notes__ == ["time: input 0 of seed 1"]


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
    _, chunks, _ = read_recording("csv", path, path)
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
    "dae": file_reader(lambda path: read_mesh(path, path.read_bytes()), ("a.dae", DAE)),
    "glb": file_reader(lambda path: read_mesh(path, path.read_bytes()), ("a.glb", GLB), ("a.gltf", GLTF)),
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
    pipeline.snapshot()  # starts the solver, which reserves address space of 4 GB, and touches little of it
    pipeline.close()
    return folder / "s", b"".join(item.data for item in items if hasattr(item, "data"))


VECTORS = {vector.format: vector for file in FAMILIES for vector in load_family(file).vectors}


@pytest.mark.parametrize("name", NAMES)
def test_decoders(name, recorded):
    """Of noise, of a board's lines and, for a maker's format, of what its device sends."""

    def work(rng):
        vector = VECTORS.get(name) if rng.random() < 0.6 else None
        if vector is not None:
            decoder = LinkDecoder(name, vector.channels or 24, vector.carries)
            data = twisted(rng, 4 * vector.data)
        else:
            decoder = LinkDecoder(name, 24, tuple(Stream))
            begin = rng.randrange(len(recorded[1]))
            data = rng.randbytes(500) if rng.random() < 0.3 else twisted(rng, recorded[1][begin : begin + 2000])
        cut = rng.randrange(len(data) + 1)
        for count, piece in enumerate((data[:cut], data[cut:])):
            decoder.feed(piece, count * 400_000_000)
        decoder.finish()

    try_all(name, 1, work, INPUTS)


class Twisting:
    """A device that answers as a simulated one does, then sends what it reads, all of it more or less changed, then is gone."""

    def __init__(self, rng, talk, stream=b""):
        self._rng, self._talk, self._stream, self._out = rng, talk, stream, b""

    def _send(self, data):
        self._out += twisted(self._rng, data) if data and self._rng.random() < 0.4 else data

    def write(self, data):
        self._send(self._talk.on_request(data))

    def read(self, _timeout_s):
        if not self._out and self._talk.ready:
            stream, self._stream = self._stream, b""
            self._send(self._talk.frame(stream))
        if not self._out:
            raise LinkError(FailureKind.VANISHED, "gone")
        cut = self._rng.randint(1, len(self._out))
        data, self._out = self._out[:cut], self._out[cut:]
        return data

    def close(self):
        pass


def stream_of(maker):
    """What a maker's device sends, ten readings."""
    encoder = MAKERS[maker].encoder()
    if Stream.TOOL in MAKERS[maker].carries and Stream.WRENCH not in MAKERS[maker].carries:
        return b"".join(
            encoder.encode(Stream.TOOL, np.arange(10) * 10_000, np.tile([0.1, 0.2, 0.3, 0.0, 0.6, 0.0, 0.8], (10, 1)))
        )
    if Stream.WRENCH in MAKERS[maker].carries:
        return b"".join(encoder.encode(Stream.WRENCH, np.arange(10) * 10_000, np.full((10, 6), 1.5)))
    return b"".join(encoder.encode(Stream.SKIN, np.arange(10) * 10_000, np.tile(np.arange(24.0), (10, 1))))


YARP_SERVER = 10000
TALKS = {
    "netft": ("netft://127.0.0.1:9", PageTalk),
    "yarp": (f"yarp://h:{YARP_SERVER}/p", lambda: YarpTalk(7)),
    "bota": ("bota:x", PlainTalk),
    "robotiq": ("robotiq:x", PlainTalk),
    "robotiq-text": ("robotiq://h", PlainTalk),
    "rtde": ("rtde://h", RtdeTalk),
    "papillarray": ("papillarray:x", PlainTalk),
    "justfloat": ("justfloat:x", PlainTalk),
    "flexitac": ("flexitac:x", PlainTalk),
    "anyskin": ("anyskin:x", PlainTalk),
    "leptrino": ("leptrino:x", LeptrinoTalk),
    "tsf85": ("tsf85:x?channels=0-23&of=56", Tsf85Talk),
    "inspire": ("inspire://h?channels=0-23&of=1062", InspireTalk),
    "paxini": ("paxini:x", lambda: PaxiniTalk(24)),
    "paxini-module": ("paxini-module:x?taxels=24", PaxiniModuleTalk),
    "qtm": ("qtm://h?body=probe", QtmTalk),
    "ndi": ("ndi:x?body=02", NdiTalk),
}
"""Of each maker the address, and its device's side of the talk."""


@pytest.mark.parametrize("maker", TALKS)
def test_devices(maker, monkeypatch):
    """A sensor's page, a name server's answers, handshakes: opened and read until the device is gone."""
    (address, talk), carries, stream = TALKS[maker], MAKERS[maker].carries[:1], stream_of(maker)

    def work(rng):
        def tcp(_address, _host, port):
            return Twisting(rng, NameTalk({"/p": 7}), b"") if port == YARP_SERVER else Twisting(rng, talk(), stream)

        monkeypatch.setattr(opening, "TcpLink", tcp)
        monkeypatch.setattr(opening, "open_transport", lambda _: Twisting(rng, talk(), stream))
        link = opening.open_address(parse_device(address), carries)
        decoder = LinkDecoder(parse_device(address).route.format, 24, carries)
        with contextlib.closing(link):
            for count in range(1000):
                decoder.feed(link.read(0.0), count * 10_000_000)
                if maker == "netft":  # its records are datagrams, and none come
                    decoder.feed(pack(RECORDS, twisted(rng, stream)), count)
                    return

    try_all(maker, 1, work, INPUTS)


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

    try_all(kind, 1, work, SESSIONS)


NAMES_OF_NOTHING = [
    *("", "none", "x" * 300, "x/" * 2000, "\udcff", "a\nb", "\x1b[2J", "\u202egpj", "a\x00b", "/dev/null", "/dev/zero", "-"),
    "~nobody",
]
NO_NUMBERS = ["", "many", "-1", "nan", "1e999", "0x10", "9" * 5000, "\N{DEVANAGARI DIGIT FOUR}.", "1,5", "\x1b[2J"]
NO_ADDRESSES = [
    *(
        "",
        "spy:///dev/null?file=f",
        "alt://x",
        "hwgrep://x",
        "rfc2217://x:1",
        "loop://",
        "socket://[::1",
        "socket://x:99999999",
    ),
    *("socket://:1", "netft://", "netft://x:y", "netft://x?no=1", "yarp:", "bota:", "xela://x:-1", "lines://x"),
]
PATCH = "--scene flat-patch --out made"
ENDLESS = f"--wrench file:none --skin file:none {PATCH}"
"""A recording that would end by a number or a name alone that is wrong."""
LINES = f"""
fly
solve
record
import
import tape
study life
\x1b[2J
--fly
--\x1b[2J
{"x" * 5000}
simulate --scene flat-patch
simulate {PATCH} --serve
simulate {PATCH} --tcp
simulate {PATCH} --as netft
simulate {PATCH} --operator told
simulate {PATCH} --errors all
simulate {PATCH} --poses 1
simulate {PATCH} --pokes 3 --pace 9
simulate --scene flat-patch --serve --as netft,netft,netft
simulate --scene flat-patch --serve --as \x1b[2J
simulate --scene flat-patch --pokes 1 --out s
simulate --scene flat-patch --out f
record {ENDLESS} --pose 1
record {ENDLESS} --pose \x1b[2J
record {ENDLESS} --orders=no
record --wrench file:none --skin file:none --scene icub-forearm --out made
record --wrench file:none --skin file:none --scene flat-patch --out s
solve f
solve s s
solve s \x1b[2J
solve s {"x" * 5000}
solve s/scene
solve s --part chest
solve s --out f
solve s --reference f
solve s --layout f
solve s --json=3
export s --format icub
export s --format icub --out s
export s --format csv --out made --part chest
export s --format \x1b[2J --out made
export s --format json --out s/segment-0001.mcap
export s --format json --out /dev/null
export s --format json --out made --method guess
report s --out s
report s --out s/segment-0001.jsonl
compare s
compare s:guess s
compare s f
compare s:truth s
landmarks s --at 1
landmarks s --at =a
landmarks s --at {"9" * 30}=a
landmarks s --at 1=\x1b[2J
landmarks s --add a 1 2
landmarks s --add "" 1 2 3
landmarks s --add a nan 2 3
landmarks s --csv f
landmarks s --order ;;;
landmarks s --undo --find
study runtime --quick --out f
study paper --out f/x
watch
watch file:none --carries all
watch file:none --carries {"x" * 5000}
devices all
import csv --wrench f --skin f {PATCH}
import csv --wrench s --skin s {PATCH}
import yarp --wrench f --skin f {PATCH}
import yarp --wrench s --skin s {PATCH}
"""
COMMAND_LINES = [
    *(shlex.split(line) for line in LINES.splitlines()),
    *(["solve", name] for name in NAMES_OF_NOTHING),
    *(["export", "s", "--format", "json", "--layout", name, "--out", "made"] for name in NAMES_OF_NOTHING),
    *(["compare", name, "s"] for name in NAMES_OF_NOTHING),
    *(["simulate", "--scene", name, "--out", "made"] for name in NAMES_OF_NOTHING),
    *(["simulate", *PATCH.split(), "--pokes", number] for number in NO_NUMBERS),
    *(["simulate", *PATCH.split(), "--pace", number] for number in NO_NUMBERS),
    *(["record", *ENDLESS.split(), "--pokes", number] for number in NO_NUMBERS),
    *(["record", *ENDLESS.split(), "--seconds", number] for number in ("", "many", "-1", "nan", "1,5")),
    *(["record", "--wrench", address, "--skin", "file:none", *PATCH.split()] for address in NO_ADDRESSES),
    *(["watch", address] for address in NO_ADDRESSES),
]


def test_bad_command_lines(recorded, tmp_path, monkeypatch, capsys):
    """Wrong values, hostile names, what is not there, contradictions: exit code 2, one sentence, nothing made or changed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f").write_bytes(b"")
    session = shutil.copytree(recorded[0], tmp_path / "s")
    before = {path: path.read_bytes() for path in session.rglob("*") if path.is_file()}
    assert len(COMMAND_LINES) >= 130
    for words in COMMAND_LINES:
        begun_s = time.process_time()
        assert main(words) == 2, words
        said = capsys.readouterr().err
        assert time.process_time() - begun_s < MOST_S, words
        assert "Traceback" not in said, words
        assert len(said) <= ERROR_SENTENCE_MAX_CHARS + len("skincal: \n"), words
        assert plain_text(said.rstrip("\n")) == said.rstrip("\n"), words
        assert {path.name for path in tmp_path.iterdir()} == {"f", "s"}, words
    assert {path: path.read_bytes() for path in session.rglob("*") if path.is_file()} == before
