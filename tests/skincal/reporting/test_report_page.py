"""A session's report: its numbers are the core's, its sections are all there, and names from strangers stay names."""

from __future__ import annotations

import json
import re
import shutil
from base64 import b64decode
from collections import Counter
from copy import copy
from dataclasses import astuple, replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import skincal
from skincal.cli import main
from skincal.files.reference import error_summary, read_reference
from skincal.following.error_history import MEAN, TAXELS
from skincal.following.results import use_offered
from skincal.model.actions import AtLandmark
from skincal.model.readings import TEMPERATURE_NAME, SideReading
from skincal.model.scene import Landmark, load_scene, resource
from skincal.reporting import session_facts
from skincal.reporting.drawings import side_frames
from skincal.reporting.page import DASH, ReportTable, report_page
from skincal.reporting.session_facts import SessionFacts, errors_of
from skincal.rig.correction_fit import LandmarkAgreement, correct_rig
from skincal.session.corrections import offered
from skincal.session.replay import load, resume
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method
from skincal.words.mistake_words import frame_sentence
from skincal.words.rig_words import correction_sentence
from skincal.words.taxel_words import state_sentence
from skincal.words.verdict_words import agreement_words, check_words, figures, verdict_sentence
from tests.approved import approved
from tests.build import landmark_outcome, noted_session
from tests.skincal.sim_support import make_rig

SAMPLE = resource("sessions/sample")
SECTIONS = (
    "Verdict and evidence", "The part", "Map", "Errors", "Rig and landmarks", "Pokes", "The exported file", "Devices",
    "Settings", "Taxels", "Versions",
)  # fmt: skip
HOSTILE = "<script>alert(1)</script><img src=http://evil.example/x onerror=alert(2)>\"' & {{ 7 * 7 }} $x$ \u202e"


class Page(HTMLParser):
    """The elements of a page, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.attributes: list[tuple[str, str]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags[tag] += 1
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def facts() -> SessionFacts:
    return skincal.Session.load(SAMPLE).facts()


def other_results(facts, **changes):
    """The results of a session with some of them changed."""
    results = copy(facts.results)
    vars(results).update(changes)
    return results


@pytest.fixture(scope="module")
def page_text(facts) -> str:
    return report_page(facts)


@pytest.fixture(scope="module")
def page(page_text) -> Page:
    return Page(page_text)


def test_the_numbers_are_those_of_the_core(facts, page):
    snapshot, truth = load(SAMPLE).snapshot(), read_reference(SAMPLE / "truth.json")
    for each in facts.methods:
        assert each.error == error_summary(snapshot.estimates[each.method], truth)
        assert f"{each.error.mean * 1e3:.2f}" in page.text
    assert facts.method is Method.MODULES
    lead = facts.methods[-1].error
    assert np.mean(list(facts.errors.values())) == pytest.approx(lead.mean, rel=1e-12)
    assert (facts.module_spreads[:, TAXELS] @ facts.module_spreads[:, MEAN]) / 84 == pytest.approx(lead.mean, rel=1e-12)
    # The course ends where the session stands.
    assert facts.series.spreads[Method.MODULES][-1, 0, MEAN] == pytest.approx(lead.mean, rel=1e-12)
    assert facts.series.missing == 0
    assert all(words in page.text for _, words in figures(facts.verdict))
    assert verdict_sentence(facts.verdict) in page.text
    assert all(each.solve_s > 0 for each in facts.methods)


def test_every_section_is_there_with_its_pictures_and_every_taxel(facts, page):
    assert [title for title in SECTIONS if title not in page.text] == []
    assert page.tags["h2"] == len(SECTIONS)
    assert page.tags["img"] == 3
    for estimate in facts.estimates:
        assert f"{estimate.position[0] * 1e3:.2f}" in page.text
    assert f"{len(facts.estimates)} taxels with a position" in page.text
    assert "without a position" not in page.text
    for link in facts.results.pipeline.links:
        assert link.name in page.text
    assert "force_min" in page.text
    assert facts.versions["numpy"] in page.text
    assert "SIMULATED" in page.text


@pytest.mark.usefixtures("undrawn")
def test_only_a_verdict_is_coloured_and_no_name_that_reads_like_one(facts, page):
    marks, misses = (Landmark("agrees", np.zeros(3), None),), {"agrees": (0.001,)}
    snapshot = facts.results.snapshot
    named_snapshot = replace(snapshot, decisions=replace(snapshot.decisions, landmarks=marks))
    named = replace(facts, results=other_results(facts, snapshot=named_snapshot), misses=misses)
    coloured = [each.attributes.count(("class", "agrees")) for each in (page, Page(report_page(named)))]
    assert coloured[0] == coloured[1] > 0


def test_a_method_is_timed_with_the_errors_that_a_correction_shares(imported, monkeypatch):
    pipeline, seen = load(imported[1]), []
    use_offered(pipeline.session)
    monkeypatch.setattr(session_facts, "estimate_taxels", lambda *_, shared, **__: seen.append(shared))
    snapshot = pipeline.snapshot()
    for method in pipeline.session.methods:
        session_facts._method_facts(pipeline.session, snapshot, method, None)
    assert set(seen) == {pipeline.session.shared_errors} != {None}


def test_a_check_stands_once_and_the_closing_check_is_one_of_them(facts, page):
    closing = next(words for name, words in figures(facts.verdict) if name == "Final check")
    for words in (check_words(facts.verdict), agreement_words(facts.verdict.landmarks, has_arm=True), closing):
        assert page.text.count(words) == 1
    assert "Final check" in page.text


def test_modules_stand_in_the_order_of_their_numbers(page_text):
    rows = re.findall(r"<tr><td>(\d+)</td><td>12 of 12</td>", page_text)
    assert len(rows) == 7
    assert rows == sorted(rows, key=int)


def test_columns_of_numbers_stand_at_their_right():
    table = ReportTable(
        ("Module", "Taxels", "x, mm", "Beside"), [("17", "12 of 12", "-28.18", DASH), ("9", "3 of 12", DASH, DASH)]
    )
    assert table.numeric == (False, False, True, False)


@pytest.mark.usefixtures("undrawn")
def test_a_table_of_many_rows_is_looked_through_once(facts, monkeypatch):
    """A whole body has 4,200 of them: looking through all for each cell takes hours."""
    looked, numeric = [], ReportTable.numeric.fget
    monkeypatch.setattr(ReportTable, "numeric", property(lambda table: looked.append(table) or numeric(table)))
    assert report_page(facts).count("<table") == len(looked)


def test_what_is_wider_than_a_small_screen_moves_by_itself(page_text):
    assert page_text.count("<table") == page_text.count('<div class="wide">\n  <table')
    assert page_text.count("<img") == page_text.count('<div class="wide"><img')


@pytest.mark.usefixtures("undrawn")
def test_what_a_device_measures_beside_its_readings_stands_with_it(facts):
    first, *others = facts.results.pipeline.totals().links
    warm = replace(first, beside={TEMPERATURE_NAME: SideReading(30.5, 33.25, 31.0)})
    totals = replace(facts.results.pipeline.totals(), links=(warm, *others))
    pipeline = SimpleNamespace(links=facts.results.pipeline.links, totals=lambda: totals)
    text = Page(report_page(replace(facts, results=other_results(facts, pipeline=pipeline)))).text
    assert text.count("temperature 31.0 degC (30.5 to 33.2)") == 1


@pytest.mark.usefixtures("undrawn")
def test_the_sentences_on_a_tool_stand_with_the_rig(facts):
    said = ("Tip: its own place. The tip is not used.", "Part: its pose is known.")
    text = Page(report_page(replace(facts, results=other_results(facts, tool=said)))).text
    rig = text.partition("Rig and landmarks")[2].partition("Scene and pokes")[0]
    assert all(sentence in rig for sentence in said)


@pytest.mark.usefixtures("undrawn")
def test_the_settings_of_a_rig_with_a_tool_name_no_arm(facts, page):
    tool = load_scene(resource("scenes/cobot-forearm/scene.toml")).tool
    scene = replace(facts.results.part.scene, arm=None, tool=tool)
    results = other_results(facts, part=replace(facts.results.part, scene=scene))
    text = Page(report_page(replace(facts, results=results))).text
    assert "streamed poses, sensor on the tool" in text
    assert "Arm poses" not in text
    assert "Arm poses" in page.text


@pytest.mark.usefixtures("undrawn")
def test_the_report_of_a_rig_without_a_sensor_has_no_row_on_its_frame(facts):
    tool = replace(load_scene(resource("scenes/cobot-forearm/scene.toml")).tool, has_sensor=False)
    scene = replace(facts.results.part.scene, arm=None, tool=tool)
    results = other_results(facts, part=replace(facts.results.part, scene=scene), _rig_diagnosis=(None, None))
    assert "Sensor's frame" not in Page(report_page(replace(facts, results=results))).text


def test_the_page_needs_no_other_file_and_prints(page_text):
    sources = re.findall(r'<img src="([^"]*)"', page_text)
    kinds = [source.partition(";")[0] for source in sources]
    assert kinds == ["data:image/png", "data:image/svg+xml", "data:image/svg+xml"]
    pictures = [b64decode(source.partition(",")[2]) for source in sources]
    assert pictures[0].startswith(b"\x89PNG")
    assert all(b"<script" not in picture for picture in pictures)
    rest = re.sub(r'src="data:[^"]*"', "", page_text)
    assert not re.search(r"https?:|//|url\(|@import|<link|<script|<iframe", rest)
    assert "@page" in rest
    assert "default-src 'none'" in rest


def test_names_from_strangers_stay_names(facts, page):
    scene = replace(facts.results.part.scene, name=HOSTILE, link=HOSTILE, path=Path(HOSTILE.replace("/", "_")))
    landmark = Landmark(HOSTILE, np.zeros(3), None)
    snapshot = facts.results.snapshot
    hostile = replace(
        facts,
        name=HOSTILE,
        results=other_results(
            facts,
            part=replace(facts.results.part, scene=scene, findings=(HOSTILE,)),
            snapshot=replace(snapshot, dead={204: HOSTILE}, decisions=replace(snapshot.decisions, landmarks=(landmark,))),
            pipeline=SimpleNamespace(links=(LinkSpec(HOSTILE, HOSTILE, (), HOSTILE),), totals=facts.results.pipeline.totals),
        ),
        misses={HOSTILE: (0.001,)},
        lint=(HOSTILE,),
        versions={"skincal": HOSTILE},
    )
    text = report_page(hostile)
    found = Page(text)
    # No element and no attribute that an honest page has not.
    assert found.tags.keys() == page.tags.keys()
    assert {name for name, _ in found.attributes} == {name for name, _ in page.attributes}
    assert all(value.startswith("data:image/") for name, value in found.attributes if name == "src")
    assert found.tags["img"] == 3
    # A mark that turns the order of letters is taken out.
    assert found.text.count(HOSTILE.replace("\u202e", "\ufffd")) >= 10
    assert "\u202e" not in text
    assert "49" not in re.findall(r"alert\(2\)&gt;.{0,40}", text)[0]


@pytest.mark.usefixtures("undrawn")
def test_without_truth_the_error_is_the_predicted_one(facts):
    told = report_page(replace(facts, truth=None, methods=tuple(replace(each, error=None) for each in facts.methods)))
    assert "SIMULATED" not in told
    assert "Error against" not in told
    assert approved("report.no_truth") in told


def test_the_front_is_where_the_skin_looks_and_each_view_is_upright(facts):
    frames = side_frames(facts)
    normals = np.array([estimate.normal for estimate in facts.estimates])
    for frame in frames:
        assert np.allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(frame) == pytest.approx(1.0)
        assert np.allclose(frame[1], frames[0][1])
    seen = [int((normals @ frame[2] > 0).sum()) for frame in frames]
    assert seen[0] == max(seen)
    assert seen[2] == min(seen)
    # Who stands at the right of the front sees what lay at its right edge in the middle.
    assert np.allclose(frames[1][2], frames[0][0])


@pytest.mark.parametrize("pokes", [1, 40])
def test_a_part_without_mesh_arm_and_landmarks_has_a_report_too(tmp_path, rng, pokes):
    rig, session, out = make_rig(RigErrors.noise(), name="flat-patch"), tmp_path / "patch", tmp_path / "report.html"
    contacts = simulate_contacts(rig, unguided(rig, 1, rng).subset(slice(0, pokes)), rng)
    noted_session(session, rig.scene, None, contacts).close()
    verdict = skincal.Session.load(session).report(out)
    text = out.read_text(encoding="utf-8")
    found = Page(text)
    assert verdict in found.text
    assert [title for title in SECTIONS if title not in found.text] == []
    assert not re.search(r"\b(nan|inf)\b", found.text.lower())
    assert approved("report.no_landmarks") in found.text


@pytest.mark.usefixtures("undrawn")
def test_taxels_without_a_place_are_told_by_their_reason(facts):
    free = facts.results.snapshot.estimates[Method.FREE]
    lost = [estimate for estimate in free if estimate.position is None]
    found = Page(
        report_page(replace(facts, method=Method.FREE, errors=errors_of(free, facts.truth, facts.results.snapshot.part_size)))
    ).text
    assert f"{len(lost)} taxels without a position" in found
    for estimate in lost:
        assert f"{estimate.state.value}: {state_sentence(estimate.reason)}" in found
        assert str(estimate.channel) in found


@pytest.fixture(scope="module")
def imported(tmp_path_factory) -> tuple[int, Path]:
    """A session of a rig with the paper's errors, and how many pokes it has at landmarks."""
    rig, rng = make_rig(RigErrors.paper(), 1), np.random.default_rng(8)
    contacts = simulate_contacts(rig, unguided(rig, 1, rng), rng)
    landmarks = poke_landmarks(rig, rig.scene.landmarks, 3, rng, 5001)
    folder = tmp_path_factory.mktemp("imported") / "session"
    pipeline = noted_session(folder, rig.scene, rig.surface, [*contacts, *map(landmark_outcome, landmarks)])
    for poke in landmarks:
        number = int(poke.number)
        pipeline.act(AtLandmark(number, str(poke.name)), 2 + number)
    pipeline.close()
    return len(landmarks), folder


def test_the_report_of_an_imported_log_is_under_the_correction_where_that_is_asked_for(imported, tmp_path, capsys):
    (_, session), out = imported, tmp_path / "report.html"
    capsys.readouterr()
    assert main(["solve", str(session), "--correct", "--json"]) == 0
    solved = json.loads(capsys.readouterr().out)
    assert main(["report", str(session), "--correct", "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == f"{solved['verdict']}."
    facts, found = skincal.Session.load(session, correct=True).facts(), Page(out.read_text(encoding="utf-8")).text
    assert facts.method.value == solved["leads"]
    for each in facts.methods:
        own = solved["methods"][each.method.value]
        assert [1e3 * length for length in astuple(each.predicted)[:4]] == list(own["predicted_error_mm"].values())
        assert each.spacing == own["spacing_ratio"]
        assert f"{own['predicted_error_mm']['mean']:.2f}" in found
    (used,) = facts.results.snapshot.decisions.corrections.values()
    assert correction_sentence(used, has_arm=True) in found
    assert not skincal.Session.load(session).results.snapshot.decisions.corrections, "the recording is as it was"
    assert main(["report", str(SAMPLE), "--correct", "--out", str(tmp_path / "none.html")]) == 2
    assert approved("landmark.needs_landmarks_to_correct") in capsys.readouterr().err
    assert not (tmp_path / "none.html").exists()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("has_arm", [True, False])
def test_the_report_of_a_part_without_joints_speaks_of_the_sensor_alone(facts, has_arm):
    agreement = LandmarkAgreement(21, 4.2, corrected=False)
    verdict = replace(facts.verdict, landmarks=agreement, has_arm=has_arm)
    shown = replace(facts, results=other_results(facts, _verdicts={facts.method: verdict}))
    text = Page(report_page(shown)).text
    assert ("sensor and arm not corrected" in text) is has_arm
    assert "not corrected" in text


@pytest.mark.usefixtures("undrawn")
def test_landmarks_and_a_correction_in_use_are_told(imported, tmp_path):
    count, session = imported[0], shutil.copytree(imported[1], tmp_path / "session")
    pipeline = resume(session)
    answer = correct_rig(pipeline.session.rig_request())
    action = offered(None, answer, count, {})
    pipeline.act(action, 1000)
    pipeline.close()
    facts = skincal.Session.load(session).facts()
    found = Page(report_page(facts)).text
    assert sum(map(len, facts.misses.values())) == count
    for name, misses in facts.misses.items():
        assert name in found
        assert ", ".join(f"{miss * 1e3:.1f}" for miss in misses) in found
    (used,) = facts.results.snapshot.decisions.corrections.values()
    assert correction_sentence(used, has_arm=True) in found
    assert agreement_words(facts.verdict.landmarks, has_arm=True) in found
    assert frame_sentence(facts.results.frame, has_arm=True) in found
    # Pokes at landmarks are no rejected pokes, though no taxel answered.
    assert f"{count} at landmarks" in found


def test_the_command_writes_the_report_and_says_in_a_sentence_what_is_wrong(tmp_path, capsys):
    out = tmp_path / "report.html"
    assert main(["report", str(SAMPLE), "--out", str(out), "--method", "surface"]) == 0
    said = capsys.readouterr().out
    assert f"wrote {out}" in said
    assert said.splitlines()[0] in Page(out.read_text(encoding="utf-8")).text
    assert "surface method" in out.read_text(encoding="utf-8")
    assert main(["report", str(tmp_path), "--out", str(out)]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert main(["report", str(SAMPLE), "--out", str(tmp_path)]) == 2
    assert main(["report", str(SAMPLE), "--out", str(tmp_path / "report.txt")]) == 2
    assert not (tmp_path / "report.txt").exists()
