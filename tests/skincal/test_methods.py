"""Which method leads: that of the smallest predicted error, if it knows nearly every taxel that any one knows."""

from __future__ import annotations

import html
import json
import math

import numpy as np
import pytest

import skincal
from app.panels.inspect_panel import estimate_cells
from skincal.cli import main
from skincal.following.error_history import MAX, TAXELS, ErrorCourse
from skincal.mesh.load import _make_surface
from skincal.mesh.surface import Surface
from skincal.methods import leading_method
from skincal.model.scene import resource
from skincal.reporting.page import report_page
from skincal.taxels.result import Cause, Estimate, Method, State, StateReason
from skincal.taxels.shared_errors import max_known_error
from skincal.words.taxel_words import skin_error_words, taxel_error_words
from skincal.words.verdict_words import figures
from tests.approved import approved

SAMPLE = str(resource("sessions/sample"))


def estimates(method: Method, known: int, rms: float, count: int = 100) -> tuple[Estimate, ...]:
    at = [Estimate(channel, method, State.TOUCHED, 3, np.zeros(3), rms=rms) for channel in range(known)]
    return (
        *at,
        *(Estimate(channel, method, State.UNSEEN, 0, reason=StateReason(Cause.UNPOKED)) for channel in range(known, count)),
    )


@pytest.mark.parametrize(
    ("of", "leads"),
    [
        ([(Method.FREE, 100, 3.0), (Method.SURFACE, 100, 1.24), (Method.MODULES, 100, 0.79)], Method.MODULES),
        ([(Method.FREE, 90, 0.1), (Method.SURFACE, 100, 1.24), (Method.MODULES, 100, 1.3)], Method.SURFACE),
        ([(Method.FREE, 95, 0.1), (Method.SURFACE, 100, 1.24)], Method.FREE),
        ([(Method.FREE, 94, 0.1), (Method.SURFACE, 100, 1.24)], Method.SURFACE),
        ([(Method.FREE, 100, 1.0), (Method.SURFACE, 100, 1.0)], Method.FREE),
        ([(Method.FREE, 0, 1.0), (Method.SURFACE, 0, 1.0)], None),
        ([], None),
    ],
)
def test_the_smallest_predicted_error_leads_among_those_that_know_nearly_all(of, leads):
    assert leading_method({method: estimates(method, known, rms * 1e-3) for method, known, rms in of}) is leads


def test_solve_says_the_leading_method_first_and_keeps_the_order_of_its_json(capsys):
    assert main(["solve", SAMPLE]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.split()[0] in ("free", "surface", "modules")]
    assert [line.split()[0] for line in lines] == ["modules", "free", "surface"]
    assert [line.endswith(approved("method.leads")) for line in lines] == [True, False, False]
    assert main(["solve", SAMPLE, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert list(said["methods"]) == ["free", "surface", "modules"]
    assert said["leads"] == "modules"


def test_export_writes_the_leading_method_unless_it_is_named(tmp_path, capsys):
    for words, method in (((), "modules"), (("--method", "surface"), "surface")):
        out = ["--format", "icub", "--out", str(tmp_path / f"{method}.txt")]
        assert main(["export", SAMPLE, *out, *words, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["method"] == method
        assert main(["export", SAMPLE, *out, *words]) == 0
        assert capsys.readouterr().out.splitlines()[0].endswith(approved("method.leads")) is (not words)
    assert main(["export", "--help"]) == 0
    assert approved("method.leads_in_help") in " ".join(capsys.readouterr().out.replace("│", " ").split())


@pytest.mark.usefixtures("undrawn")
def test_window_commands_verdict_and_report_say_the_same_predicted_error(tmp_path, capsys):
    facts = skincal.Session.load(SAMPLE).facts()
    errors = [1e3 * each.rms for each in facts.estimates if each.rms is not None]
    said = approved("now.predicted", mean_mm=f"{np.mean(errors):.1f}", worst_mm=f"{max(errors):.1f}")
    assert skin_error_words(facts.estimates, math.inf) == said
    for words in ((), ("--format", "icub", "--out", str(tmp_path / "positions.txt"))):
        assert main(["export" if words else "solve", SAMPLE, *words]) == 0
        assert f"; {said};" in capsys.readouterr().out
    page = html.unescape(report_page(facts))
    (column,) = (text for name, text in figures(facts.verdict) if said.startswith(name.lower()))
    assert column in page
    assert column.startswith(said.removeprefix("expected error "))
    assert all(f">{1e3 * size:.2f}<" in page for size in (facts.methods[2].predicted.mean, facts.methods[2].predicted.worst))


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("size", [0.2, 0.003])
def test_an_error_that_is_large_for_the_part_is_not_known_yet_wherever_it_is_said(tmp_path, capsys, monkeypatch, size):
    monkeypatch.setattr(Surface, "size", size)
    _make_surface.cache_clear()  # a mesh that stays ready knows its size already
    facts = skincal.Session.load(SAMPLE).facts("free")
    every = [each for each in facts.estimates if each.rms is not None]
    errors = [each.rms for each in every if each.rms <= max_known_error(size)]
    counts = {"mean_mm": f"{1e3 * np.mean(errors):.1f}", "worst_mm": f"{1e3 * max(errors):.1f}"} if errors else {}
    unknown = len(every) - len(errors)
    said = approved("now.predicted_some", **counts, unknown=unknown) if errors else approved("now.predicted_unknown")
    assert (unknown > 0, bool(errors)) == (True, size == 0.2)
    assert skin_error_words(facts.estimates, size) == said
    for words in (["solve", SAMPLE], ["export", SAMPLE, "--method", "free", "--format", "icub", "--out", tmp_path / "at.txt"]):
        assert main([str(word) for word in words]) == 0
        assert f"; {said};" in capsys.readouterr().out
    column = said.removeprefix("expected error ")
    assert f"# predicted error: {column}" in (tmp_path / "at.txt").read_text(encoding="utf-8")
    assert any(text.startswith(column) for _, text in figures(facts.verdict))
    page = html.unescape(report_page(facts))
    assert column in page
    assert ">not known yet<" in page
    assert main(["solve", SAMPLE, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["methods"]["free"]
    assert found["taxels_not_known_yet"] == unknown
    assert found["predicted_error_mm"]["mean"] == (pytest.approx(1e3 * np.mean(errors)) if errors else None)
    # The Errors tab shows the course of those that are known.
    series = course_of(facts).spreads[Method.FREE][-1, 0]
    assert series[TAXELS] == len(errors)
    assert series[MAX] == pytest.approx(max(errors)) if errors else np.isnan(series[MAX])
    worst = max(every, key=lambda each: each.rms)
    assert taxel_error_words(worst, size) == "not known yet"
    assert estimate_cells(worst, size)[1] == "not known yet"


def course_of(facts):
    course = ErrorCourse(facts.results.part.scene, facts.results.part.surface, None)
    course.update(facts.results.snapshot)
    return course.series()
