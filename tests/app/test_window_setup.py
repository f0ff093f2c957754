"""The page that sets a session up, and the addresses of a session that is open: real bytes over TCP, UDP and a pty."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QMessageBox
from scipy.spatial.transform import Rotation

from app.builder.fixed_point_dialog import FixedPointDialog
from app.dialogs.dialog import StandardButton
from app.dialogs.new_session import NO_DEVICE, RECORDING_PAUSED, NewSessionDialog
from app.session.opening import Addresses, OpenRequest
from app.session.recording import Recording
from app.state.running import Running
from app.state.view_state import LinkStatus
from app.text.message import connect_words
from skincal.journal.reader import SessionLog
from skincal.model.readings import Loss, Stream
from skincal.model.scene import load_scene, resource
from skincal.part.tool_draft import ToolDraft
from skincal.session.replay import load, replay
from skincal.simulation.outlets import TcpOutlet
from skincal.taxels.result import State
from tests.app.whole_window import OPEN_MS
from tests.approved import approved

Key = Qt.Key
PATCH = resource("scenes/flat-patch/scene.toml")
CHECKOUT = Path(__file__).resolve().parents[2]
FOREARM = resource("scenes/icub-forearm/scene.toml")
CHANNELS = 64  # Of the flat patch
VERDICT_MS = 15_000
SHOTS = os.environ.get("SHOTS", "")


def line(values) -> bytes:
    return ",".join(f"{value:.4f}" for value in values).encode() + b"\n"


class Device:
    """Plain lines, a hundred a second, until it is closed; what they hold may change meanwhile."""

    def __init__(self, outlet, made) -> None:
        self.outlet, self.made, self._done = outlet, made, threading.Event()
        self.address = outlet.address
        self._thread = threading.Thread(target=self._send)
        self._thread.start()

    def _send(self) -> None:
        while not self._done.wait(0.01):
            self.outlet.poll()
            data = self.made()
            if data:
                self.outlet.write(data)

    def close(self) -> None:
        self._done.set()
        self._thread.join(5.0)
        self.outlet.close()


def noisy(width):
    rng = np.random.default_rng(width)
    return lambda: line(rng.normal(100.0, 0.5, width))


def still(width):
    return lambda: line(np.full(width, 7.0))


@pytest.fixture
def device():
    """Make a device on a TCP port, or another outlet, that ends with the test."""
    with ExitStack() as ends:
        yield lambda made, outlet=None: ends.enter_context(closing(Device(outlet or TcpOutlet(), made)))


@pytest.fixture
def page(qtbot, tmp_path):
    dialog = NewSessionDialog(OpenRequest(scene=PATCH, folder=tmp_path / "new"))
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.open()
    yield dialog
    dialog.reject()


def name(dialog, stream, address):
    """Type an address, and Enter."""
    field = dialog.fields[stream]
    field.setFocus()
    field.selectAll()
    QTest.keyClicks(field, address)
    QTest.keyClick(field, Key.Key_Return)


def says(qtbot, dialog, stream, words):
    row = dialog.rows[Stream(stream)]
    qtbot.waitUntil(lambda: words in row.verdict.text(), timeout=VERDICT_MS)
    assert words in row.field.accessibleDescription()
    return row


def test_good_devices_are_said_to_be_with_their_rate_and_a_curve(qtbot, page, device):
    name(page, "wrench", device(noisy(6)).address)
    name(page, "skin", device(noisy(CHANNELS)).address)
    for stream in ("wrench", "skin"):
        row = says(qtbot, page, stream, "good")
        assert "Hz" in row.rate.text()
        before = row.curve.grab().toImage()
        qtbot.waitUntil(lambda row=row, before=before: row.curve.grab().toImage() != before, timeout=VERDICT_MS)
    assert page.rows[Stream.JOINTS].verdict.text() == ""
    page.reject()
    qtbot.waitUntil(lambda: not any(t.name.startswith("reader ") for t in threading.enumerate()), timeout=5000)


def test_devices_in_each_others_place_are_told_and_one_key_swaps_them(qtbot, page, device):
    name(page, "wrench", device(noisy(CHANNELS)).address)
    name(page, "skin", device(noisy(6)).address)
    says(qtbot, page, "wrench", approved("links.other_stream", found="skin", width=CHANNELS))
    says(qtbot, page, "skin", approved("links.other_stream", found="force/torque sensor", width=6))
    QTest.keyClick(page.fields["skin"], Key.Key_F6)
    says(qtbot, page, "wrench", "good")
    says(qtbot, page, "skin", "good")


def test_an_address_where_nobody_listens_says_why(qtbot, page):
    with closing(TcpOutlet()) as outlet:
        address = outlet.address
    name(page, "wrench", address)
    says(qtbot, page, "wrench", "no answer")
    assert "connection refused" in page.rows[Stream.WRENCH].verdict.text()
    too_long = "1001 characters; expected at most 1000"
    for wrong, why in (("spy:///dev/ttyACM0?file=x", "begin with spy:"), ("x" * 1001, too_long)):
        page.fields["wrench"].clear()
        name(page, "wrench", wrong)
        says(qtbot, page, "wrench", why)


def test_a_link_that_does_not_answer_never_holds_the_page(qtbot, page, monkeypatch):
    """Not while it opens, not while it is changed, and not as the page closes."""
    opening, closed, waited_in_vain = threading.Event(), threading.Event(), []

    def slow(_):
        opening.set()
        waited_in_vain.append(not closed.wait(60.0))
        raise AssertionError

    monkeypatch.setattr("skincal.streams.transports.tcp.TcpLink.__init__", lambda *_: slow(_))
    monkeypatch.setattr("skincal.streams.links.Reader._report", lambda *_: None)
    name(page, "wrench", "socket://127.0.0.1:9")
    qtbot.waitUntil(opening.is_set, timeout=5000)
    name(page, "wrench", "socket://127.0.0.1:10")
    page.reject()
    assert not page.isVisible()
    closed.set()
    assert not any(waited_in_vain)


def test_what_is_there_is_listed_and_chosen_by_keys(qtbot, tmp_path, device, monkeypatch):
    skin = device(noisy(CHANNELS))
    monkeypatch.setattr(
        "app.dialogs.new_session.list_ports", lambda: [("/dev/ttyUSB7", "FT232R USB UART"), (skin.address, "x")]
    )
    dialog = NewSessionDialog(OpenRequest(scene=PATCH, folder=tmp_path / "new"), None, ("socket://192.168.0.9:7000",))
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose, on=False)
    qtbot.addWidget(dialog)
    with qtbot.waitExposed(dialog):
        dialog.open()
    box = dialog.rows[Stream.SKIN].box
    qtbot.waitUntil(lambda: box.count() == 3, timeout=5000)
    assert [box.itemText(index).split()[0] for index in range(3)] == ["/dev/ttyUSB7", skin.address, "socket://192.168.0.9:7000"]
    assert "FT232R USB UART" in box.itemText(0)
    assert dialog.fields["skin"].text() == ""
    box.setFocus()
    for key in (Key.Key_Down, Key.Key_Down):
        QTest.keyClick(box, key)
    if dialog.fields["skin"].text() != skin.address:
        box.activated.emit(1)
    assert dialog.fields["skin"].text() == skin.address
    says(qtbot, dialog, "skin", "good")
    dialog.reject()


def test_who_only_passes_through_a_field_connects_nothing(qtbot, page):
    with closing(TcpOutlet()) as outlet:
        page.rows[Stream.WRENCH].set_address(outlet.address, agreed=False)
        for stream in ("wrench", "skin", "wrench"):
            page.fields[stream].setFocus()
            qtbot.wait(100)
        page.folder.setFocus()
        assert outlet.poll()[0] is False
        assert page.rows[Stream.WRENCH].verdict.text() == ""


def test_a_scene_that_cannot_be_read_is_said_and_no_link_is_judged_by_the_one_before(qtbot, page, device, tmp_path):
    name(page, "skin", device(noisy(CHANNELS)).address)
    row = says(qtbot, page, "skin", "good")
    page.scene.setEditText(str(tmp_path / "gone.toml"))
    qtbot.waitUntil(lambda: "gone.toml" in page.objection.text(), timeout=5000)
    qtbot.waitUntil(lambda: row.verdict.text() == "", timeout=5000)
    page.scene.setEditText(str(PATCH))
    says(qtbot, page, "skin", "good")
    assert page.objection.text() == ""


def test_ports_that_are_found_leave_the_cursor_where_it_is(page):
    row = page.rows[Stream.WRENCH]
    row.set_address("/dev/ttyUSB0", agreed=False)
    row.field.setCursorPosition(4)
    row.set_ports([("/dev/ttyUSB7", "FT232R")])
    QTest.keyClicks(row.field, "x")
    assert row.address == "/devx/ttyUSB0"


@pytest.mark.parametrize("percent", [75, 200])
def test_the_page_fits_the_smallest_screen_with_every_text(bench, qtbot, device, percent):
    bench.window.text_size.choose(percent)
    bench.key(Key.Key_N, Qt.KeyboardModifier.ControlModifier)
    bench.until(lambda: isinstance(QApplication.activeWindow(), NewSessionDialog), 5000)
    dialog = QApplication.activeWindow()
    name(dialog, "wrench", device(noisy(384)).address)
    row = says(qtbot, dialog, "wrench", approved("links.other_stream", found="skin", width=384))
    assert dialog.frameGeometry().width() <= 1280
    assert dialog.frameGeometry().height() <= 720
    qtbot.waitUntil(lambda: row.verdict.height() >= row.verdict.heightForWidth(row.verdict.width()), timeout=5000)
    assert dialog.area.horizontalScrollBar().maximum() == 0
    assert dialog.buttons.isVisible()
    if SHOTS:
        dialog.grab().save(f"{SHOTS}/page-{percent}.png")
    dialog.reject()
    bench.window.text_size.choose()


# ------------------------------------------------------------------ from makers' devices to estimates


@pytest.fixture
def makers(tmp_path, monkeypatch):
    """Serve a rig as makers' devices, as `skincal simulate` does; return the address of each stream."""
    with ExitStack() as ends:

        def serve(named):
            options = ["--serve", "--tcp", "--as", named, "--scene", str(PATCH), "--careful", "--pace", "4", "--json"]
            command = [sys.executable, "-P", "-m", "skincal.cli", "simulate", *options]
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
            process = ends.enter_context(subprocess.Popen(command, cwd=CHECKOUT, **pipes))
            ends.callback(process.stdin.close)
            links = {link["name"]: link["address"] for link in json.loads(process.stdout.readline())["links"]}
            server = links["wrench"].removeprefix("yarp://").split("/")[0]
            (tmp_path / "yarp.conf").write_text(f"{server.replace(':', ' ')} yarp\n", encoding="ascii")
            monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
            return links

        yield serve


def choose_port(row, words):
    """Go down the list by keys to the place that holds these words."""
    row.box.setFocus()
    for _ in range(row.box.count()):
        QTest.keyClick(row.box, Key.Key_Down)
        if words in row.field.text():
            return
    raise AssertionError([row.box.itemText(index) for index in range(row.box.count())])


def test_a_session_over_makers_devices_goes_from_the_page_to_estimates(bench, qtbot, makers):
    """Chosen of the ports that a name server knows; *good* for both, Start, pokes, estimates."""
    links = makers("yarp")
    bench.key(Key.Key_N, Qt.KeyboardModifier.ControlModifier)
    page = shown_page(bench)
    page.scene.setCurrentIndex(page.scene.findText("flat-patch"))
    for stream in ("wrench", "skin"):
        box = page.rows[Stream(stream)].box
        bench.until(lambda box=box: box.count() > 2, 5000)
        choose_port(page.rows[Stream(stream)], links[stream].split("/", 3)[3])
    for stream in ("wrench", "skin"):
        row = says(qtbot, page, stream, "good")
        bench.until(lambda row=row: "Hz" in row.rate.text(), 5000)
    with qtbot.waitSignal(bench.controller.session_opened, timeout=40_000):
        QTest.keyClick(page.buttons.buttons()[0], Key.Key_Space)
    bench.until(lambda: len(bench.accepted()) >= 3)
    bench.until(lambda: any(e.state is State.TOUCHED for e in bench.window.session_view.state.estimates))
    assert set(looks(bench).values()) == {LinkStatus.STREAMING}
    assert bench.window.session_view.state.guidance is not None
    losses = [link.losses for link in bench.window.session_view.state.live.links]
    assert not any(loss in found for found in losses for loss in (Loss.MISSING, Loss.UNREADABLE, Loss.BAD_WIDTH))


# ------------------------------------------------------------------ the session that is open


def open_patch(bench, wrench, skin, **changes):
    bench.open(
        OpenRequest(scene=PATCH, addresses=Addresses(wrench.address, skin.address), folder=bench.documents / "s", **changes)
    )


def line_says(bench, headline, detail=""):
    now = bench.window.session_view.workspace.now
    bench.until(lambda: headline in now.headline.text() and detail.lower() in now.detail.text().lower(), VERDICT_MS)


def looks(bench):
    state = bench.window.session_view.state
    return {link.link: state.status_of(link) for link in state.live.links}


def shown_page(bench):
    bench.until(lambda: isinstance(QApplication.activeWindow(), NewSessionDialog), 5000)
    return QApplication.activeWindow()


def test_a_wrong_device_is_said_in_the_line_and_its_light_is_not_blue(bench, device):
    open_patch(bench, device(noisy(6)), device(noisy(20)))
    words = approved("links.other_width", width=20, of="the scene has", expected=CHANNELS)
    line_says(bench, "Skin: ", words)
    bench.until(lambda: looks(bench) == {"wrench": LinkStatus.STREAMING, "skin": LinkStatus.WRONG}, VERDICT_MS)
    workspace = bench.window.session_view.workspace
    workspace.show_tab("Devices")
    bench.until(lambda: workspace.panels["Devices"].cards["skin"].detail.text() == words, 5000)
    cards = workspace.panels["Devices"].cards
    assert cards["force/torque sensor"].sign.text() != cards["skin"].sign.text()


def test_a_sensor_that_freezes_is_a_fault_until_it_lives_again(bench, device):
    wrench = device(noisy(6))
    open_patch(bench, wrench, device(noisy(CHANNELS)))
    bench.until(lambda: set(looks(bench).values()) == {LinkStatus.STREAMING}, VERDICT_MS)
    bench.qtbot.wait(500)
    living, wrench.made = wrench.made, still(6)
    line_says(bench, "Force/torque sensor stuck", approved("links.frozen"))
    assert looks(bench)["wrench"] is LinkStatus.FROZEN
    bench.until(lambda: ("LOST", "") in bench.player.played, 5000)
    wrench.made = living
    bench.until(lambda: looks(bench)["wrench"] is LinkStatus.STREAMING, VERDICT_MS)


def test_a_sensor_that_never_changes_is_a_fault_and_no_robot_is_asked_meanwhile(bench, device):
    wrench = device(still(6))
    open_patch(bench, wrench, device(noisy(CHANNELS)))
    line_says(bench, "Force/torque sensor stuck", approved("links.frozen"))
    bench.until(lambda: looks(bench) == {"wrench": LinkStatus.FROZEN, "skin": LinkStatus.STREAMING}, VERDICT_MS)
    bench.until(lambda: ("LOST", "") in bench.player.played, 5000)
    pipeline = bench.recording.pipeline
    assert not pipeline.can_measure(time.monotonic_ns())
    wrench.made = noisy(6)
    bench.until(lambda: looks(bench)["wrench"] is LinkStatus.STREAMING, VERDICT_MS)
    bench.until(lambda: pipeline.can_measure(time.monotonic_ns()), VERDICT_MS)


def test_an_address_is_changed_by_keys_while_the_session_is_open_and_is_offered_again(bench, device, qtbot):
    wrench, skin, other = device(noisy(6)), device(noisy(20)), device(noisy(CHANNELS))
    open_patch(bench, wrench, skin)
    line_says(bench, "Skin: ")
    bench.key(Key.Key_A)
    page = shown_page(bench)
    assert bench.controller.running is Running.PAUSED, "a serial port has one reader"
    says(qtbot, page, "wrench", "good")
    name(page, "skin", other.address)
    says(qtbot, page, "skin", "good")
    QTest.keyClick(page.buttons.buttons()[0], Key.Key_Space)
    bench.until(lambda: bench.controller.running is Running.STREAMING, 10_000)
    bench.until(lambda: set(looks(bench).values()) == {LinkStatus.STREAMING}, VERDICT_MS)
    workspace = bench.window.session_view.workspace
    workspace.show_tab("Devices")
    bench.until(lambda: other.address in workspace.panels["Devices"].cards["skin"].about.text(), 5000)
    bench.controller.pause()
    bench.until_all_is_taken_in()
    bench.recording.pipeline.sync()
    folder = bench.documents / "s"
    bench.open(OpenRequest(session=folder))
    assert [link.address for link in bench.controller.links] == [wrench.address, other.address]
    bench.controller.toggle()
    assert bench.controller.running is Running.STREAMING, "named by the operator: not asked about again"
    bench.window.close()
    log = SessionLog(folder)
    assert other.address in {link.address for link in log.links} | {link.address for link in replay(folder).links}
    assert load(folder).totals().links == replay(folder).totals().links


def test_who_goes_on_by_a_key_before_new_addresses_are_connected_has_each_device_read_once(bench, device, monkeypatch):
    wrench, skin, other = device(noisy(6)), device(noisy(CHANNELS)), device(noisy(CHANNELS))
    open_patch(bench, wrench, skin)
    bench.until(lambda: bench.controller.running is Running.STREAMING, 10_000)
    started = []
    start = Recording.start
    monkeypatch.setattr(Recording, "start", lambda self: started.append(self.links) or start(self))
    bench.controller.change_addresses(Addresses(wrench.address, other.address))
    bench.controller.toggle()
    later = []
    bench.controller.compute(lambda: None, later.append)
    bench.until(lambda: bool(later), 10_000)
    assert [[link.address for link in links] for links in started] == [[wrench.address, other.address]]


def test_a_page_that_is_left_changes_nothing_and_reads_on(bench, device):
    wrench, skin = device(noisy(6)), device(noisy(CHANNELS))
    open_patch(bench, wrench, skin)
    bench.until(lambda: set(looks(bench).values()) == {LinkStatus.STREAMING}, VERDICT_MS)
    bench.key(Key.Key_N, Qt.KeyboardModifier.ControlModifier)
    page = shown_page(bench)
    assert bench.controller.running is Running.PAUSED
    assert any(RECORDING_PAUSED in label.text() for label in page.findChildren(QLabel))
    QTest.keyClick(page, Key.Key_Escape)
    bench.until(lambda: bench.controller.running is Running.STREAMING, 5000)
    bench.key(Key.Key_A)
    page = shown_page(bench)
    QTest.keyClick(page, Key.Key_Escape)
    bench.until(lambda: bench.controller.running is Running.STREAMING, 5000)
    bench.until(lambda: set(looks(bench).values()) == {LinkStatus.STREAMING}, VERDICT_MS)
    assert [link.address for link in bench.controller.links] == [wrench.address, skin.address]


def test_the_addresses_of_a_stranger_are_shown_and_not_connected_before_enter(bench, device, qtbot, tmp_path):
    from skincal.journal.writer import create_session
    from skincal.model.scene import load_scene
    from skincal.streams.links import LinkSpec

    with closing(TcpOutlet()) as outlet:
        links = (
            LinkSpec("wrench", outlet.address, (Stream.WRENCH,)),
            LinkSpec("skin", device(noisy(CHANNELS)).address, (Stream.SKIN,)),
        )
        create_session(tmp_path / "theirs", load_scene(PATCH), links).close()
        bench.open(OpenRequest(session=tmp_path / "theirs"))
        bench.key(Key.Key_A)
        page = shown_page(bench)
        says(qtbot, page, "wrench", approved("links.not_agreed"))
        says(qtbot, page, "skin", approved("links.not_agreed"))
        qtbot.wait(300)
        assert outlet.poll()[0] is False
        page.fields["skin"].setFocus()
        QTest.keyClick(page.fields["skin"], Key.Key_Return)
        says(qtbot, page, "skin", "good")
        assert outlet.poll()[0] is False
        QTest.keyClick(page.buttons.buttons()[0], Key.Key_Space)
        bench.until(lambda: isinstance(QApplication.activeWindow(), QMessageBox), 5000)
        box = QApplication.activeWindow()
        assert box.text() == connect_words([outlet.address]), "the one that was agreed to is not asked about"
        assert outlet.poll()[0] is False
        box.reject()
        assert bench.controller.running is Running.OFFLINE
        assert outlet.address not in bench.window._known_addresses()


def test_an_unknown_arm_pose_is_asked_before_the_first_poke(bench, device):
    bench.open(
        OpenRequest(
            scene=FOREARM,
            addresses=Addresses(device(noisy(6)).address, device(noisy(384)).address),
            folder=bench.documents / "s",
        )
    )
    line_says(bench, "Choose the arm pose", "Key 7")
    assert not bench.snapshot.pokes
    bench.key(Key.Key_7)
    poses = bench.window.session_view.workspace.panels["Rig"].arm.poses
    poses.setFocus()
    poses.setCurrentItem(poses.topLevelItem(0))
    poses.itemActivated.emit(poses.topLevelItem(0), 0)
    now = bench.window.session_view.workspace.now
    bench.until(lambda: "arm pose" not in now.headline.text(), 5000)
    assert bench.window.session_view.state.live.link_from_sensor is not None


def test_the_page_asks_for_the_arm_pose_where_no_joints_say_it(bench, device, qtbot):
    bench.key(Key.Key_N, Qt.KeyboardModifier.ControlModifier)
    page = shown_page(bench)
    page.scene.setCurrentIndex(page.scene.findText("icub-forearm"))
    qtbot.waitUntil(lambda: page.pose.count() > 1, timeout=10_000)
    assert not page.pose.isVisible(), "a simulated rig says it"
    name(page, "wrench", device(noisy(6)).address)
    name(page, "skin", device(noisy(384)).address)
    assert page.pose.isVisible()
    page.pose.setCurrentIndex(2)
    chosen = page.pose.currentText()
    with qtbot.waitSignal(bench.controller.session_opened, timeout=40_000):
        QTest.keyClick(page.buttons.buttons()[0], Key.Key_Space)
    bench.until(lambda: bench.window.session_view.state is not None, 10_000)
    assert bench.window.session_view.state.live.pose == chosen


def test_enter_in_the_folder_starts_and_the_simulated_rig_is_told_of_only_without_devices(page, qtbot):
    assert NO_DEVICE in {label.text() for label in page.findChildren(QLabel)}
    page.fields["wrench"].setText("netft://192.0.2.1")
    assert NO_DEVICE not in {label.text() for label in page.findChildren(QLabel)}
    page.fields["wrench"].setText("")
    page.folder.setFocus()
    with qtbot.waitSignal(page.request_chosen, timeout=5000):
        QTest.keyClick(page.folder, Key.Key_Return)


def test_the_operators_own_parts_are_listed_above_the_shipped_scenes(bench):
    for name in ("tube", "flat-patch"):
        shutil.copytree(PATCH.parent, bench.documents / "scenes" / name)
    bench.window.commands.actions["new"].trigger()
    dialog = bench.window.findChild(NewSessionDialog)
    picker = dialog.scene
    listed = [picker.itemText(row) for row in range(picker.count())]
    assert listed == [
        "flat-patch (own)",
        "tube",
        "cobot-forearm",
        "cobot-tip",
        "cobot-wrist",
        "fingertip",
        "flat-patch",
        "icub-forearm",
        "three-axis-pad",
        "whole-body",
    ]
    for text, path in (("tube", bench.documents / "scenes/tube/scene.toml"), ("flat-patch", PATCH)):
        with bench.qtbot.waitSignal(picker.scene_read, timeout=OPEN_MS) as read:
            picker.setCurrentText(text)
        assert read.args[0].path == path
        assert picker.file() == path
    dialog.reject()


def test_a_recent_session_names_its_part(bench, recorded):
    bench.open(OpenRequest(session=recorded))
    bench.window.recent.fill()
    (action,) = bench.window.recent.actions()
    assert action.text().endswith(f"   {bench.window.session_view.workspace.part.scene.name}")


TIP_TEXT = (
    'name = "plate"\nlink = "base"\n[skin]\nchannels = 9\n'
    '[tool]\nsensor = "none"\nrotation = "xyzw"\nunit = "m"\ntip_mm = [0, 0, 150]  # guessed\ntip_radius_mm = 2.0\n'
)
TIP_M, POINT_M = np.array([0.012, -0.004, 0.121]), np.array([0.4, -0.2, 0.1])
LEANS = np.array([(0.1, 3.0, 0.0), (0.5, 2.6, 0.3), (-0.4, 2.9, 0.2), (0.2, 2.5, -0.6)])


def open_fixed_point(bench):
    bench.key(Key.Key_T, Qt.KeyboardModifier.ControlModifier)
    bench.until(lambda: isinstance(QApplication.activeWindow(), FixedPointDialog), 5000)
    return QApplication.activeWindow()


def touch_from_all_sides(bench, pose):
    """Make the fixed-point test of the menu on the running stream, up to its last button."""
    dialog = open_fixed_point(bench)
    for number, lean in enumerate(LEANS, start=1):
        rotation = Rotation.from_rotvec(lean)
        pose[:] = np.concatenate([POINT_M - rotation.apply(TIP_M), rotation.as_quat()])

        def touched(number=number) -> bool:
            dialog.take_touch()  # the space bar; refused until the tool has been at rest for half a second
            return dialog.list.count() == number

        def has_come() -> bool:
            sent = dialog.live.sent_pose
            return sent is not None and np.abs(np.array(sent.numbers) - pose).max() < 1e-4

        # Before the new pose comes, the tool is at rest at the last one.
        bench.until(has_come, VERDICT_MS)
        bench.until(touched, VERDICT_MS)
    assert "Tip in the tool's frame: 12.0" in dialog.said.text()
    return dialog


def answer_question(bench, button):
    bench.until(lambda: isinstance(QApplication.activeWindow(), QMessageBox), 5000)
    box = QApplication.activeWindow()
    words = box.text()
    QTest.mouseClick(next(each for each in box.buttons() if each.text().replace("&", "") == button), Qt.MouseButton.LeftButton)
    return words


def test_the_fixed_point_test_of_the_menu_writes_the_tip_with_consent_and_reads_the_devices_again(bench, device, tmp_path):
    scene, pose = tmp_path / "part" / "scene.toml", np.array([0.4, -0.2, 0.3, 0.0, 1.0, 0.0, 0.0])
    scene.parent.mkdir()
    scene.write_text(TIP_TEXT)
    skin, tool = device(noisy(9)), device(lambda: line(pose))
    assert not bench.window.commands.actions["fixed point"].isEnabled(), "no part that a tool pokes"
    bench.open(OpenRequest(scene=scene, addresses=Addresses(skin=skin.address, tool=tool.address)))
    bench.until(lambda: set(looks(bench).values()) == {LinkStatus.STREAMING}, VERDICT_MS)
    dialog = open_fixed_point(bench)
    bench.until(lambda: bench.controller.running is Running.PAUSED, 5000)
    dialog.accept()
    dialog.found.emit(ToolDraft("xyzw", "m", tip_mm=(1.0, 2.0, 3.0)))
    assert "tip_mm = [1, 2, 3] will be written" in answer_question(bench, "Cancel")
    assert scene.read_text() == TIP_TEXT, "without consent nothing is written"
    bench.until(lambda: bench.controller.running is Running.STREAMING, 5000)
    dialog = touch_from_all_sides(bench, pose)
    with bench.qtbot.waitSignal(bench.controller.session_opened, timeout=OPEN_MS):
        dialog.button(StandardButton.Ok).click()
        asked = answer_question(bench, "Write")
    copy = bench.controller.folder / "scene" / "scene.toml"
    assert str(copy) in asked
    assert str(scene) in asked
    for path in (scene, copy):
        assert load_scene(path).tool.tip == pytest.approx(TIP_M, abs=0.0005)
        assert "tip_radius_mm = 2.0" in path.read_text()
    assert bench.recording.pipeline.scene.tool.tip == pytest.approx(TIP_M, abs=0.0005)
    bench.until(lambda: set(looks(bench).values()) == {LinkStatus.STREAMING}, VERDICT_MS)
