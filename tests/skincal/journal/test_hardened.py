"""Sessions of strangers, folders that vanish, crashes during a recovery: reported, survived, and no other file is touched."""

import contextlib
import json
import math
import os
import shutil
import struct
import tracemalloc
import zlib
from io import BytesIO
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode

from skincal.files.export import write_calibration
from skincal.following.results import SessionResults
from skincal.journal import mcap_file
from skincal.journal.documents import MAX_LINKS
from skincal.journal.line_file import LineWriter
from skincal.journal.mcap_file import is_closed
from skincal.journal.reader import SessionLog, recover_session
from skincal.journal.writer import create_session
from skincal.model.errors import InputError, plain_text
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay, resume
from skincal.taxels.result import Method
from tests.approved import approved
from tests.skincal.journal.journal_support import contacts_of, files_of, record, records_of, refuse
from tests.skincal.poke_script import LINKS, as_chunks, killed, some_pokes, write_scene

posix = pytest.mark.skipif(os.name == "nt", reason="links need rights there, and open files cannot be taken away")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A session of two pokes that was closed."""
    folder = tmp_path_factory.mktemp("hardened")
    record(write_scene(folder / "source"), folder / "s", 2).close()
    return folder / "s"


@pytest.fixture
def session(recorded, tmp_path):
    return shutil.copytree(recorded, tmp_path / "s")


@pytest.fixture
def cut_off(tmp_path):
    """A session of three pokes whose recorder was killed."""
    killed(record(write_scene(tmp_path / "source"), tmp_path / "s", 3))
    return tmp_path / "s"


@posix
@pytest.mark.parametrize("ending", ["mcap", "jsonl"])
def test_a_segment_that_is_a_link_is_refused_and_what_it_leads_to_stays(cut_off, tmp_path, ending):
    path = cut_off / f"segment-0001.{ending}"
    letter = tmp_path / "letter"
    shutil.copy(path, letter)
    path.unlink()
    path.symlink_to(letter)
    before = letter.read_bytes()
    for way in (resume, load, replay):
        with pytest.raises(InputError, match="is a link"):
            way(cut_off)
    assert letter.read_bytes() == before


@pytest.mark.parametrize("torn", [0, 5])
def test_recovery_writes_to_no_other_file(cut_off, tmp_path, torn):
    """Hard links, a stranger's or a backup's, keep their content, and links at the names of new files are not followed."""
    copy = shutil.copytree(cut_off, tmp_path / "copy", copy_function=os.link)
    (copy / "session.lock").unlink()
    path = copy / "segment-0001.jsonl"
    os.truncate(path, path.stat().st_size - torn)
    letter = tmp_path / "letter"
    letter.write_text("dear", encoding="utf-8")
    if os.name != "nt":
        for name in ("segment-0001.mcap.recovering", "segment-0001.mcap.damaged", "segment-0001.jsonl.damaged"):
            (copy / name).symlink_to(letter)
    before, pokes = files_of(cut_off), len(load(cut_off).session.contacts)
    resumed = resume(copy)
    resumed.close()
    assert len(resumed.session.contacts) == pokes >= 2
    assert files_of(cut_off) == before
    assert letter.read_text(encoding="utf-8") == "dear"
    assert all(each.stat().st_nlink == 1 for each in copy.glob("*.jsonl"))


@posix
def test_a_segment_that_is_no_file_is_refused(session):
    path = session / "segment-0001.mcap"
    path.unlink()
    path.symlink_to(session / "nothing")
    with pytest.raises(InputError):
        load(session)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(InputError, match="a device or a pipe"):
        replay(session)


@posix
@pytest.mark.parametrize("gone", ["deleted", "moved", "another"])
def test_a_folder_that_vanishes_is_noticed_within_a_second(tmp_path, gone):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 4).samples)
    half = len(items) // 2
    for item in items[:half]:
        pipeline.feed(item)
    if gone == "deleted":
        shutil.rmtree(tmp_path / "s")
    else:
        (tmp_path / "s").rename(tmp_path / "elsewhere")
    if gone == "another":
        (tmp_path / "s").mkdir()
        (tmp_path / "s" / "segment-0001.mcap").touch()
    for item in items[half:]:
        pipeline.feed(item)
        if pipeline.journal_failure:
            break
    assert approved("session.folder_gone") in pipeline.journal_failure
    assert "export" not in pipeline.journal_failure
    assert (item.host_ns - items[half].host_ns) * 1e-9 < 1.0
    assert pipeline.session.calibration().contacts


def test_a_full_disk_at_the_start_is_not_in_the_way_of_the_next_try(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "source")

    for what in ("write_text", "write_bytes", "fsync"):
        with monkeypatch.context() as patch:
            patch.setattr(os if what == "fsync" else Path, what, refuse)
            with pytest.raises(InputError, match="No space left"):
                create_session(tmp_path / "s", scene, LINKS)
        assert not (tmp_path / "s").exists()
    (tmp_path / "s").mkdir()
    (tmp_path / "s" / "notes.txt").touch()
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", refuse)
        with pytest.raises(InputError, match="No space left"):
            create_session(tmp_path / "s", scene, LINKS)
    assert [path.name for path in (tmp_path / "s").iterdir()] == ["notes.txt"]
    create_session(tmp_path / "s", scene, LINKS).close()


class KilledError(BaseException):
    """Stands for a kill: no handler runs after it."""


@pytest.mark.parametrize("broken", [False, True])
def test_a_kill_between_any_two_steps_of_a_recovery_leaves_a_session_that_opens(tmp_path, monkeypatch, broken):
    """Every change of a name may be the last thing that happens."""
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 3).samples)
    for k, item in enumerate(items):
        pipeline.feed(item)
        if k in (len(items) // 2, len(items) * 3 // 4):
            pipeline.close()
            pipeline = resume(tmp_path / "s")
    killed(pipeline)
    if broken:  # what comes after the first segment is put aside
        path = tmp_path / "s" / "segment-0001.mcap"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        (tmp_path / "s" / "segment-0001.jsonl").unlink()
    wanted = contacts_of(load(tmp_path / "s"))
    for steps in range(20):
        folder = shutil.copytree(tmp_path / "s", tmp_path / f"k{steps}")
        done = recovered_within(folder, steps, monkeypatch)
        assert contacts_of(load(folder)) == wanted
        again = resume(folder)
        assert contacts_of(again) == wanted
        again.close()
        if done:
            assert steps > 1
            return
    pytest.fail("more steps than were tried")


def recovered_within(folder, steps, monkeypatch):
    """Recover a session that is killed after so many changes of names; return whether it came to its end."""
    left = [steps]

    def counted(real):
        def step(self, *arguments, **options):
            if left[0] == 0:
                raise KilledError
            left[0] -= 1
            return real(self, *arguments, **options)

        return step

    with monkeypatch.context() as patch:
        for name in ("rename", "replace", "unlink"):
            patch.setattr(Path, name, counted(getattr(Path, name)))
        with contextlib.suppress(KilledError):
            recover_session(folder)
            return True
    return False


def test_a_chunk_that_was_moved_is_a_finding(session):
    path = session / "segment-0001.mcap"
    data = path.read_bytes()
    _, (a, b), _, (c, d), *_ = records_of(data, Opcode.CHUNK)
    path.write_bytes(data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:])
    log = SessionLog(session)
    list(log.items())
    assert any("missing" in sentence for sentence in log.findings)


def test_no_bit_of_an_index_hides_a_poke(cut_off):
    """Of a segment that was not closed, without its lines, too: indexes are not read."""
    path = cut_off / "segment-0001.mcap"
    (cut_off / "segment-0001.jsonl").unlink()
    data = path.read_bytes()
    whole = contacts_of(load(cut_off))
    assert len(whole) >= 2
    indexes = list(records_of(data, Opcode.MESSAGE_INDEX))
    for begin, end in indexes[:: len(indexes) // 3]:
        for at in {begin + 9, begin + 11, begin + 12, begin + 13, begin + 14, end - 1}:
            changed = bytearray(data)
            changed[at] ^= 0x40
            path.write_bytes(changed)
            assert contacts_of(load(cut_off)) == whole  # a replay, without lines


def chunk(compression, claimed, data):
    body = struct.pack("<QQQI", 0, 0, claimed, 0) + struct.pack("<I", len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def zeros_of(size):
    """A frame of zstd that says it unpacks to so much, and does."""
    out = BytesIO()
    with zstandard.ZstdCompressor().stream_writer(out, size=size, closefd=False) as stream:
        block = bytes(1 << 24)
        for _ in range(size >> 24):
            stream.write(block)
    return out.getvalue()


CLAIMS = {
    "a chunk of 4 GB": chunk(b"zstd", 4 << 30, zeros_of(1 << 28)),
    "a frame of 256 MB that the chunk denies": chunk(b"zstd", 1000, zeros_of(1 << 28)),
    "lz4": chunk(b"lz4", 4 << 30, b"\x04\x22\x4d\x18" + bytes(100)),
    "a record of 4 GB": struct.pack("<BQ", Opcode.MESSAGE, 4 << 30),
}


@pytest.mark.timeout(20)
@pytest.mark.parametrize("claim", CLAIMS)
def test_what_a_file_claims_to_unpack_to_is_not_believed(session, claim):
    path = session / "segment-0001.mcap"
    (session / "segment-0001.jsonl").unlink()
    data = path.read_bytes()
    first = next(end for _, end in records_of(data, Opcode.CHUNK))
    path.write_bytes(data[:first] + CLAIMS[claim])
    tracemalloc.start()
    found = [load(session).findings, replay(session).findings]
    assert tracemalloc.get_traced_memory()[1] < 150 << 20
    tracemalloc.stop()
    assert all(sentences for sentences in found)


def with_documents(folder, *documents):
    """Give a session the lines of a stranger, with right checksums."""
    path = folder / "segment-0001.jsonl"
    head = json.dumps(json.loads(path.read_bytes().splitlines()[0])[3]).encode()
    path.unlink()
    lines = LineWriter(path)
    for count, document in enumerate((head, *documents)):
        lines.add(count + 1, "", document)
    lines.close(len(documents) + 1)


LINK = {"name": "a", "address": "COM3", "carries": ["skin"], "format": "auto"}
BAD = [
    b"[" * 6000 + b"]" * 6000,
    b"7",
    b'"text"',
    b'{"type": "link"}',
    b'{"type": "link", "link": 7, "state": "open", "text": ""}',
    b'{"type": "link", "link": "skin", "state": [], "text": ""}',
    b'{"type": "end", "host_ns": ' + b"9" * 4400 + b"}",
    b'{"type": "end", "host_ns": "x"}',
    b'{"type": ["end"]}',
    b'{"type": "segment"}',
    b'{"type": "segment", "format": "3"}',
    b'{"type": "segment", "format": 3, "segment": 1, "links": 7, "scene": ""}',
    *(
        json.dumps({"type": "segment", "format": 3, "segment": 1, "links": links}).encode()
        for links in ([LINK] * (MAX_LINKS + 1), [LINK | {"address": "x" * 1001}])
    ),
    b'{"type": "action"}',
    b'{"type": "action", "do": []}',
    b'{"type": "action", "do": "exclude", "poke": 1e400}',
    b'{"type": "taken"}',
    b'{"type": "taken", "outcomes": 7}',
    b'{"type": "taken", "outcomes": [7]}',
    b'{"type": "taken", "outcomes": [{"is": "contact"}]}',
    b'{"type": "taken", "outcomes": [{"is": "rejection", "reason": "NONE"}]}',
    b'{"type": "taken", "outcomes": [], "dead": {"x": "y"}}',
    b'{"type": "taken", "outcomes": [], "dead": {"99": "y"}}',
    b'{"type": "totals", "links": [], "unpaired": 0}',
    b'{"type": "totals", "links": {"a": {}}, "unpaired": 0}',
]
CONTACT = {
    "is": "contact", "poke": 1, "start_s": 1.0, "end_s": 1.3, "force": [0.0, 0.0, -8.0], "moment": [0.0, 0.0, 0.0],
    "channels": [3], "responses": [50.0], "pose": "", "tare_change": None, "final": True,
    "link_from_sensor": [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
}  # fmt: skip
WRONG = [
    ("poke", -1), ("poke", "1"), ("poke", 2**62), ("force", [1.0, 2.0]), ("force", [0, 0, 0]), ("force", [None, 0, 1]),
    ("force", [1, math.nan, 1]), ("moment", [0, 0, math.inf]), ("responses", [math.nan]),
    ("force", [1e200, 0, 0]), ("moment", "x"), ("channels", [24]), ("channels", [-1]), ("channels", [3, 3]), ("channels", []),
    ("responses", [0.0]), ("responses", [1.0, 2.0]), ("pose", 7), ("final", 1), ("link_from_sensor", [1, 2, 3]),
    ("link_from_sensor", [[None] * 4] * 4), ("start_s", []), ("start_s", 1e300), ("doubt", 7), ("doubt", {}),
]  # fmt: skip


@pytest.mark.parametrize("document", BAD + [
    json.dumps({"type": "taken", "host_ns": 1, "outcomes": [CONTACT | {key: value}]}).encode() for key, value in WRONG
])  # fmt: skip
def test_events_and_results_that_nobody_wrote_end_in_a_sentence(session, document):
    with_documents(session, json.dumps({"type": "taken", "host_ns": 1, "outcomes": [CONTACT]}).encode())
    assert len(load(session).session.contacts) == 1
    with_documents(session, document)
    with pytest.raises(InputError):
        load(session)


NAMED = "a\n\x1b[2J\u202e"


@pytest.mark.parametrize("format_", ["icub", "csv", "ply"])
def test_no_name_of_a_journal_brings_a_control_character_into_a_file(session, tmp_path, format_):
    landmark = {"type": "action", "host_ns": 1, "do": "add_landmark", "name": NAMED, "x": 0.0, "y": 0.0, "z": 0.1}
    poke = {"type": "taken", "host_ns": 1, "outcomes": [CONTACT | {"pose": NAMED, "poke": k} for k in (1, 2, 3)]}
    with_documents(session, *(json.dumps(document).encode() for document in (landmark, poke)))
    pipeline = load(session)
    session = pipeline.session
    assert session.contacts[0].pose == NAMED
    assert not session.decisions.landmarks, "a landmark with such a name is refused"
    write_calibration(SessionResults(pipeline).calibration(), format_, tmp_path / "out", Method.FREE)
    written = (tmp_path / "out").read_text(encoding="utf-8").replace("\r\n", "\n")
    assert all(plain_text(line) == line for line in written.split("\n"))


def test_a_first_line_without_a_key_ends_in_a_sentence(session):
    path = session / "segment-0001.jsonl"
    body = b"0,,7]\n"
    path.write_bytes(b'["%08x",' % zlib.crc32(body) + body)
    with pytest.raises(InputError):
        load(session)


def test_a_million_lines_end_at_the_first_that_is_damaged(session):
    """Ten bytes each would be as many objects."""
    path = session / "segment-0001.jsonl"
    path.write_bytes(path.read_bytes() + b"\n" * 3_000_000)
    tracemalloc.start()
    load(session)
    assert tracemalloc.get_traced_memory()[1] < 40 << 20
    tracemalloc.stop()


def test_an_index_has_a_limit(session, monkeypatch):
    """What says that it is longer is not read, and the records are."""
    path = session / "segment-0001.mcap"
    assert is_closed(path)
    size = path.stat().st_size
    begin = int.from_bytes(path.read_bytes()[-28:-20], "little")
    monkeypatch.setattr(mcap_file, "MAX_SUMMARY_BYTES", size - begin - 1)
    assert not is_closed(path)
    assert contacts_of(load(session)) == contacts_of(replay(session))


def test_a_scene_folder_has_few_files(session):
    for number in range(15):
        (session / "scene" / f"{number}.toml").touch()
    with pytest.raises(InputError, match="has 17 TOML files"):
        load(session)


def test_lines_have_a_limit(session):
    with (session / "segment-0001.jsonl").open("r+b") as file:
        file.truncate((64 << 20) + 1)
    with pytest.raises(InputError, match="at most"):
        load(session)


def test_the_checksum_of_an_index_is_looked_at(session):
    path = session / "segment-0001.mcap"
    data = bytearray(path.read_bytes())
    begin = int.from_bytes(data[-28:-20], "little")
    assert zlib.crc32(data[begin:-12]) == int.from_bytes(data[-12:-8], "little")
    data[begin + 20] ^= 1
    path.write_bytes(data)
    resumed = resume(session)
    resumed.close()
    assert any("index was damaged" in sentence for sentence in resumed.findings)
