"""`skincal landmarks`: an imported log reaches the error of a session whose landmarks were asked for."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from skincal.cli import main
from skincal.contacts.outcome import Contact
from skincal.journal.reader import SessionLog
from skincal.model.actions import AtLandmark, Exclude, TimedAction, Undo
from skincal.model.scene import load_scene
from skincal.session.replay import load, replay, resume
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from tests.approved import approved
from tests.build import recording
from tests.skincal.poke_script import Script, as_chunks, same_estimates, write_scene
from tests.skincal.sim_support import make_rig

EPOCH = 1_420_000_000.0
POSES = ("1", "2", "3", "6", "7")
"""Those that the streamed joints tell apart: 4 and 5 differ from 1 only in the shoulder."""
EACH, LANDMARK_POKES = 14, 4
"""Pokes on the skin and at landmarks in each of them."""
RESTING = 240.0
"""Raw units; the forearm's answers go down from there."""


class Log:
    """What `yarpdatadumper` writes of a rig with the paper's errors, and at which landmark each poke was."""

    def __init__(self, folder: Path) -> None:
        rig, rng = make_rig(RigErrors.paper(), 1), np.random.default_rng(8)
        self.rig = rig
        at = poke_landmarks(rig, rig.scene.landmarks, LANDMARK_POKES, rng)
        script = Script(rig.scene, rng=rng, force_noise=0.01, moment_noise=0.001, skin_noise=0.5, resting=RESTING).quiet()
        self.names: dict[int, str] = {}
        self.angles: list[np.ndarray] = []
        count = 0
        for name in POSES:
            mine = [poke for poke in at if poke.pose == name]
            # The arm moves, then rests: without a tare in the new pose no poke counts.
            script.quiet(1.0)
            some = unguided(rig, 1, rng).subset(slice(0, EACH))
            for poke in [*mine, *simulate_contacts(rig, some, rng, name)]:
                count += 1
                answers = {}
                if isinstance(poke, Contact):
                    answers = dict(zip(poke.channels.tolist(), np.minimum(poke.responses, 200.0).tolist(), strict=True))
                else:
                    self.names[count] = str(poke.name)
                self._press(script, np.r_[poke.force, poke.moment], answers)
            self.angles += [np.degrees(rig.scene.arm.poses[name])] * (len(script.samples) - len(self.angles))
        self.count = count
        self.folder = folder
        self._write(script)
        (folder / "truth.json").write_text(json.dumps(rig.truth()), encoding="utf-8")

    @staticmethod
    def _press(script: Script, wrench: np.ndarray, answers: dict[int, float]) -> None:
        for share in (0.5, *[1.0] * 22, 0.5):
            script.step(share * wrench, {channel: share * answer for channel, answer in answers.items()})
        script.quiet(0.5)

    def _write(self, script: Script) -> None:
        start = script.samples[0].host_s
        for name in ("wrench", "skin", "joints"):
            (self.folder / name).mkdir()
            with (self.folder / name / "data.log").open("w", encoding="utf-8") as file:
                for seq, (sample, angles) in enumerate(zip(script.samples, self.angles, strict=True)):
                    joints = [0.0, 0.0, 0.0, *angles]
                    values = {"wrench": sample.wrench, "skin": sample.skin, "joints": joints}[name]
                    numbers = " ".join(["%.1f" if name == "skin" else "%.6f"] * len(values)) % tuple(values)
                    stamp = EPOCH + sample.host_s - start
                    file.write(f"{seq} {stamp:.6f} {numbers}\n")

    def arguments(self) -> list[str]:
        return [word for name in ("wrench", "skin", "joints") for word in (f"--{name}", str(self.folder / name))]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return Log(tmp_path_factory.mktemp("log"))


@pytest.fixture(scope="module")
def imported(log, tmp_path_factory):
    folder = tmp_path_factory.mktemp("imported") / "s"
    assert main(["import", "yarp", *log.arguments(), "--scene", "icub-forearm", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def asked(log, imported, tmp_path_factory):
    """The same session as the window records it: each poke at a landmark is named there."""
    folder = shutil.copytree(imported, tmp_path_factory.mktemp("asked") / "s")
    pipeline = resume(folder)
    for number, (poke, name) in enumerate(log.names.items()):
        pipeline.act(AtLandmark(poke, name), number + 1)
    pipeline.close()
    return folder


def corrected_error(folder: Path, log: Log) -> dict[str, float]:
    with pytest.MonkeyPatch.context() as patch:
        said = io.StringIO()
        patch.setattr("sys.stdout", said)
        assert main(["solve", str(folder), "--correct", "--reference", str(log.folder / "truth.json"), "--json"]) == 0
    return {name: method["error_mm"]["mean"] for name, method in json.loads(said.getvalue())["methods"].items()}


@pytest.fixture(scope="module")
def asked_error(log, asked):
    return corrected_error(asked, log)


def test_an_imported_log_knows_no_landmark_until_it_is_said(log, imported, run, answered):
    said = answered("landmarks", imported)
    assert len(said["pokes"]) == log.count
    silent = [row["poke"] for row in said["pokes"] if row["outcome"] == "no taxel answered"]
    assert silent == list(log.names)
    assert {row["landmark"] for row in said["pokes"]} == {None}
    assert len(said["landmarks"]) == 6
    assert said["pokes"][0]["start_s"] == pytest.approx(2.0, abs=0.1)
    text = run("landmarks", imported)[1].splitlines()
    assert text[0].startswith("landmarks, mm: elbow, outer (25.2, 13.2, -3.9);")
    assert len([line for line in text if "nearest is" in line]) == len(log.names)
    assert run("solve", imported, "--correct")[0] == 2


def test_names_by_time_reach_the_corrected_error_of_the_recorded_session(log, imported, asked_error, tmp_path, answered):
    rows = {row["poke"]: row for row in answered("landmarks", imported)["pokes"]}
    times = [f'{rows[poke]["start_s"] - 0.3},{rows[poke]["end_s"] + 0.3},"{name}"' for poke, name in log.names.items()]
    (tmp_path / "times.csv").write_text("\n".join(["start_s, end_s, landmark", *times]) + "\n\n", encoding="utf-8")
    plain = answered("solve", imported, "--reference", log.folder / "truth.json")["methods"]
    assert asked_error["modules"] < 0.3 * plain["modules"]["error_mm"]["mean"]
    folder = shutil.copytree(imported, tmp_path / "s")
    said = answered("landmarks", folder, "--csv", tmp_path / "times.csv")
    assert {row["poke"]: row["landmark"] for row in said["pokes"] if row["landmark"] is not None} == log.names
    assert len(said["said"]) == len(log.names) + 1
    assert corrected_error(folder, log) == asked_error


def test_what_was_found_from_the_axes_is_right_and_enough(log, imported, asked_error, tmp_path, answered):
    folder = shutil.copytree(imported, tmp_path / "s")
    said = answered("landmarks", folder, "--find")
    named = {row["poke"]: row["landmark"] for row in said["pokes"] if row["landmark"] is not None}
    assert named.items() <= log.names.items()
    assert len(named) >= 0.8 * len(log.names)
    unsure = [line for line in said["said"] if "not sure" in line]
    assert len(unsure) == len(log.names) - len(named)
    assert corrected_error(folder, log)["modules"] < 1.5 * asked_error["modules"]


def test_what_the_last_call_wrote_is_taken_back_and_played_again_it_is_the_same(small, run, answered):
    folder = small
    before = load(folder).snapshot()
    answered("landmarks", folder, "--at", "1=head", "--at", "2=tail, left")
    answered("landmarks", folder, "--add", "bolt", "-1.5", "2", "3.25", "--at", "2=bolt", "--at", "1=")
    now = load(folder)
    times = [entry.at_s for entry in now.session.history.entries[-5:]]
    assert times[0] == times[1] < times[2] == times[3] == times[4] < time.time(), "each call has its time of day"
    assert now.session.snapshot().at_landmarks == {2: "bolt"}
    assert now.session.decisions.landmarks[-1].place == pytest.approx([-0.0015, 0.002, 0.00325])
    assert same_estimates(now.snapshot(), replay(folder).snapshot())
    assert replay(folder).session.snapshot().at_landmarks == {2: "bolt"}
    assert len(answered("landmarks", folder, "--undo")["said"]) == 3
    assert load(folder).session.snapshot().at_landmarks == {1: "head", 2: "tail, left"}
    assert len(answered("landmarks", folder, "--undo")["said"]) == 2
    assert same_estimates(load(folder).snapshot(), before)
    assert load(folder).session.snapshot().at_landmarks == {}
    assert run("landmarks", folder, "--undo")[0] == 2
    assert load(folder).session.excluded == (), "no poke was taken out instead"


SCENE_LANDMARKS = (
    '[[landmarks]]\nname = "head"\nplace = [0, 0, 0.1]\n[[landmarks]]\nname = "tail, left"\nplace = [0.05, 0, 0.1]\n'
)


@pytest.fixture
def small(small_once, tmp_path):
    return shutil.copytree(small_once, tmp_path / "s")


@pytest.fixture(scope="module")
def small_once(tmp_path_factory):
    """Two pokes that no taxel answered, one on the skin, one more that none answered, and one that slid."""
    made = tmp_path_factory.mktemp("small")
    scene = write_scene(made / "source")
    scene.path.write_text(scene.path.read_text(encoding="utf-8") + SCENE_LANDMARKS, encoding="utf-8")
    scene = load_scene(scene.path)
    script = Script(scene).quiet()
    head, tail = np.array([0.0, 0.0, 0.1]), np.array([0.05, 0.0, 0.1])
    for point, answers, slide in ((head, {}, 0), (tail, {}, 0), (head, {3: 80.0}, 0), (tail, {}, 0), (tail, {}, 0.05)):
        script.press(np.array([0.5, 1.0, -8.0]), point, answers, slide=np.array([slide, 0.0, 0.0])).quiet()
    recording(scene, made / "s", as_chunks(script.samples)).close()
    return made / "s"


def named(folder: Path) -> dict[int, str]:
    return dict(load(folder).session.snapshot().at_landmarks)


def test_an_order_is_of_all_pokes_that_no_taxel_answered_or_of_those_before_the_first_that_one_did(small, run):
    assert run("landmarks", small, "--order", "head;tail, left")[0] == 0
    assert named(small) == {1: "head", 2: "tail, left"}
    assert run("landmarks", small, "--order", "-;head;tail, left")[0] == 0
    assert named(small) == {2: "head", 4: "tail, left"}
    code, out, _ = run("landmarks", small, "--order", "-;head;tail, left")
    assert (code, out.splitlines()[0]) == (0, approved("landmark.nothing_new"))


@pytest.mark.parametrize("rows", ["poke;landmark\n1;head\n2;tail, left\n", "\npoke\tlandmark\n1\thead\n2\ttail, left\n"])
def test_columns_of_a_file_are_parted_as_those_of_a_recording(small, tmp_path, rows, run):
    (tmp_path / "f.csv").write_text(rows, encoding="utf-8")
    assert run("landmarks", small, "--csv", tmp_path / "f.csv")[0] == 0
    assert named(small) == {1: "head", 2: "tail, left"}


def test_between_semicolons_a_comma_is_the_decimal_point(small, tmp_path, run, answered):
    row = answered("landmarks", small)["pokes"][1]
    times = [f"{time:.3f}".replace(".", ",") for time in (row["start_s"] - 0.1, row["end_s"] + 0.1)]
    (tmp_path / "f.csv").write_text(f"start_s;end_s;landmark\n{';'.join(times)};tail, left\n", encoding="utf-8")
    assert run("landmarks", small, "--csv", tmp_path / "f.csv")[0] == 0
    assert named(small) == {2: "tail, left"}


def test_how_many_pokes_are_missing_for_a_correction_is_said(log, imported, tmp_path, run):
    folder, pairs = shutil.copytree(imported, tmp_path / "s"), list(log.names.items())
    of = {name: [poke for poke, there in pairs if there == name] for name in dict.fromkeys(log.names.values())}
    first, *rest = of

    def said(*at):
        words = [word for each in at for word in ("--at", each)]
        return run("landmarks", folder, *words)[1].splitlines()[-1]

    assert said(f"{of[first][0]}={first}") == approved(
        "landmark.missing_pokes", pokes="1 poke", missing="5 more, 3 of them at others"
    )
    more = [f"{of[name][0]}={name}" for name in rest[:2]]
    assert said(*more) == approved("landmark.missing_pokes", pokes="3 pokes", missing="3 more, 1 of them at another")
    more = [f"{of[name][1]}={name}" for name in (first, *rest[:2])]
    assert said(*more) == approved("landmark.missing_pokes", pokes="6 pokes", missing="1 more, 1 of them at another")
    assert run("solve", folder, "--correct")[0] == 2
    assert said(f"{of[rest[2]][0]}={rest[2]}") == approved("landmark.enough_for_correction", pokes=7, session=folder)


def test_a_poke_that_a_taxel_answered_is_not_found_from_its_axis_and_can_be_said(small, run):
    assert run("landmarks", small, "--find")[0] == 0
    assert named(small) == {1: "head", 2: "tail, left", 4: "tail, left"}
    assert run("landmarks", small, "--at", "3=head")[0] == 0
    assert named(small)[3] == "head"


def test_without_landmarks_in_the_scene_one_can_be_added_first(tmp_path, run):
    scene, folder = write_scene(tmp_path / "source"), tmp_path / "s"
    script = Script(scene).quiet().press(np.array([0.0, 0.0, -8.0]), np.zeros(3), {}).quiet()
    recording(scene, folder, as_chunks(script.samples)).close()
    assert approved("landmark.none_in_scene") in run("landmarks", folder)[1]
    code, out, _ = run("landmarks", folder, "--find")
    assert (code, out.splitlines()[0]) == (0, approved("landmark.none_in_scene"))
    assert named(folder) == {}
    code, _, err = run("landmarks", folder, "--at", "1=nose")
    assert (code, approved("landmark.none_known", name="nose") in err) == (2, True)
    assert run("landmarks", folder, "--add", "bolt", 0, 0, 100, "--find")[0] == 0
    assert named(folder) == {1: "bolt"}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--at", "12"], approved("landmark.no_pair", where="--at 12")),
        (["--at", "x=head"], approved("landmark.no_pair", where="--at x=head")),
        (["--at", "1=nose"], approved("landmark.unknown", name="nose", known="'head', 'tail, left'")),
        (["--at", "9=head"], approved("landmark.no_axis", poke=9)),
        (["--at", "5=head"], approved("landmark.no_axis", poke=5)),
        (
            ["--at", "1=head", "--at", "1=tail, left"],
            approved("landmark.said_twice", poke=1, first="head", second="tail, left"),
        ),
        (["--order", "head"], approved("landmark.order_count", names="1 landmark", pokes="3 pokes", before=2)),
        (["--csv", "missing.csv"], "missing.csv"),
        (["--undo"], approved("landmark.nothing_taken_back", last="poke 3")),
        (["--undo", "--find"], approved("landmark.undo_alone", other="--find")),
        (["--add", "head", "1", "2", "3"], approved("landmark.name_taken", name="head")),
        (["--add", "far", "1", "2", "1e9"], "metres up to 10"),
        (["--add", "a", "1", "2", "3", "--add", "b", "1", "2", "3"], approved("landmark.add_once")),
        (["--add", "a", "1", "2"], "--add"),
    ],
)
def test_each_refusal_is_one_sentence_and_writes_nothing(small, words, sentence, run):
    files = sorted(small.iterdir())
    code, out, err = run("landmarks", small, *words)
    assert (code, out) == (2, "")
    assert sentence in err
    assert len(err.strip().splitlines()) == 1
    assert sorted(small.iterdir()) == files
    assert named(small) == {}


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "begins with nothing"),
        ("landmark,poke\nhead,1\n", "begins with landmark,poke"),
        ("poke,landmark\n1,tail, left\n", approved("landmark.row_fields", line=2, fields=3, expected=2, mark="comma")),
        ("poke;landmark\n1;tail;left\n", approved("landmark.row_fields", line=2, fields=3, expected=2, mark="semicolon")),
        ("poke;landmark\n1;nose\n", approved("landmark.unknown", name="nose", known="'head', 'tail, left'")),
        ("poke,landmark\nfirst,head\n", approved("landmark.no_pair", where="line 2")),
        ("start_s,end_s,landmark\n0,soon,head\n", approved("landmark.no_times", start=0, end="soon")),
        ("start_s,end_s,landmark\n100,200,head\n", approved("landmark.no_poke_then", start=100, end=200)),
        ("start_s,end_s,landmark\n0,3,head\n1,5,\"tail, left\"\n", "said to be at"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_fit_is_refused(small, tmp_path, text, sentence, run):
    (tmp_path / "f.csv").write_text(text, encoding="utf-8")
    code, _, err = run("landmarks", small, "--csv", tmp_path / "f.csv")
    assert code == 2
    assert sentence in err
    assert named(small) == {}


HOLD = """
import sys
import time
from pathlib import Path
from skincal.journal.lock import SessionLock
lock = SessionLock(Path(sys.argv[1]))
print(1, flush=True)
sys.stdin.read()
"""


def test_a_session_that_is_being_recorded_can_be_listed_and_not_written(small, run):
    with subprocess.Popen(
        [sys.executable, "-c", HOLD, str(small)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout.readline() == "1\n"
        for words in (["--at", "1=head"], ["--find"], ["--undo"]):
            code, _, err = run("landmarks", small, *words)
            assert code == 2
            assert approved("landmark.in_use") in err
        assert run("landmarks", small)[0] == 0
        holder.stdin.close()
    assert named(small) == {}
    assert run("landmarks", small, "--at", "1=head")[0] == 0


def test_a_poke_that_was_undone_since_is_not_taken_back_in_place_of_a_landmark(small, run):
    """Undo of the last accepted poke, as in the window, comes after the landmark was named."""
    assert run("landmarks", small, "--at", "1=head")[0] == 0
    pipeline = resume(small)
    pipeline.act(Undo(), 1)
    pipeline.act(Undo(), 2)
    pipeline.close()
    assert named(small) == {}
    assert load(small).session.excluded == (3,)
    assert run("landmarks", small, "--undo")[0] == 2


def test_pokes_are_excluded_by_the_actions_of_the_window_and_the_estimates_follow(log, asked, tmp_path, run, answered):
    folder = shutil.copytree(asked, tmp_path / "s")
    before = load(folder).snapshot()
    early = [
        record.outcome.poke
        for record in before.pokes
        if record.outcome.poke <= 12 and (isinstance(record.outcome, Contact) or record.outcome.poke in log.names)
    ]
    said = answered("pokes", folder, "--exclude", "1-12")
    assert [row["poke"] for row in said["pokes"] if row["excluded"]] == early
    now = load(folder).snapshot()
    clicked_in = shutil.copytree(asked, tmp_path / "window")
    clicked = resume(clicked_in)
    for poke in early:
        clicked.act(AtLandmark(poke, "") if poke in log.names else Exclude(poke), 1)
    clicked.close()
    written = [
        [item.action for item in SessionLog(each).items() if isinstance(item, TimedAction)] for each in (folder, clicked_in)
    ]
    assert written[0] == written[1]
    assert same_estimates(now, clicked.snapshot())
    assert not same_estimates(now, before)
    assert same_estimates(now, replay(folder).snapshot())
    assert not set(early) & set(now.counting_landmark_pokes.number.tolist())
    some = next(record.outcome.poke for record in before.pokes if isinstance(record.outcome, Contact))
    assert f"poke {some}, " in run("pokes", folder)[1]
    assert "; excluded" in run("pokes", folder)[1]
    assert f"used again: 1 poke, {some}" in run("pokes", folder, "--restore", some)[1]
    assert some not in load(folder).session.excluded
    answered("pokes", folder, "--undo")
    answered("pokes", folder, "--undo")
    assert same_estimates(load(folder).snapshot(), before)
    at = next(poke for poke in early if poke in log.names)
    answered("pokes", folder, "--exclude", at)
    assert at not in load(folder).snapshot().at_landmarks
    answered("pokes", folder, "--undo")
    assert load(folder).snapshot().at_landmarks == before.at_landmarks
    assert run("pokes", folder, "--exclude", "5000")[2].endswith(f"the session has the pokes 1 to {log.count}.\n")
    for words in (["--exclude", "x"], ["--exclude", "3-1"], ["--exclude", "1", "--restore", "1"], ["--undo", "--restore", "1"]):
        assert run("pokes", folder, *words)[0] == 2
