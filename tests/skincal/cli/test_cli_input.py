"""Commands with input that the user can mend: exit code 2, one sentence, nothing left behind that is in the way."""

import gc
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.cli import main
from skincal.cli.record import MAX_REQUESTED_POKES, OrderLine, _follow_order, check_pose, find_scene
from skincal.files.importers.registry import RECORDING_IMPORTERS
from skincal.journal import writer
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream
from skincal.model.scene import load_scene, scene_file
from skincal.session.importing import new_session
from skincal.session.pipeline import Pipeline
from skincal.simulation.emulated_devices import MAKERS
from skincal.streams.links import ChunkQueue, LinkSpec
from skincal.studies import STUDIES
from tests.approved import approved

SCENE = ["--scene", "flat-patch"]
CHANNELS = 64


def write_logs(folder: Path, seconds: float = 2.0, width: int = CHANNELS) -> list[str]:
    """Write logs of a still rig; return the options that name them."""
    rng = np.random.default_rng(1)
    for name, rate, values in (("wrench", 100, 6), ("skin", 50, width)):
        (folder / name).mkdir(parents=True)
        with (folder / name / "data.log").open("w") as file:
            for k in range(int(seconds * rate)):
                numbers = " ".join(f"{value:.4f}" for value in rng.normal(size=values))
                file.write(f"{k} {1.4e9 + k / rate:.6f} {numbers}\n")
    return ["--wrench", str(folder / "wrench"), "--skin", str(folder / "skin")]


@pytest.fixture(scope="module")
def session(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "session"
    assert main(["simulate", *SCENE, "--pokes", "2", "--out", str(folder)]) == 0
    return folder


def test_a_recording_without_a_reading_says_of_which_link(run, tmp_path):
    options = ["record", "--wrench", "/dev/ttyNone1", "--skin", tmp_path, *SCENE, "--out", tmp_path / "s"]
    code, out, err = run(*options, "--seconds", "0.5", "--json")
    assert code == 2
    assert approved("links.nothing_usable_no_port", link="force/torque sensor", port="/dev/ttyNone1") in err
    assert approved("links.no_serial_port_path", path=tmp_path) in err
    assert json.loads(out)["links"]["skin"]["readings"] == 0


def test_addresses_that_were_exchanged_are_said_to_be(run, tmp_path):
    for name, width in (("wrench", 6), ("skin", CHANNELS)):
        row = ",".join(["5"] * width)
        (tmp_path / f"{name}.txt").write_text("".join(f"{row[:-1]}{k % 10}\n" for k in range(400)))
    options = ["record", "--wrench", f"file:{tmp_path / 'skin.txt'}", "--skin", f"file:{tmp_path / 'wrench.txt'}", *SCENE]
    code, _, err = run(*options, "--out", tmp_path / "s", "--seconds", "0.5")
    assert code == 2
    assert approved("links.other_stream_alone", link="force/torque sensor", found="skin", width=CHANNELS) in err
    assert approved("links.other_stream_alone", link="skin", found="force/torque sensor", width=6) in err


def recording(folder: Path, wrench: str | Path, skin: str | Path, *more: str) -> list[str]:
    """The arguments of a recording into `folder`."""
    return ["record", "--wrench", str(wrench), "--skin", str(skin), *SCENE, "--out", str(folder), *more]


def test_ports_that_do_not_exist_are_named_within_two_seconds_and_leave_nothing_behind(tmp_path):
    command = [sys.executable, "-P", "-m", "skincal.cli", *recording(tmp_path / "s", "/dev/ttyNone1", "/dev/ttyNone2")]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as running:
        try:
            assert running.stderr is not None
            said = sorted(running.stderr.readline() for _ in range(2))
            assert said == [
                f"{name}: failed: There is no port /dev/ttyNone{number}; plug the device in, or check the name.\n"
                for name, number in (("skin", 2), ("wrench", 1))
            ]
            assert (tmp_path / "s").exists()
            running.terminate()
            assert running.wait(10) == 2
        finally:
            running.kill()
    assert not (tmp_path / "s").exists()


def test_an_interrupt_never_strikes_while_the_session_is_written(run, tmp_path, monkeypatch):
    """It comes in the middle of the third write; that item, and all that was read before the end, is in the session."""
    from skincal.journal import ros_messages
    from skincal.journal.reader import SessionLog
    from skincal.model.readings import Chunk

    for name, values in (("wrench", 6), ("skin", CHANNELS)):
        (tmp_path / name).write_text((" ".join(["0.5"] * values) + "\n") * 2000)
    encode, begun = ros_messages.encode_chunk, []

    def interrupted(*arguments):
        begun.append(arguments)
        if len(begun) == 3:
            signal.raise_signal(signal.SIGINT)
        return encode(*arguments)

    monkeypatch.setattr(ros_messages, "encode_chunk", interrupted)
    before = signal.getsignal(signal.SIGINT)
    _, _, err = run(*recording(tmp_path / "s", tmp_path / "wrench", tmp_path / "skin", "--seconds", "30"))
    assert "stopped" in err
    assert signal.getsignal(signal.SIGINT) is before
    log = SessionLog(tmp_path / "s")
    assert [item.data for item in log.items() if isinstance(item, Chunk)] == [data for _, data in begun]
    assert log.findings == ()


@pytest.mark.parametrize("at_once", [True, False])
def test_a_simulation_that_is_interrupted_keeps_what_it_has_and_says_how_much(run, tmp_path, monkeypatch, at_once):
    from skincal.cli import simulate
    from skincal.journal.lock import LOCK_NAME
    from skincal.journal.reader import SessionLog
    from skincal.simulation import virtual_session
    from skincal.simulation.operator import AutoOperator

    def make_interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return writer.create_session(*arguments)

    begin = AutoOperator.next

    def next_interrupted(self, now):
        if self.begun == 3:
            signal.raise_signal(signal.SIGINT)
        return begin(self, now)

    if at_once:
        monkeypatch.setattr(virtual_session, "create_session", make_interrupted)
    else:
        monkeypatch.setattr(AutoOperator, "next", next_interrupted)
    before = signal.getsignal(signal.SIGINT)
    folder = tmp_path / "s"
    code, out, err = run("simulate", *SCENE, "--out", folder, "--json")
    pokes = 0 if at_once else 3
    assert (code, err) == (simulate.CTRL_C_EXIT_CODE, approved("operator.stopped", pokes=pokes, count=252) + "\n")
    assert json.loads(out)["pokes"] == pokes
    assert signal.getsignal(signal.SIGINT) is before
    assert SessionLog(folder).findings == ()
    assert not (folder / LOCK_NAME).exists()


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Path:
    """A folder with an empty file, logs, logs of too narrow a skin, and a reference that is none."""
    folder = tmp_path_factory.mktemp("given")
    (folder / "file").write_bytes(b"")
    (folder / "truth.json").write_text('{"taxels": [{"channel": 1, "position_m": [1, 2]}]}')
    for name, width in (("logs", CHANNELS), ("narrow", 24)):
        write_logs(folder / name, width=width)
    return folder


POKES_LIMIT = f"Invalid value for '--pokes': expected a number less than or equal to {MAX_REQUESTED_POKES}; `skincal "
LOGS = ["--wrench", "{given}/logs/wrench", "--skin", "{given}/logs/skin"]
UNKNOWN_POSE = approved("recording.unknown_pose", pose=99, known="1, 2, 3")
NOT_SERVED = approved("operator.for_serve", options="OPTIONS")
REFUSALS = [
    (["simulate", *SCENE, "--pokes", "0"], "Invalid value for '--pokes': expected a number greater than or equal to 1;"),
    (["simulate", *SCENE, "--pokes", str(MAX_REQUESTED_POKES + 1)], POKES_LIMIT + "simulate"),
    (["record", "--wrench", "a", "--skin", "b", *SCENE, "--pokes", "99999999999999999999"], POKES_LIMIT + "record"),
    (["solve", "x", "--layout-out"], "Option '--layout-out' requires an argument;"),
    (["simulate", *SCENE, "--pokes", "many"], "Invalid value for '--pokes': expected a whole number;"),
    (["export", "x", "--format", "stl"], "Invalid value for '--format': 'stl' is not one of 'icub', 'json',"),
    (["record", "--wrench", "x"], "Missing option '--skin'; `skincal record --help`"),
    (["export", "x"], "Missing option '--format'. Choose from: icub, json, csv,"),
    (["solve", "x", "--fly"], "No such option: --fly"),
    (["fly"], "No such command 'fly'; `skincal --help`"),
    (["study", "astrology"], "No such command 'astrology'; `skincal study --help`"),
    (["solve", "{given}/file"], "{given}/file: not a session (it is no folder); expected"),
    (["solve", "{given}/none"], "{given}/none: not a session (" + approved("yarp_log.no_folder") + "); expected"),
    (["solve", "{given}"], "{given}: not a session"),
    (["solve", "{session}", "--reference", "{given}/truth.json"], approved("export.no_reference")),
    (["solve", "{session}", "--part", "chest", "NO OUT"], "expected --out"),
    (["export", "{given}", "--format", "icub"], "{given}: not a session"),
    (["export", "{session}", "--format", "csv", "--part", "chest"], "expected --format icub"),
    (["simulate", "--scene", "nope"], "nope"),
    (["simulate", "--scene", "icub-forearm", "NO OUT"], "--serve"),
    (["simulate", "--scene", "{given}"], "{given}"),
    (["simulate", *SCENE, "--poses", "9"], "9"),
    *((["simulate", *SCENE, *options], NOT_SERVED.replace("OPTIONS", " ".join(options)))
      for options in (["--operator", "told"], ["--operator", "guided"], ["--tcp"])),
    (["simulate", *SCENE, "--effects", "none"], approved("operator.effects_of_physics")),
    (["simulate", "--scene", "icub-forearm", "--physics", "mujoco", "--effects", "sag,wind"], "there is no effect 'wind'"),
    (["simulate", *SCENE, "--run", "2"], NOT_SERVED.replace("OPTIONS", "--run")),
    *((["simulate", *SCENE, "--physics", "mujoco", *options], approved("operator.not_of_a_robot", option=options[0]))
      for options in (["--errors", "paper"], ["--poses", "1"], ["--careful"], ["--pace", "2"], ["--tcp"], ["--as", "xela"])),
    (["import", "csv", "--wrench", "{given}/file", "--skin", "{given}/file", *SCENE], "the file is empty"),
    (["import", "csv", "--wrench", "{given}", "--skin", "{given}", *SCENE], "is a folder"),
    (["import", "yarp", "--wrench", "{given}/none", "--skin", "{given}/none", *SCENE], "there is no such folder"),
    (["import", "yarp", "--wrench", "{given}/file", "--skin", "{given}/file", *SCENE], "is empty"),
    (["import", "yarp", *LOGS, "--scene", "icub-forearm", "--pose", "99"],
     UNKNOWN_POSE),
    (["record", *LOGS, "--scene", "icub-forearm", "--pose", "99"], UNKNOWN_POSE),
    (["record", *LOGS, "--scene", "icub-forearm"], "add --joints, or --pose"),
    (["record", "--wrench", "socket://[::1", "--skin", "x", *SCENE], approved("links.no_tcp_address", address="socket://[::1")),
    # pyserial would write to the file that its `spy` names.
    (["record", "--wrench", "spy:///dev/null?file={given}/kept", "--skin", "/dev/null", *SCENE],
     approved("links.refused_scheme_by_command", address="spy:///dev/null?file={given}/kept", scheme="spy")),
    (["record", "--wrench", "a", "--skin", "b", *SCENE, "--seconds", "-1"],
     approved("recording.invalid_value", option="--seconds")),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "sentence"), REFUSALS)
def test_a_refusal_is_one_plain_sentence_and_leaves_nothing_behind(run, tmp_path, given, session, arguments, sentence):
    names = {"given": given, "session": session}
    words = [word.format(**names) for word in arguments if word != "NO OUT"]
    before = sorted(given.rglob("*"))
    code, out, err = run(*words, *([] if "NO OUT" in arguments or words[-1] == "--layout-out" else ["--out", tmp_path / "out"]))
    assert (code, out) == (2, "")
    assert sentence.format(**names) in err
    assert err.count("\n") == 1
    assert not any(word in err for word in ("Usage", "Input should", "parse"))
    assert not (tmp_path / "out").exists()
    assert sorted(given.rglob("*")) == before


def test_results_in_every_format_say_each_finding_once(run, tmp_path, session):
    code, out, _ = run("solve", session, "--out", tmp_path / "results")
    assert code == 0
    said = [line for line in out.splitlines() if "have no position" in line]
    assert len(said) == 2, "one for each method"


@pytest.mark.parametrize(
    ("name", "remarked"), [("x.csv", True), ("x.CSV", True), ("x.json", False), ("x.JSON", False), ("x", False)]
)
def test_a_file_that_ends_as_another_format_is_remarked_on(run, tmp_path, session, name, remarked):
    file = tmp_path / name
    code, out, _ = run("export", session, "--format", "json", "--out", file, "--json")
    assert (code, file.exists()) == (0, True)
    said = approved("export.other_ending", name=name, ending=file.suffix, format="json", right=".json", other="csv")
    assert json.loads(out)["findings"].count(said) == remarked


@pytest.mark.parametrize(("poses", "words"), [({}, "name one in [arm.poses] of the scene"), ({"1": np.zeros(2)}, "one of 1.")])
def test_an_arm_without_a_pose_asks_for_one_that_the_scene_names(poses, words):
    scene = find_scene(Path("icub-forearm"))
    assert scene.arm is not None
    with pytest.raises(InputError, match=re.escape(words)):
        check_pose(replace(scene, arm=replace(scene.arm, poses=poses)), None, streamed=False)


@pytest.mark.parametrize("line", [b"[" * 100_000, b'{"do": "exclude", "poke": NaN}', b"7"])
def test_an_order_that_is_none_is_said_and_left_out(capsys, line):
    """Beyond the interpreter's depth `json` raises a RecursionError, which would end the recording."""
    _follow_order(None, OrderLine(1, line))
    assert "not done" in capsys.readouterr().err


def test_each_problem_of_a_link_is_reported_once_and_that_it_sends_again():
    from skincal.cli.record import REPORT_UNOPENED_LINK_AFTER_NS, LinkReports
    from skincal.model.readings import LinkAnswer, LinkHealth, LinkVerdict

    reports, events = LinkReports(10), []

    def said(state, answer=LinkAnswer.LISTENING, now_ns=REPORT_UNOPENED_LINK_AFTER_NS):
        link = LinkHealth("skin", state, "", (Stream.SKIN,), "", 0, 0.0, 0, verdict=LinkVerdict(answer))
        return reports.new([link], events, now_ns)

    assert REPORT_UNOPENED_LINK_AFTER_NS <= 2_000_000_000
    assert said(LinkState.LOST) == []
    assert said(LinkState.LOST, now_ns=10 + REPORT_UNOPENED_LINK_AFTER_NS)[0].startswith("skin: is not open yet")
    assert said(LinkState.LOST, now_ns=11 + REPORT_UNOPENED_LINK_AFTER_NS) == []
    events.append("skin")
    assert said(LinkState.OPEN) == []
    (silent,) = said(LinkState.OPEN, LinkAnswer.NO_ANSWER)
    assert silent.startswith(approved("links.silent", link="skin", seconds=2))
    assert said(LinkState.OPEN, LinkAnswer.NO_ANSWER) == []
    assert said(LinkState.OPEN, LinkAnswer.GOOD) == ["skin: sends again"]
    assert said(LinkState.OPEN, LinkAnswer.FROZEN) == ["skin: it sends the same reading again and again"]
    assert said(LinkState.LOST) == []


def test_a_link_whose_readings_wait_is_not_called_silent_and_one_without_any_is(monkeypatch, capsys):
    """The machine is so loaded that the readings of five seconds wait: silence is judged by their arrivals."""
    from skincal.cli import record

    monkeypatch.setattr(record, "LINK_CHECK_PERIOD_NS", 0)
    links = (LinkSpec("wrench", "w", (Stream.WRENCH,), "text"), LinkSpec("skin", "s", (Stream.SKIN,), "text"))
    pipeline = Pipeline(load_scene(scene_file(Path("flat-patch"))), links, None)
    begin_ns, queued = time.monotonic_ns() - 5_000_000_000, ChunkQueue()
    width = pipeline.scene.skin.frame_width
    for link in ("wrench", "skin"):
        queued.put(LinkEvent(link, begin_ns, LinkState.OPEN))
    for k in range(500):
        at_ns = begin_ns + k * 10_000_000
        queued.put(Chunk("wrench", at_ns, f"0 0 {k % 7} 0 0 0\n".encode()))
        if k < 100:
            queued.put(Chunk("skin", at_ns, f"{' '.join([str(k % 5)] * width)}\n".encode()))
    record._loop(pipeline, queued, {}, (None, None), threading.Event())
    said = capsys.readouterr().err
    assert "skin: is open but silent for 2 s" in said
    assert "wrench: is open but silent" not in said


def test_a_second_ctrl_c_ends_the_estimate_of_a_stopped_recording_and_names_the_command(run, tmp_path, monkeypatch):
    from skincal.cli import record

    (tmp_path / "wrench").write_text("0 0 0 0 0 0\n" * 200)
    (tmp_path / "skin").write_text((" ".join(["5"] * CHANNELS) + "\n") * 200)
    monkeypatch.setattr(record, "_loop", lambda *_: signal.raise_signal(signal.SIGINT))
    monkeypatch.setattr("skincal.cli.output.poke_counts", lambda *_: signal.raise_signal(signal.SIGINT))
    before = signal.getsignal(signal.SIGINT)
    folder = tmp_path / "s"
    code, out, err = run(*recording(folder, tmp_path / "wrench", tmp_path / "skin", "--seconds", "30"))
    assert (code, out) == (130, "")
    assert f"`skincal solve {folder}` does it later" in err
    assert signal.getsignal(signal.SIGINT) is before
    assert (folder / "segment-0001.mcap").exists()


def test_collections_leave_out_what_is_loaded_while_it_records_and_no_longer(run, tmp_path, monkeypatch):
    from skincal.cli import record

    (tmp_path / "wrench").write_text("0 0 0 0 0 0\n" * 200)
    (tmp_path / "skin").write_text((" ".join(["5"] * CHANNELS) + "\n") * 200)
    left_out = []
    monkeypatch.setattr(record, "_loop", lambda *_: left_out.append(gc.get_freeze_count()))
    run(*recording(tmp_path / "s", tmp_path / "wrench", tmp_path / "skin", "--seconds", "30"))
    assert left_out[0] > 10_000
    assert gc.get_freeze_count() < left_out[0] / 10


def test_a_recording_without_a_byte_of_the_wrench_leaves_nothing_and_one_with_bytes_stays(run, tmp_path):
    skin = tmp_path / "skin.txt"
    skin.write_text("".join(f"S {k} " + " ".join(["5"] * CHANNELS) + "\n" for k in range(40)))
    options = ["record", "--skin", f"file:{skin}", *SCENE, "--out", tmp_path / "s", "--seconds", "0.5", "--wrench"]
    code, out, err = run(*options, "/dev/ttyNone1", "--json")
    assert (code, json.loads(out)["session"]) == (2, None)
    assert approved("links.nothing_usable", link="force/torque sensor") in err
    assert not (tmp_path / "s").exists()
    noise = tmp_path / "noise.bin"
    noise.write_bytes(bytes(range(256)) * 20)
    code, _, _ = run(*options, f"file:{noise}")
    assert code == 2
    assert (tmp_path / "s" / "segment-0001.mcap").exists(), "another may still be able to read these bytes"


def test_readings_of_csv_files_are_called_so_and_solved_again(run, tmp_path):
    rng = np.random.default_rng(2)
    for name, rate, width in (("wrench", 100, 6), ("skin", 50, CHANNELS)):
        rows = np.column_stack([np.arange(100) / rate, rng.normal(size=(100, width))])
        np.savetxt(tmp_path / f"{name}.csv", rows, fmt="%.4f", delimiter=",")
    files = ["--wrench", tmp_path / "wrench.csv", "--skin", tmp_path / "skin.csv"]
    code, out, err = run("import", "csv", *files, *SCENE, "--out", tmp_path / "s")
    assert code == 0, err
    assert approved("recording.counted_csv", link="wrench", count=100) in out
    assert approved("recording.counted_csv", link="skin", count=100) in run("solve", tmp_path / "s")[1]


def test_some_frames_of_the_wrong_width_are_said_and_the_rest_is_used(run, tmp_path):
    logs = write_logs(tmp_path)
    path = tmp_path / "skin" / "data.log"
    lines = path.read_text().splitlines()
    lines[7] += " 1.0"
    path.write_text("\n".join(lines) + "\n")
    code, out, _ = run("import", "yarp", *logs, *SCENE, "--out", tmp_path / "s", "--json")
    assert code == 0
    result = json.loads(out)
    assert result["links"]["skin"]["lost"] == {"wrong number of values": 1}
    assert any(approved("recording.width_clause", channels=CHANNELS) in finding for finding in result["findings"])


def test_a_frame_without_a_wrench_is_named_once(run, tmp_path):
    logs = write_logs(tmp_path)
    path = tmp_path / "wrench" / "data.log"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:50] + lines[150:]) + "\n")
    code, out, _ = run("import", "yarp", *logs, *SCENE, "--out", tmp_path / "s")
    assert code == 0
    assert out.count(approved("recording.no_wrench_then")) == 1
    assert "skin frames" not in out


def test_a_full_disk_is_said(tmp_path):
    """A limit on the size of files stands for a disk that is full."""
    resource = pytest.importorskip("resource")
    logs = write_logs(tmp_path, seconds=30.0)

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))

    command = [sys.executable, "-m", "skincal.cli", "import", "yarp", *logs, *SCENE, "--out", str(tmp_path / "s")]
    done = subprocess.run(command, capture_output=True, text=True, preexec_fn=limit, timeout=60, check=False)
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert approved("recording.file_too_large", file="segment-0001.mcap", why="File too large") in done.stderr
    assert main(["solve", str(tmp_path / "s")]) == 0


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="the platform has no pty")
def test_a_port_in_use_is_said(run, tmp_path):
    import serial

    ends = [os.openpty() for _ in range(2)]
    names = [os.ttyname(slave) for _, slave in ends]
    try:
        with serial.Serial(names[0], exclusive=True):
            options = ["record", "--wrench", names[0], "--skin", names[1], *SCENE, "--out", tmp_path / "s"]
            code, _, err = run(*options, "--seconds", "0.5")
    finally:
        for pair in ends:
            for end in pair:
                os.close(end)
    assert code == 2
    assert approved("links.in_use_of", port=names[0]) in err
    assert approved("links.nothing_usable_silent", link="skin") in err


def test_the_part_is_written_to_the_icub_file(run, session, tmp_path):
    assert run("export", session, "--format", "icub", "--out", tmp_path / "p.txt", "--part", "chest")[0] == 0
    assert (tmp_path / "p.txt").read_text().split()[:2] == ["name", "chest"]
    assert run("solve", session, "--out", tmp_path / "all", "--part", "l_foot")[0] == 0
    assert {path.read_text().split()[1] for path in (tmp_path / "all").glob("positions-*.txt")} == {"l_foot"}


COMMANDS = [
    "", "solve", "export", "apply", "compare", "report", "devices", "watch", "landmarks", "pokes", "record", "simulate",
    "import", "tool", "scene new", "scene show",
    *(f"import {each.name}" for each in RECORDING_IMPORTERS), "study", *(f"study {name}" for name in STUDIES),
]  # fmt: skip


WINDOW_OPTIONS = ("--scene", "--wrench", "--skin", "--joints", "--targets", "--new", "--session", "--headless")


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example_and_every_command_can_print_json(run, command):
    code, out, _ = run(*command.split(), "--help")
    assert code == 0
    assert f"skincal {command}".strip() in out.partition("Example")[2]
    wanted = {"": WINDOW_OPTIONS, "import": (), "study": ()}.get(command, ("--json", *["--quick"] * ("study" in command)))
    assert [option for option in wanted if option not in out] == []
    assert out.count("<bool>") == 1, "a flag has no value; typer shows one for --help itself"


def test_the_help_names_every_device_that_can_be_simulated(run):
    _, out, _ = run("simulate", "--help")
    assert set(MAKERS) - set(re.findall(r"[a-z0-9-]+", out)) == set()


def test_a_session_that_another_program_makes_meanwhile_is_not_taken_away(tmp_path, monkeypatch):
    folder = tmp_path / "shared"

    def come_too_late(*_, **__):
        (folder / "scene").mkdir(parents=True)
        (folder / "segment-0001.mcap").write_bytes(b"of another program")
        raise InputError("it is taken")

    monkeypatch.setattr(writer, "create_session", come_too_late)
    with pytest.raises(InputError, match="taken"), new_session(folder, find_scene(Path("flat-patch")), ()):
        pass
    assert (folder / "segment-0001.mcap").read_bytes() == b"of another program"
    assert (folder / "scene").is_dir()


def test_a_live_session_does_not_wait_for_the_importers():
    seen = "import sys, skincal.session.importing; sys.exit('skincal.files.importers.preview' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", seen], check=False).returncode == 0


def test_help_does_not_wait_for_numpy():
    seen = "import sys; from skincal.cli import main; main(['solve', '--help']); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", seen], stdout=subprocess.DEVNULL, check=False).returncode == 0
