"""Commands with input that the user can mend: exit code 2, one sentence, nothing left behind that is in the way."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from skincal.cli import main
from skincal.cli.record import POKES_MOST, OrderLine, _handle_item, find_scene
from skincal.journal import writer
from skincal.model.errors import InputError
from skincal.session.importing import new_session
from tests.approved import approved

SCENE = ["--scene", "flat-patch"]
CHANNELS = 64


@pytest.fixture
def run(capsys):
    def run(*arguments):
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        assert "Traceback" not in err, err
        return code, out, err

    return run


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


def test_width_of_the_scene_is_that_of_the_logs_here():
    assert find_scene(Path("flat-patch")).skin.channels == CHANNELS


@pytest.mark.parametrize("command", ["record", "import yarp"])
def test_an_unknown_pose_leaves_no_session_behind(run, tmp_path, command):
    logs = write_logs(tmp_path)
    code, _, err = run(*command.split(), *logs, "--scene", "icub-forearm", "--pose", "99", "--out", tmp_path / "s")
    assert code == 2
    assert approved("recording.unknown_pose", pose=99, known="1, 2, 3") in err
    assert not (tmp_path / "s").exists()


def test_an_address_that_cannot_be_right_ends_a_recording(run, tmp_path):
    code, _, err = run("record", "--wrench", "socket://[::1", "--skin", tmp_path, *SCENE, "--out", tmp_path / "s")
    assert code == 2
    assert approved("links.no_tcp_address", address="socket://[::1") in err
    assert not (tmp_path / "s").exists()
    code, _, err = run("record", "--wrench", "/dev/ttyNone1", "--skin", tmp_path, *SCENE, "--out", tmp_path / "s")
    assert code == 2
    assert approved("links.no_serial_port_path", path=tmp_path) in err


def test_a_kind_of_link_that_is_not_known_is_refused_before_a_session_is_made(run, tmp_path):
    kept = tmp_path / "kept.txt"
    kept.write_text("a thesis")
    address = f"spy:///dev/null?file={kept}"
    code, _, err = run("record", "--wrench", address, "--skin", "/dev/null", *SCENE, "--out", tmp_path / "s")
    assert code == 2
    assert err.startswith(approved("links.refused_scheme_by_command", address=address, scheme="spy"))
    assert not (tmp_path / "s").exists()
    assert kept.read_text() == "a thesis"


def test_a_recording_without_a_reading_says_of_which_link(run, tmp_path):
    options = ["record", "--wrench", "/dev/ttyNone1", "--skin", "/dev/ttyNone2", *SCENE, "--out", tmp_path / "s"]
    code, out, err = run(*options, "--seconds", "0.5", "--json")
    assert code == 2
    assert approved("links.nothing_usable_no_port", link="force/torque sensor", port="/dev/ttyNone1") in err
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


def test_a_link_that_never_says_why_it_is_not_open_is_reported_once():
    from skincal.cli.record import OPENING_NS, Silence
    from skincal.model.readings import LinkEvent, LinkState

    assert OPENING_NS <= 2_000_000_000
    silence = Silence(["wrench", "skin"], 10)
    silence.hear(LinkEvent("skin", 20, LinkState.FAILED, "in use"))
    assert silence.sentences(9 + OPENING_NS) == []
    (said,) = silence.sentences(10 + OPENING_NS)
    assert said.startswith("wrench: is not open yet")
    assert silence.sentences(11 + OPENING_NS) == []


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
    from skincal.simulate import virtual_session
    from skincal.simulate.operator import Auto

    def make_interrupted(*arguments):
        signal.raise_signal(signal.SIGINT)
        return writer.create_session(*arguments)

    begin = Auto.next

    def next_interrupted(self, now):
        if self.begun == 3:
            signal.raise_signal(signal.SIGINT)
        return begin(self, now)

    if at_once:
        monkeypatch.setattr(virtual_session, "create_session", make_interrupted)
    else:
        monkeypatch.setattr(Auto, "next", next_interrupted)
    before = signal.getsignal(signal.SIGINT)
    folder = tmp_path / "s"
    code, out, err = run("simulate", *SCENE, "--out", folder, "--json")
    pokes = 0 if at_once else 3
    assert (code, err) == (simulate.INTERRUPTED_EXIT_CODE, approved("operator.stopped", pokes=pokes, count=252) + "\n")
    assert json.loads(out)["pokes"] == pokes
    assert signal.getsignal(signal.SIGINT) is before
    assert SessionLog(folder).findings == ()
    assert not (folder / LOCK_NAME).exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["simulate", *SCENE, "--pokes", "0", "--out", "x"],
            "Invalid value for '--pokes': expected a number greater than or equal to 1; `skincal simulate --help`",
        ),
        *(
            (
                [*command, *SCENE, "--out", "x", "--pokes", number],
                f"Invalid value for '--pokes': expected a number less than or equal to {POKES_MOST}; `skincal {command[0]}",
            )
            for command in (["simulate"], ["record", "--wrench", "a", "--skin", "b"])
            for number in (str(POKES_MOST + 1), "99999999999999999999")
        ),
        (["solve", "x", "--layout-out"], "Option '--layout-out' requires an argument;"),
        (["simulate", *SCENE, "--pokes", "many", "--out", "x"], "Invalid value for '--pokes': expected a whole number;"),
        (
            ["export", "x", "--format", "stl", "--out", "y"],
            "Invalid value for '--format': 'stl' is not one of 'icub', 'json',",
        ),
        (["record"], "Missing option '--wrench'; `skincal record --help`"),
        (["export", "x", "--out", "y"], "Missing option '--format'. Choose from: icub, json, csv,"),
        (["solve", "x", "--fly"], "No such option: --fly"),
        (["fly"], "No such command 'fly'; `skincal --help`"),
    ],
)
def test_a_wrong_option_is_one_plain_sentence(run, arguments, sentence):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"skincal: {sentence}")
    assert err.count("\n") == 1
    assert not any(word in err for word in ("Usage", "Input should", "parse"))


def test_what_is_no_folder_is_not_said_to_be_missing(run, tmp_path):
    (tmp_path / "file").write_text("")
    for path, why in ((tmp_path / "file", "it is no folder"), (tmp_path / "none", approved("yarp_log.no_folder"))):
        code, _, err = run("solve", path)
        assert code == 2
        assert err.startswith(f"skincal: {path}: not a session ({why}); expected")


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


@pytest.mark.parametrize("line", [b"[" * 100_000, b'{"do": "exclude", "poke": NaN}', b"7"])
def test_an_order_that_is_none_is_said_and_left_out(capsys, line):
    """Beyond the interpreter's depth `json` raises a RecursionError, which would end the recording."""
    _handle_item(None, OrderLine(1, line))
    assert "not done" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--seconds", "-1"], ["--pokes", "0"]])
def test_a_recording_of_no_length_is_refused(run, tmp_path, option):
    code, _, err = run("record", "--wrench", "a", "--skin", "b", *SCENE, "--out", tmp_path / "s", *option)
    assert code == 2
    assert approved("recording.invalid_value", option=option[0]) in err
    assert not (tmp_path / "s").exists()


def test_a_link_that_is_open_and_silent_is_told_once_and_when_it_sends_again():
    from skincal.cli.record import Silence
    from skincal.model.readings import SILENT_S, Chunk, LinkEvent, LinkState

    silent_ns = round(SILENT_S * 1e9)
    silence = Silence()
    silence.hear(LinkEvent("skin", 10, LinkState.OPEN))
    silence.hear(LinkEvent("wrench", 10, LinkState.FAILED, "in use"))
    assert silence.sentences(silent_ns) == []
    said = silence.sentences(silent_ns + 11)
    assert len(said) == 1
    assert said[0].startswith(approved("links.silent", link="skin", seconds=2))
    assert silence.sentences(silent_ns + 12) == []
    silence.hear(Chunk("skin", silent_ns + 20, b"x"))
    assert silence.sentences(silent_ns + 30) == ["skin: sends again"]
    silence.hear(LinkEvent("skin", silent_ns + 40, LinkState.LOST, "vanished"))
    assert silence.sentences(9 * silent_ns) == []


def test_one_address_for_several_streams_is_one_board():
    from skincal.model.readings import Stream
    from skincal.streams.links import describe_links

    wrench, skin, joints = Stream.WRENCH, Stream.SKIN, Stream.JOINTS
    assert [(link.name, link.carries) for link in describe_links({wrench: "a", skin: "a", joints: "a"})] == [
        ("board", (wrench, skin, joints))
    ]
    assert [(link.name, link.carries) for link in describe_links({wrench: "a", skin: "b", joints: "b"})] == [
        ("wrench", (wrench,)), ("board", (skin, joints)),
    ]  # fmt: skip
    assert [link.name for link in describe_links({wrench: "a", skin: "b", joints: None})] == ["wrench", "skin"]


def test_a_skin_log_of_the_wrong_width_says_what_was_seen_and_expected(run, tmp_path):
    code, _, err = run("import", "yarp", *write_logs(tmp_path, width=24), *SCENE, "--out", tmp_path / "s")
    assert code == 2
    assert approved("recording.wrong_width", width=24, channels=CHANNELS) in err


def test_a_failed_import_leaves_nothing_in_the_way_of_the_corrected_one(run, tmp_path):
    wrong, right = (write_logs(tmp_path / name, width=width) for name, width in (("wrong", 24), ("right", CHANNELS)))
    there = tmp_path / "there"
    there.mkdir()
    (there / "notes.txt").write_text("mine")
    for out in (there, tmp_path / "a" / "new"):
        code, _, err = run("import", "yarp", *wrong, *SCENE, "--out", out)
        assert code == 2
        assert err.rstrip().endswith(approved("recording.nothing_made"))
    assert not (tmp_path / "a").exists()
    assert [path.name for path in there.iterdir()] == ["notes.txt"]
    assert run("import", "yarp", *right, *SCENE, "--out", there)[0] == 0
    before = sorted(there.rglob("*"))
    code, _, err = run("import", "yarp", *wrong, *SCENE, "--out", there)
    assert code == 2
    assert approved("session.holds_one") in err
    assert sorted(there.rglob("*")) == before, "an older session is never taken away"


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
    code, _, err = run("export", session, "--format", "csv", "--out", tmp_path / "p.csv", "--part", "chest")
    assert (code, (tmp_path / "p.csv").exists()) == (2, False)
    assert "expected --format icub" in err
    code, _, err = run("solve", session, "--part", "chest")
    assert code == 2
    assert "expected --out" in err


@pytest.mark.parametrize(
    "taxel", ['{"channel": 1, "position_m": [1, 2]}', '{"channel": 1, "position_m": null}', '{"channel": 1}', "3"]
)
def test_a_reference_that_is_none_is_said(run, session, tmp_path, taxel):
    path = tmp_path / "truth.json"
    path.write_text(f'{{"taxels": [{taxel}]}}')
    code, _, err = run("solve", session, "--reference", path)
    assert code == 2
    assert approved("export.no_reference") in err


@pytest.mark.parametrize("options", [["--operator", "told"], ["--operator", "guided"], ["--tcp"]])
def test_what_only_serving_can_do_is_refused_for_a_session(run, tmp_path, options):
    code, _, err = run("simulate", *SCENE, "--out", tmp_path / "s", *options)
    assert code == 2
    assert approved("operator.for_serve", options=" ".join(options)) in err
    assert not (tmp_path / "s").exists()


COMMANDS = ["", "solve", "export", "simulate", "record", "import", "import yarp", "import csv"]


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_an_example(run, command):
    code, out, _ = run(*command.split(), "--help")
    assert code == 0
    assert "Example" in out
    assert f"skincal {command}".strip() in out.partition("Example")[2]


def test_the_help_names_what_the_window_takes(run):
    _, out, _ = run("--help")
    for option in ("scene", "wrench", "skin", "joints", "targets", "new", "session", "headless"):
        assert f"--{option}" in out


@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in ("", "import")])
def test_every_command_can_print_json(run, command):
    assert "--json" in run(*command.split(), "--help")[1]


@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "{tmp}/none"], ["solve", "{tmp}"], ["solve", "{tmp}/file"], ["export", "{tmp}", "--format", "icub"],
        ["simulate", "--scene", "nope"], ["simulate", "--scene", "{tmp}"], ["simulate", *SCENE, "--pokes", "-1"],
        ["simulate", *SCENE, "--poses", "9"],
        ["import", "csv", "--wrench", "{tmp}/file", "--skin", "{tmp}/file", *SCENE],
        ["import", "csv", "--wrench", "{tmp}", "--skin", "{tmp}", *SCENE],
        ["import", "yarp", "--wrench", "{tmp}/none", "--skin", "{tmp}/none", *SCENE],
        ["import", "yarp", "--wrench", "{tmp}/file", "--skin", "{tmp}/file", *SCENE],
    ],
)  # fmt: skip
def test_bad_input_is_the_users(run, tmp_path, arguments):
    (tmp_path / "file").write_bytes(b"")
    filled = [argument.format(tmp=tmp_path) for argument in arguments]
    code, out, err = run(*filled, "--out", tmp_path / "out")
    assert (code, out) == (2, "")
    assert err.strip()
    assert not (tmp_path / "out").exists()


def test_an_arm_without_a_pose_is_refused_before_anything_is_recorded(tmp_path, capsys):
    out = tmp_path / "out"
    arguments = ["record", "--wrench", "socket://127.0.0.1:9", "--skin", "socket://127.0.0.1:9", "--scene", "icub-forearm"]
    assert main([*arguments, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "--joints" in said
    assert "--pose" in said
    assert not out.exists()


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


def test_help_does_not_wait_for_numpy():
    seen = "import sys; from skincal.cli import main; main(['solve', '--help']); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", seen], stdout=subprocess.DEVNULL, check=False).returncode == 0
