import json
import shutil
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

from skincal.cli import main
from skincal.contacts.detector import ContactDetector
from skincal.contacts.outcome import BeforePokes
from skincal.files.importers.preview import guess_streams
from skincal.files.importers.registry import StoppedError
from skincal.journal import writer
from skincal.model.errors import InputError
from skincal.model.scene import load_scene, resource
from skincal.part.part import load_part
from skincal.session.importing import (
    Imported,
    ImportRequest,
    import_recording,
    missing_folders,
    new_session,
    take_away,
)
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.streams.decoders import yarp_log
from skincal.words.poke_words import no_poke_sentence
from tests.approved import approved, approved_pattern
from tests.skincal.import_support import write_csv, write_yarp
from tests.skincal.poke_script import ANSWERS, SPOTS, Script, outcome_key, some_pokes, write_scene

POKES = 4


@pytest.fixture
def request_of(tmp_path):
    scene = write_scene(tmp_path / "source")
    samples = some_pokes(scene, POKES).samples

    def make(write=write_yarp, folder=tmp_path / "deep" / "session"):
        return ImportRequest(guess_streams([write(tmp_path / write.__name__, samples)]), scene.path, "", folder)

    return make


def keys(pipeline):
    return [outcome_key(record.outcome) for record in pipeline.snapshot().pokes]


def test_an_anchor_that_points_into_the_part_is_told(tmp_path):
    """A plate, 3 mm thick: the layout would come onto its lower wall."""
    source = tmp_path / "source"
    shutil.copytree(resource("scenes/flat-patch"), source)
    corners = [(x, y, z) for z in (0, -3) for y in (-80, 80) for x in (-80, 80)]
    sides = ["1 2 4", "1 4 3", "5 8 6", "5 7 8", "1 6 2", "1 5 6", "3 4 8", "3 8 7", "1 3 7", "1 7 5", "2 8 4", "2 6 8"]
    rows = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {side}" for side in sides)]
    (source / "plate.obj").write_text("\n".join(rows) + "\n")
    text = (source / "scene.toml").read_text() + '\n[surface]\nmesh = "plate.obj"\nunit = "mm"\n'
    said = approved("mesh.anchor_into", modules="modules 1, 2, 3, ...", gap="3.0")
    for normal, count in ((1.0, 0), (-1.0, 1)):
        (source / "scene.toml").write_text(text.replace("normal = [0.0, 0.0, 1.0]", f"normal = [0.0, 0.0, {normal}]"))
        told = []
        with new_session(tmp_path / str(normal), load_scene(source / "scene.toml"), (), told.append) as pipeline:
            pipeline.close()
        assert told.count(f"plate.obj: {said}") == load_part(source / "scene.toml").findings.count(said) == count, told


@pytest.mark.parametrize("write", [write_yarp, write_csv])
def test_every_poke_of_a_recording_is_in_the_session(request_of, write):
    request = request_of(write)
    shares: list[float] = []
    done = import_recording(request, lambda share: shares.append(share) or True)
    assert done == Imported(request.folder, POKES, POKES)
    assert keys(load(request.folder)) == keys(replay(request.folder))
    assert len(keys(load(request.folder))) == POKES
    assert shares == sorted(shares)
    assert 0.0 <= shares[0] < 0.1


def spoilt(place):
    """Spoil some lines of a log: a header, words, a cut one, one without a number, and lines that are missing."""
    lines = (place / "data.log").read_text().splitlines(keepends=True)
    lines[100] = "Type: Bottle;\n"
    lines[101:103] = ["nothing\n", lines[102][: len(lines[102]) // 2] + "\n"]
    words = lines[120].split()
    lines[120] = " ".join([*words[:2], "nan", *words[3:]]) + "\n"
    del lines[130]
    (place / "data.log").write_text("".join(lines))


@pytest.mark.parametrize("spoil", [False, True])
def test_what_is_decoded_many_at_a_time_is_what_is_decoded_one_by_one(request_of, spoil):
    request = request_of()
    if spoil:
        spoilt(request.files.wrench.path)
        spoilt(request.files.skin.path)
    scene, recording = load_scene(request.scene), request.files.open()
    many, alone = (Pipeline(scene, recording.links, None) for _ in range(2))
    many.feed_many(list(recording.chunks()))
    for chunk in recording.chunks():
        alone.feed(chunk)
    for pipeline in (many, alone):
        pipeline.close()
    assert keys(many) == keys(alone)
    assert keys(many)
    assert many.totals() == alone.totals()
    assert many.live(10**12).links == alone.live(10**12).links
    assert (sum(link.losses.total() for link in many.live(10**12).links) > 0) == spoil


def test_an_import_works_on_many_readings_at_a_time(request_of, monkeypatch):
    """What made an import slow was done for each reading: text parsed chunk by chunk, and a message a wrench."""
    request, parsed = request_of(), []
    read = yarp_log.read_table
    monkeypatch.setattr(yarp_log, "read_table", lambda text: parsed.append(text.count(b"\n")) or read(text))
    import_recording(request)
    readings = sum((place.path / "data.log").read_text().count("\n") for place in (request.files.wrench, request.files.skin))
    # No line is parsed twice, but for those from which the usual step of the numbers is learnt.
    assert readings <= sum(parsed) < 1.5 * readings
    counts = Counter()
    for path in request.folder.glob("*.mcap"):
        with path.open("rb") as file:
            counts.update(channel.topic for _, channel, _ in make_reader(file).iter_messages())
    assert len(parsed) < counts["/raw/wrench"] + counts["/raw/skin"]
    # Other programs read the recording itself.
    assert counts.keys() == {"/raw/wrench", "/raw/skin", "/events"}


def test_an_import_that_is_cut_off_is_the_beginning_of_a_session(request_of):
    """Only the beginning of both files came onto the disk, each flushed as it is in an import."""
    request = request_of()
    import_recording(request)
    whole = keys(load(request.folder))
    for name in ("segment-0001.mcap", "segment-0001.jsonl"):
        data = (request.folder / name).read_bytes()
        (request.folder / name).write_bytes(data[: len(data) // 2])
    loaded, played = load(request.folder), replay(request.folder)
    for begun in (keys(loaded), keys(played)):
        # The last one may lack what the quiet after it says.
        assert begun[:-1] == whole[: len(begun)][:-1]
        assert len(begun) <= POKES
    assert loaded.findings
    assert played.findings


def test_the_command_makes_the_same_session(request_of, tmp_path):
    request = request_of()
    import_recording(request)
    places = [
        str(part)
        for name, place in (("--wrench", request.files.wrench), ("--skin", request.files.skin))
        for part in (name, place)
    ]
    assert main(["import", "yarp", *places, "--scene", str(request.scene), "--out", str(tmp_path / "other")]) == 0
    assert keys(load(tmp_path / "other")) == keys(load(request.folder))


def test_one_that_is_stopped_or_fails_leaves_nothing_behind(request_of, tmp_path, monkeypatch):
    request, shares = request_of(), []

    def refuse(*_):
        raise OSError(28, "No space left on device")

    def go_on(share: float) -> bool:
        shares.append(share)
        assert (request.folder / "segment-0001.mcap").exists()
        return share < 0.5

    with pytest.raises(StoppedError):
        import_recording(request, go_on)
    assert shares[-1] >= 0.5
    assert not (tmp_path / "deep").exists()
    with monkeypatch.context() as full:
        full.setattr(writer.JournalWriter, "_add", refuse)
        with pytest.raises(InputError, match="cannot be written"):
            import_recording(request)
    assert not (tmp_path / "deep").exists()
    request.folder.mkdir(parents=True)
    (request.folder / "notes.txt").write_text("mine")
    with pytest.raises(StoppedError):
        import_recording(request, lambda _: False)
    assert [path.name for path in request.folder.iterdir()] == ["notes.txt"], "what was there stays"
    import_recording(request)


def test_an_import_into_a_session_is_refused_and_changes_nothing_in_it(request_of):
    request = request_of()
    import_recording(request)
    before = {path: path.read_bytes() for path in request.folder.rglob("*") if path.is_file()}
    with pytest.raises(InputError, match="holds a session"):
        import_recording(request)
    assert {path: path.read_bytes() for path in request.folder.rglob("*") if path.is_file()} == before


def test_a_stream_of_nothing_is_no_session(request_of, tmp_path):
    request = request_of()
    wide = tmp_path / "wide"
    wide.mkdir()
    scene = (request.scene.parent / "patch.toml").read_text().replace("channels = 24", "channels = 25")
    (wide / "patch.toml").write_text(scene.replace('modules = "modules.toml"\n', ""))
    with pytest.raises(InputError, match=approved_pattern("recording.wrong_width", width=24, channels=25)) as refusal:
        import_recording(replace(request, scene=wide / "patch.toml"))
    assert str(refusal.value).endswith(approved("recording.nothing_made"))
    assert not (tmp_path / "deep").exists()


def test_what_a_killed_process_left_is_taken_away(request_of, tmp_path):
    request = request_of()
    missing = missing_folders(request.folder)
    assert missing == [request.folder, request.folder.parent]

    def go_on(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        import_recording(request, go_on)
    assert request.folder.exists()
    # The file of a lock that the system took back.
    (request.folder / "session.lock").write_text("1\nhost\nnow\n")
    take_away(request.folder, missing)
    assert not (tmp_path / "deep").exists()


def weak(scene, sign=1.0):
    """Presses of a tenth of the force that a poke needs in 300 frames, which two taxels answer."""
    script, answers = Script(scene, force_noise=0.01, skin_noise=0.5), {k: sign * v for k, v in ANSWERS[0].items()}
    for _ in range(3):
        script.quiet(1.0).press(np.array([0.0, 0.0, -0.4]), SPOTS[0], answers)
    return script.quiet((300 - len(script.samples)) * 0.02)


FRAMES = 300
"""Of `Script.quiet(6.0)`."""


LENGTH = {"frames": FRAMES, "seconds": 6}
NO_POKE = [
    (weak, write_yarp, approved("import.no_poke_answered", **LENGTH, force=0.43, taxels="2 taxels")),
    (lambda scene: weak(scene, -1.0), write_csv, approved("import.no_poke_fell", **LENGTH, force=0.43, fell=2)),
    (
        lambda scene: Script(scene, force_noise=0.01).quiet(6.0),
        write_yarp,
        approved("import.no_poke_nothing", **LENGTH, force=0.04),
    ),
    (lambda scene: Script(scene, force_noise=0.5).quiet(6.0), write_yarp, approved("import.no_poke_restless", **LENGTH)),
]
"""Recordings without a poke: samples, format, and what is said."""


@pytest.mark.parametrize(("samples", "write", "said"), NO_POKE, ids=["answered", "fell", "nothing", "restless"])
def test_a_recording_without_a_poke_says_why(tmp_path, samples, write, said):
    scene = write_scene(tmp_path / "source")
    logs = write(tmp_path / "logs", samples(scene).samples)
    done = import_recording(ImportRequest(guess_streams([logs]), scene.path, "", tmp_path / "s"))
    assert (done.pokes, done.accepted, done.unpoked) == (0, 0, said)
    assert no_poke_sentence(ContactDetector(scene).before_pokes, scene.contacts) == approved("import.no_poke_apart")


def test_a_recording_too_short_for_a_poke_leaves_no_session(tmp_path, capsys):
    scene = write_scene(tmp_path / "source")
    logs = write_csv(tmp_path / "logs", Script(scene, force_noise=0.01).quiet(0.42).samples)
    with pytest.raises(InputError) as refused:
        import_recording(ImportRequest(guess_streams([logs]), scene.path, "", tmp_path / "s"))
    assert str(refused.value) == approved("import.too_short", seconds="0.4")
    assert not (tmp_path / "s").exists()
    options = ["--wrench", str(logs / "a.csv"), "--skin", str(logs / "b.csv"), "--scene", str(scene.path)]
    assert main(["import", "csv", *options, "--out", str(tmp_path / "s")]) == 2
    said = capsys.readouterr()
    assert approved("import.too_short", seconds="0.4") in said.err
    assert "never steady" not in said.out
    assert not (tmp_path / "s").exists()
    assert no_poke_sentence(BeforePokes(6, 0.3, False, 0.0, 0, 0), scene.contacts).endswith("0.3 s of holding still.")


def test_the_command_says_it_first_and_ends_well(tmp_path, capsys):
    scene = write_scene(tmp_path / "source")
    logs = write_yarp(tmp_path / "logs", weak(scene).samples)
    options = ["--wrench", str(logs / "left_ft"), "--skin", str(logs / "left_forearm_skin"), "--scene", str(scene.path)]
    said = approved("import.no_poke_answered", frames=FRAMES, seconds=6, force=0.43, taxels="2 taxels")
    assert main(["import", "yarp", *options, "--out", str(tmp_path / "s")]) == 0
    assert capsys.readouterr().out.splitlines()[0] == said
    assert main(["import", "yarp", *options, "--out", str(tmp_path / "t"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["findings"][0], result["pokes"]) == (said, 0)
