"""What a command prints, and newer Bota sensors by the maker's driver, which is a command, too."""

import importlib.util
import json
import os
import queue
import re
import shutil
import subprocess
import sys
import time
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from skincal.child_environment import OPERATOR_VALUE_VARIABLE, SAFE_PATH_VARIABLE
from skincal.cli import main
from skincal.devices.bota import BotaDecoder, driver_settings
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.plain import split_command
from skincal.devices.registry import parse_device
from skincal.journal.documents import SegmentHeader, link_to_json, read_document
from skincal.journal.reader import SessionLog
from skincal.model.errors import InputError
from skincal.model.readings import TEMPERATURE_NAME, LinkState, Loss, Stream
from skincal.session.replay import resume
from skincal.streams.bota_child import driver_config, encode_frame
from skincal.streams.links import LinkSpec, Reader, format_of, open_link, parse_address
from tests.skincal.poke_script import as_chunks, some_pokes, write_scene
from tests.skincal.streams.link_support import next_data, next_event, reading

PATIENCE_S = 30.0
FAKE = Path(__file__).with_name("fake_bota_driver.py")
posix = pytest.mark.skipif(sys.platform == "win32", reason="words of a shell of POSIX")


def opened(address, stream=Stream.WRENCH):
    return closing(open_link(LinkSpec("link", address, (stream,))))


def all_of(link):
    """Everything until the end, and the failure that says so."""
    data, end = b"", time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            data += link.read(0.1)
        except LinkError as failure:
            return data, failure
    raise AssertionError(data)


def script(folder, text):
    path = folder / "sensor.py"
    path.write_text(text, encoding="utf-8")
    return f"run:{sys.executable} {path}"


# ------------------------------------------------------------------ commands


def test_what_a_command_prints_comes_whole_and_its_end_is_said(tmp_path):
    address = script(tmp_path, "for k in range(5_000):\n    print(k, 1, 2, 3, 4, 5, 6)\n")
    with opened(address) as link:
        data, failure = all_of(link)
    assert data.decode().split("\n") == [*(f"{k} 1 2 3 4 5 6" for k in range(5_000)), ""]
    assert (failure.kind, str(failure)) == (FailureKind.ENDED, f"{address}: the command has ended.")


@posix
@pytest.mark.parametrize("quiet", ["", ">/dev/null 2>&1 "], ids=["holds the pipe", "holds nothing"])
def test_a_child_that_outlives_its_command_and_wants_no_end_is_ended_too(tmp_path, quiet):
    mark = tmp_path / "child"
    stubborn = f"trap '' TERM; echo $$ > {mark}.new; mv {mark}.new {mark}; while :; do sleep 0.1; done"
    (tmp_path / "child.sh").write_text(stubborn)
    (tmp_path / "command.sh").write_text(f"echo 1 2\nsh {tmp_path}/child.sh {quiet}&\nsleep 0.5\n")
    with opened(f"run:sh {tmp_path}/command.sh") as link:
        end = time.monotonic() + PATIENCE_S
        while not (mark.exists() and link._process.poll() is not None) and time.monotonic() < end:
            time.sleep(0.02)
    end = time.monotonic() + PATIENCE_S
    while (_runs(int(mark.read_text())) or link._threads[0].is_alive()) and time.monotonic() < end:
        time.sleep(0.02)
    assert not _runs(int(mark.read_text()))
    assert not link._threads[0].is_alive()


def _runs(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_command_that_prints_without_end_is_ended_too(tmp_path):
    address = script(tmp_path, "while True:\n    print('1,2,3,4,5,6' * 1000)\n")
    began = time.monotonic()
    with opened(address) as link:
        time.sleep(0.5)
        assert link.read(1.0)
    assert time.monotonic() - began < 10


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import sys\nsys.exit('no sensor\\n\\nis plugged in.')\n", "code 1: is plugged in."),
        ("raise SystemExit(0)\n", "has ended."),
    ],
)
def test_a_command_that_ends_at_once_says_why_and_is_not_started_again(tmp_path, text, said):
    with pytest.raises(LinkError, match=re.escape(said)) as failed, opened(script(tmp_path, text)):
        pass
    assert failed.value.kind is FailureKind.ADDRESS


def test_a_command_that_is_none_is_said():
    words = r"cannot be started: .*check the command"
    with pytest.raises(LinkError, match=words) as failed, opened("run:no-such-program-here"):
        pass
    assert failed.value.kind is FailureKind.ADDRESS


@posix
def test_no_shell_reads_a_command(tmp_path):
    with opened(f"run:echo 1,2 ; touch {tmp_path}/made") as link:
        data, _ = all_of(link)
    assert data == f"1,2 ; touch {tmp_path}/made\n".encode()
    assert list(tmp_path.iterdir()) == []


def test_on_windows_a_command_is_one_line_and_ends_with_all_that_it_started(tmp_path, monkeypatch):
    with opened(script(tmp_path, "import time\nprint('1 2')\ntime.sleep(60)\n")) as link:
        ended = []
        monkeypatch.setattr(sys, "platform", "win32")
        for line in ("C:\\O'Brien\\my_sensor.exe --rate 100", '"C:\\my dir\\" x'):
            assert split_command(parse_device(f"run:{line} ").path) == line
        with pytest.raises(InputError, match="Example: run:"):
            parse_address("run:  ")
        monkeypatch.setenv("SYSTEMROOT", "W")
        monkeypatch.setattr(subprocess, "run", lambda command, **_: ended.append(command))
        pid = link._process.pid
        link.close()
    assert ended[0][1:] == ["/F", "/T", "/PID", str(pid)]
    assert Path(ended[0][0]) == Path("W", "System32", "taskkill.exe")
    assert link._process.poll() is not None, "the command itself in any case"


@pytest.mark.parametrize("value", [None, "", "1"])
def test_a_script_imports_its_driver_from_its_own_folder(tmp_path, monkeypatch, value):
    """As the example of the manual, also from the command line and the window, which protect their own processes."""
    monkeypatch.delenv(OPERATOR_VALUE_VARIABLE, raising=False)
    monkeypatch.setenv(SAFE_PATH_VARIABLE, value) if value is not None else monkeypatch.delenv(
        SAFE_PATH_VARIABLE, raising=False
    )
    assert main(["--version"]) == 0
    assert os.environ[SAFE_PATH_VARIABLE] == "1"
    (tmp_path / "own_driver.py").write_text("LINE = '1,2,3'\n", encoding="utf-8")
    address = script(tmp_path, "import own_driver\nprint(own_driver.LINE)\n")
    if value:  # the operator's own wish
        with pytest.raises(LinkError, match="own_driver"), opened(address):
            pass
    else:
        with opened(address) as link:
            assert all_of(link)[0].split() == [b"1,2,3"]


def test_two_commands_are_recorded_and_their_session_never_starts_them(tmp_path, capsys):
    """Sensor and skin by a command each; the session keeps what they were, plays the same, and opens neither again."""
    scene = write_scene(tmp_path)
    items = [item for item in as_chunks(some_pokes(scene, 2).samples) if hasattr(item, "data")]
    ran = tmp_path / "ran"
    options = []
    for name in ("wrench", "skin"):
        data = tmp_path / f"{name}.bin"
        data.write_bytes(b"".join(item.data for item in items if item.link == name))
        program = tmp_path / f"{name}.py"
        program.write_text(
            "import sys, time\n"
            f"open({str(ran)!r}, 'a').write('{name} ')\n"
            f"data = open({str(data)!r}, 'rb').read()\n"
            f"step = -(-len(data) // {round(items[-1].host_ns * 1e-9 - items[0].host_ns * 1e-9) * 50})\n"
            "began = time.monotonic()\n"
            "for k, at in enumerate(range(0, len(data), step)):\n"
            "    time.sleep(max(0, began + k * 0.02 - time.monotonic()))\n"
            "    sys.stdout.buffer.write(data[at:at + step])\n"
            "    sys.stdout.buffer.flush()\n",
            encoding="utf-8",
        )
        options += [f"--{name}", f"run:{sys.executable} {program}"]
    out = tmp_path / "s"
    assert main(["record", *options, "--scene", str(scene.path), "--out", str(out), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["accepted"], result["links"]["wrench"]["lost"]) == (2, {})
    assert sorted(ran.read_text().split()) == ["skin", "wrench"]
    assert main(["solve", str(out), "--replay", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["accepted"] == 2

    log = SessionLog(out)
    assert all(link.address.startswith("ran:") for link in log.links)
    assert '"address": "run:' not in "".join(path.read_text(encoding="utf-8") for path in out.glob("*.jsonl"))
    pipeline = resume(out)
    try:
        for link in pipeline.links:
            with pytest.raises(LinkError, match="a session starts none; type run:"):
                open_link(link)
    finally:
        pipeline.close()
    assert sorted(ran.read_text().split()) == ["skin", "wrench"]


def test_a_stranger_who_writes_a_command_into_a_session_is_not_obeyed(tmp_path):
    """Not what skincal writes: what it reads."""
    link = {**link_to_json(LinkSpec("wrench", "x", (Stream.WRENCH,))), "address": "run:touch x"}
    document = {"type": "segment", "segment": 1, "format": 3, "scene": "", "links": [link], "host_ns": 0}
    mark = read_document(json.dumps(document).encode(), tmp_path)
    assert isinstance(mark, SegmentHeader)
    assert mark.links[0].address == "ran:touch x"
    with pytest.raises(InputError, match="was recorded from a command"):
        parse_address(mark.links[0].address)
    assert format_of("ran:x", "auto") == format_of("run:x", "auto") == "auto"


# ------------------------------------------------------------------ the maker's driver for newer Bota sensors


@pytest.fixture
def fake_driver(tmp_path, monkeypatch):
    """The fake where this process and its children find it; the file that says that a sensor was left."""
    folder, left = tmp_path / "fake", tmp_path / "left"
    folder.mkdir()
    shutil.copy(FAKE, folder / "bota_driver.py")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    monkeypatch.setenv("BOTA_LEFT", str(left))
    monkeypatch.delitem(sys.modules, "bota_driver", raising=False)
    yield left
    sys.modules.pop("bota_driver", None)


def readings(link, enough):
    decoder, found, end = BotaDecoder(None, (Stream.WRENCH,)), [], time.monotonic() + PATIENCE_S
    while len(found) < enough and time.monotonic() < end:
        data = link.read(0.1)
        assert data[:1] in (b"", b"\xaa"), data  # nothing but frames
        for batch in decoder.feed(data):
            found += list(zip(batch.values.tolist(), batch.device_s.tolist(), batch.saturated.tolist(), strict=True))
    return decoder, found


def test_the_drivers_frames_arrive_and_its_chatter_does_not(fake_driver):
    with opened("bota://192.168.0.45") as link:
        decoder, found = readings(link, 20)
        assert "bota_driver" not in sys.modules  # never in this process
    assert decoder.counts == {Loss.SATURATED: 1}
    assert all(row[0] == [1.5, -2.25, 30.0, 0.125, -0.5, 0.0625] for row in found)
    assert [row[2] for row in found[:6]] == [False, False, False, False, True, False]
    steps = [later[1] - earlier[1] for earlier, later in pairwise(found)]
    assert steps == pytest.approx([0.002] * len(steps), abs=1e-6)  # over the wrap of 32 bits, too
    assert decoder.side_readings[TEMPERATURE_NAME].now == 36.5
    if sys.platform != "win32":  # there a process is ended without a word
        assert fake_driver.read_text() == "deactivated"


def test_only_what_is_a_number_is_told_to_the_driver_as_one():
    device = parse_device("bota:///dev/ttyACM0?serial=00123&product=7&mode=3&baud=921600")
    told = {"serial": "00123", "product": "7", "mode": 3, "baud": 921600}
    assert driver_settings(device) == {"kind": "binary", "place": "/dev/ttyACM0", **told}


@pytest.mark.usefixtures("fake_driver")
def test_what_the_driver_says_of_a_sensor_that_is_away_is_said():
    with pytest.raises(LinkError, match="driver has ended with code 3: Failed to open communication with the sensor") as failed:
        open_link(LinkSpec("link", "bota://10.0.0.9", (Stream.WRENCH,)))
    assert failed.value.kind is FailureKind.VANISHED


@pytest.fixture
def hanging(tmp_path, monkeypatch):
    """A driver that hangs in `configure`; return a function that waits for it and returns the number of its process."""
    mark = tmp_path / "hangs"
    monkeypatch.setenv("BOTA_HANGS", str(mark))

    def pid():
        end = time.monotonic() + PATIENCE_S
        while not (mark.exists() and mark.read_text()) and time.monotonic() < end:
            time.sleep(0.02)
        return int(mark.read_text())

    return pid


@posix
@pytest.mark.usefixtures("fake_driver")
def test_a_reader_is_stopped_while_the_driver_hangs_and_its_process_is_gone(hanging):
    items = queue.SimpleQueue()
    reader = Reader(LinkSpec("wrench", "bota://192.168.0.45", (Stream.WRENCH,)), items)
    reader.start()
    child = hanging()
    reader.stop()
    assert not reader.running
    assert not _runs(child)
    assert items.empty(), "who stopped it is told of no fault"


@posix
@pytest.mark.usefixtures("fake_driver")
def test_a_driver_that_hangs_goes_with_the_program_that_started_it(hanging):
    program = "from skincal.streams.links import *\nfrom skincal.model.readings import Stream\n"
    program += "open_link(LinkSpec('wrench', 'bota://192.168.0.45', (Stream.WRENCH,)))"
    parent = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.DEVNULL)
    child = hanging()
    parent.kill()
    parent.wait()
    end = time.monotonic() + 20.0
    while _runs(child) and time.monotonic() < end:
        time.sleep(0.05)
    assert not _runs(child)


@pytest.mark.skipif(importlib.util.find_spec("bota_driver") is not None, reason="the maker's driver is installed")
def test_without_the_driver_one_sentence_says_what_to_install():
    with pytest.raises(LinkError, match="python -m pip install bota-driver") as failed:
        open_link(LinkSpec("link", "bota://192.168.0.45", (Stream.WRENCH,)))
    assert failed.value.kind is FailureKind.ADDRESS


@pytest.mark.usefixtures("fake_driver")
def test_the_fake_is_like_the_driver():
    """Where the maker's driver is installed each name that is used is in it, and its own frame becomes the same bytes."""
    fake = importlib.import_module("bota_driver")
    sys.modules.pop("bota_driver")
    path = [place for place in sys.path if Path(place).name != "fake"]
    spec = importlib.machinery.PathFinder.find_spec("bota_driver", path)
    if spec is None:
        pytest.skip("the maker's driver is not installed: pip install bota-driver")
    real = importlib.util.module_from_spec(spec)
    sys.modules["bota_driver"] = real
    spec.loader.exec_module(real)
    for name in [name for name in vars(fake) if name[0].isupper()]:
        for field in getattr(getattr(fake, name), "FIELDS", ()):
            assert hasattr(getattr(real, name)(), field), (name, field)
    for method in ("configure", "activate", "deactivate", "shutdown", "read_frame_blocking"):
        assert callable(getattr(real.BotaDriver, method))
    for kind in ("socket", "binary", "dummy"):
        driver_config(real, {"kind": kind, "place": "x", "baud": 230400})
    driver = real.BotaDriver(driver_config(real, {"kind": "dummy", "place": "dummy"}))
    assert driver.configure()
    assert driver.activate()
    frame = driver.read_frame_blocking()
    assert driver.deactivate()
    (batch,) = BotaDecoder(None, (Stream.WRENCH,)).feed(encode_frame(frame))
    assert batch.values[0].tolist() == pytest.approx([*frame.force, *frame.torque], rel=1e-6)
    assert batch.device_s[0] == pytest.approx(frame.timestamp % 2**32 * 1e-6)


def test_a_reader_says_that_a_command_began_and_ended(tmp_path):
    with reading(script(tmp_path, "print('1,2,3,4,5,6')\nimport time\ntime.sleep(1)\n")) as items:
        next_event(items, LinkState.OPEN, PATIENCE_S)
        assert next_data(items, 12, PATIENCE_S) == b"1,2,3,4,5,6\n"
        next_event(items, LinkState.ENDED, PATIENCE_S)
