"""What `skincal export` says and writes of what was checked, and that window, file, report and command agree on *enough*."""

import json
import shutil
from collections.abc import Iterable
from pathlib import Path

import pytest

import skincal
from skincal.cli import main
from skincal.following.results import verdicts_of
from skincal.following.session_guide import SessionGuide
from skincal.journal.writer import create_session
from skincal.model.actions import Action, AddLandmark, AskPoke, SetPose, SkipLandmark, SkipPoke
from skincal.model.scene import resource
from skincal.part.part import lay_part
from skincal.session.pipeline import Pipeline
from skincal.session.replay import replay, resume
from skincal.taxels.result import Method
from skincal.words.verdict_words import verdict_sentence
from tests.approved import approved
from tests.skincal.poke_script import LINKS, write_scene

SAMPLE = str(resource("sessions/sample"))


@pytest.mark.parametrize("method", ["surface", "modules"])
def test_export_says_what_the_session_has_come_to_as_the_file_does(tmp_path, capsys, method):
    asked = ["export", SAMPLE, "--format", "json", "--out", str(tmp_path / "c.json"), "--method", method]
    assert main([*asked, "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict.startswith("Not finished: ")
    assert verdict == json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["verdicts"][method]
    assert main(asked) == 0
    assert f"{verdict}." in capsys.readouterr().out.splitlines()


def test_export_says_how_wrong_the_rig_may_be_as_solve_and_the_file_do(tmp_path, capsys):
    asked = ["export", SAMPLE, "--format", "json", "--out", str(tmp_path / "c.json")]
    assert main(["solve", SAMPLE, "--json"]) == 0
    solved = json.loads(capsys.readouterr().out)
    assert main([*asked, "--json"]) == 0
    exported = json.loads(capsys.readouterr().out)
    assert exported["unchecked_rig_mm"] == solved["unchecked_rig_mm"] > 1.0
    assert exported["leads"] == solved["leads"] == exported["method"]
    assert main([*asked, "--method", "free", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["leads"] == solved["leads"], "also where another one is written"
    own = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["predicted_errors"]
    assert set(own) == {"free", "surface", "modules"}
    assert own[solved["leads"]]["unchecked_rig_m"] * 1e3 == solved["unchecked_rig_mm"]
    there = solved["methods"][solved["leads"]]["predicted_error_mm"]
    assert {name: own[solved["leads"]][f"{name}_m"] * 1e3 for name in there} == pytest.approx(there)
    assert main(asked) == 0
    said = approved("rig.unchecked", off_mm=f"{solved['unchecked_rig_mm']:.1f}")
    assert said in capsys.readouterr().out.splitlines()


def followed(folder: Path, actions: Iterable[Action] | None = None) -> tuple[bool, str, list[Action]]:
    """Go on with a copy of the sample as the window does; return whether its line says enough, its verdict, what was skipped.

    Parameters
    ----------
    actions : what is skipped; None to skip all that is asked for until it is enough
    """
    shutil.copytree(SAMPLE, folder)
    pipeline, skipped = resume(folder), []
    session = pipeline.session
    for name, place in (("a", (0.0, 0.05, 0.05)), ("b", (0.0, 0.1, 0.05)), ("c", (0.0, 0.15, 0.05))):
        pipeline.act(AddLandmark(name, *place), 0)
    pipeline.act(SetPose("6"), 0)
    guide = SessionGuide(lay_part(session.scene, session.surface, ()))

    def look():
        snapshot = session.snapshot()
        guidance = guide.next_target(snapshot, pipeline.poses.current, Method.MODULES, 100.0)
        assert guidance is not None
        return guidance

    for now, action in enumerate(() if actions is None else actions):
        pipeline.act(action, now)
    line = look()
    while actions is None and not line.enough:
        skipped.append(guide.skip_landmarks() if line.landmark else guide.skip())
        pipeline.act(skipped[-1], len(skipped))
        line = look()
    verdict = guide.verdict(session.snapshot(), Method.MODULES)
    assert verdict.enough is line.enough
    by_file = verdicts_of(lay_part(session.scene, session.surface, ()), session.snapshot(), (Method.MODULES,), None)
    assert verdict_sentence(by_file[Method.MODULES]) == verdict_sentence(verdict)
    pipeline.close()
    return line.enough, verdict_sentence(verdict), skipped


def said_of(folder: Path, capsys) -> set[str]:
    """Return what the report, the command and its file say of a session."""
    capsys.readouterr()
    out = folder.parent / "c.json"
    command = ["export", str(folder), "--format", "json", "--out", str(out), "--method", "modules", "--json"]
    assert main(command) == 0
    said = {json.loads(capsys.readouterr().out)["verdict"], json.loads(out.read_text(encoding="utf-8"))["verdicts"]["modules"]}
    return {f"{each}." for each in said} | {verdict_sentence(skincal.Session.load(folder).facts("modules").verdict)}


@pytest.fixture(scope="module")
def skipping(tmp_path_factory):
    """The sample with all skipped that is asked for: where it lies, and what `followed` says of it."""
    folder = tmp_path_factory.mktemp("skipped") / "s"
    return folder, *followed(folder)


def test_taxels_and_landmarks_that_were_skipped_are_enough_wherever_it_is_said(skipping, capsys):
    folder, enough, words, skipped = skipping
    assert enough
    assert words.startswith("78 of 84 taxels are finished")
    assert any(isinstance(each, SkipPoke) for each in skipped)
    assert any(isinstance(each, SkipLandmark) for each in skipped)
    assert said_of(folder, capsys) == {words}


def test_landmarks_that_are_still_asked_for_are_not_enough_wherever_it_is_said(skipping, tmp_path, capsys):
    taxels = [each for each in skipping[-1] if isinstance(each, SkipPoke)]
    enough, words, _ = followed(tmp_path / "s", taxels)
    assert not enough
    assert words.startswith(approved("verdict.not_enough", done=78, count=84))
    assert said_of(tmp_path / "s", capsys) == {words}


@pytest.mark.parametrize("again", [replay, resume])
def test_what_was_skipped_and_asked_for_is_kept(tmp_path, again):
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    asked = AskPoke(3, (0.1, 0.2, 0.3), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    skips = SkipPoke("free", 3, asked.place, asked.push), SkipLandmark("", "1", tuple(map(float, range(16))))
    for now, action in enumerate((asked, *skips)):
        pipeline.act(action, now)
    pipeline.close()
    other = again(tmp_path / "s")
    assert other.snapshot().decisions.skips == skips
    assert other.session.asked == asked
    other.close()
