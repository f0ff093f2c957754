"""The study of unmodelled errors: its numbers, its rows and its limits."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from skincal.guide.verdict import Check, is_believed
from skincal.rig.correction_fit import NOISE_FACTORS, LandmarkAgreement
from skincal.studies import unmodelled as study
from skincal.studies.error_numbers import error_numbers, in_known_directions, inside_95_ellipsoid
from skincal.studies.harness import check_limits
from skincal.studies.unmodelled import (
    _row,
    believed_shares,
    off_by_factor,
    run_session,
    sheet_limits,
    sheet_lines,
    sheet_row,
    unmodelled,
    unmodelled_limits,
    unmodelled_lines,
)
from skincal.taxels.result import Estimate, Method, State
from tests.skincal.studies.studies_support import small

NAMES = {method.value for method in Method}
GOOD = {
    "mean": 1.0, "inside": 0.7, "predicted": 3.0, "true_rms": 1.0, "true_along": 1.0, "missing": 0, "skin_agrees": True,
    "ratio": 1.0, "believed": True, "used": True, "noisier": 1.0, "wrongly_believed": True,
}  # fmt: skip


@cache
def session(case, seed=1):
    return run_session(case, seed)


def rows_of(*sessions):
    """Row of sessions in which every method and number of landmark pokes has the same numbers."""
    found = [{count: dict.fromkeys(NAMES, each) for count in (0, 21, 70)} for each in sessions]
    return _row("nothing", found, 1)


def test_the_95_percent_ellipsoid_has_full_flat_and_linear_forms():
    full, flat, line = np.diag([1.0, 4.0, 9.0]), np.diag([1.0, 4.0, 0.0]), np.diag([4.0, 0.0, 0.0])
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(3), full, 4000)
    assert np.mean([inside_95_ellipsoid(off, full) for off in drawn]) == pytest.approx(0.95, abs=0.012)
    assert np.mean([inside_95_ellipsoid(off * [1, 1, 0], flat) for off in drawn]) == pytest.approx(0.95, abs=0.012)
    for off, covariance, expected in ((2.5, flat, False), (2.5, full, True), (3.9, line, True), (4.0, line, False)):
        assert inside_95_ellipsoid(np.array([off, 0.0, 0.0]), covariance) is expected
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    parts, variances = in_known_directions(turn @ [1.0, 2.0, 50.0], turn @ np.diag([1.0, 4.0, 1e-9]) @ turn.T)
    assert sorted(np.abs(parts)) == pytest.approx([1.0, 2.0], abs=1e-6)
    assert sorted(variances) == pytest.approx([1.0, 4.0])


def test_sessions_without_estimates_or_with_a_zero_covariance_end_no_study():
    assert not inside_95_ellipsoid(np.array([1e-6, 0.0, 0.0]), np.zeros((3, 3)))
    assert inside_95_ellipsoid(np.zeros(3), np.zeros((3, 3)))
    numbers = error_numbers([Estimate(3, Method.FREE, State.UNSEEN, 0)], np.zeros((1, 3)))
    assert numbers["missing"] == 1
    row = rows_of({**GOOD, **numbers, "ratio": float("nan")}, GOOD)
    json.dumps(row, allow_nan=False)
    assert (row["21"], row["methods"]["21"]["modules"]["missing"]) == (1.0, 0.5)


def test_a_good_rig_is_as_predicted_and_not_corrected():
    found = session("gaussian")
    for own in found.values():
        assert set(own) == NAMES
        for each in own.values():
            assert each["inside"] >= 0.9
            assert each["predicted"] == pytest.approx(each["true_rms"], rel=0.25)
            assert each["true_along"] <= each["true_rms"] * (1.0 + 1e-12)
            assert (each["skin_agrees"], each["used"], each["missing"]) == (True, False, 0)
    assert not any(each["believed"] for each in found[0].values()), "no landmark was poked"
    assert all(each["believed"] for count in (21, 70) for each in found[count].values())


def test_the_uncertainty_of_a_correction_is_in_the_prediction(monkeypatch):
    real, with_errors = study.estimate_taxels, session("nothing")
    monkeypatch.setattr(study, "estimate_taxels", lambda *some, **named: real(*some, **{**named, "shared": None}))
    bare = run_session("nothing", 1)
    for count in (21, 70):
        without, carried = bare[count]["modules"], with_errors[count]["modules"]
        assert carried["used"]
        assert carried["mean"] == without["mean"]
        assert carried["predicted"] > 1.2 * without["predicted"]
        assert carried["inside"] > without["inside"]


def test_ratio_and_noise_factor_are_those_of_the_landmarks():
    for case in ("nothing", "bad"):
        ratios = {count: {each["ratio"] for each in own.values()} for count, own in session(case).items()}
        assert all(np.isnan(ratio) for ratio in ratios[0])
        assert all(len(ratios[count]) == 1 and 0.3 < next(iter(ratios[count])) < 1.6 for count in (21, 70))
    assert {each["noisier"] for own in session("nothing").values() for each in own.values()} == {1.0}
    assert session("bad")[0]["modules"]["noisier"] == 1.0
    assert session("bad")[21]["modules"]["noisier"] in NOISE_FACTORS[1:]


def test_the_verdict_decides_belief(monkeypatch):
    asked = []
    monkeypatch.setattr(study, "is_believed", lambda _, landmarks: bool(asked.append(landmarks)))
    found = run_session("gaussian", 1)
    assert not any(each["believed"] for own in found.values() for each in own.values())
    assert [landmarks is None for landmarks in asked] == [True] * 3 + [False] * 6


@pytest.mark.parametrize(
    ("check", "changes", "believed"),
    [
        (Check(60, 58), {}, True), (Check(60, 58), {"ratio": 1.6}, False), (Check(60, 58), {"noisier": 1.4}, True),
        (Check(60, 58), {"noisier": 2.0}, False), (Check(60, 58), None, False), (Check(5, 5), {}, False),
        (Check(60, 50), {}, False),
    ],
)  # fmt: skip
def test_belief_needs_agreeing_skin_pokes_and_landmarks(check, changes, believed):
    agrees = None if changes is None else replace(LandmarkAgreement(21, 1.2, True), **changes)
    assert is_believed(check, agrees) is believed


# ---- rows and limits


def test_rows_average_over_seeds_and_predictions_and_ratios_as_root_mean_squares():
    other = {**GOOD, "mean": 2.0, "inside": 0.9, "predicted": 4.0, "ratio": 2.0, "wrongly_believed": False}
    row = rows_of(GOOD, other)
    assert (row["21"], row["inside_70"], row["believed_21"], row["wrongly_believed_21"]) == (1.5, 0.8, 1.0, 0.5)
    assert row["predicted"] == row["predicted_21"] == pytest.approx(np.sqrt(12.5))
    assert row["ratio_70"] == pytest.approx(np.sqrt(2.5))


def made(case="nothing", **numbers):
    """A row in which every limit holds."""
    row = {"case": case, "21": 0.1, "70": 0.1, "sessions": [{}, {}]}
    for count in (21, 70):
        row |= {f"inside_{count}": 0.95, f"predicted_{count}": 1.0, f"true_rms_{count}": 1.0}
        row |= {f"believed_{count}": 1.0, f"wrongly_believed_{count}": 0.0}
    return {**row, "methods": {"0": {name: {"inside": 0.95} for name in NAMES}}, **numbers}


def failing(*found):
    return {
        name.removeprefix("unmodelled_") for name, one in check_limits(unmodelled_limits(found)).items() if not one["holds"]
    }


def test_limits_are_those_of_the_documentation():
    every = [made(case) for case in ("nothing", "moderate", "bad", "gaussian", "lean")]
    limits = {name.removeprefix("unmodelled_"): (sign, limit) for name, (_, sign, limit) in unmodelled_limits(every).items()}
    assert limits == {
        "inside_as_modelled": (">=", 0.9), "inside": (">=", 0.8), "inside_worst": (">=", 0.65),
        "predicted_off_by_factor": ("<=", 1.5), "mean_over_audit": ("<=", 1.0), "wrongly_believed_share": ("<=", 0.05),
        "plain_inside_least": (">=", 0.93), "plain_inside_most": ("<=", 0.97), "plain_inside_outside_model": (">=", 0.85),
    }  # fmt: skip
    assert not failing(*every)


@pytest.mark.parametrize(
    ("row", "names"),
    [
        (made(inside_70=0.89), {"inside_as_modelled"}),
        (made("moderate", inside_21=0.79), {"inside"}),
        (made("wander", inside_21=0.7), set()),
        (made("bad", inside_70=0.64), {"inside_worst"}),
        (made("lean", predicted_70=1.6), {"predicted_off_by_factor"}),
        (made("lean", predicted_21=0.6), {"predicted_off_by_factor"}),
        (made("mesh_bumpy", **{"70": 1.6}), {"mean_over_audit"}),
        (made("lean", wrongly_believed_21=0.11), {"wrongly_believed_share"}),
        (made("gaussian", methods={"0": {"free": {"inside": 0.92}}}), {"plain_inside_least"}),
        (made("gaussian", methods={"0": {"free": {"inside": 0.98}}}), {"plain_inside_most"}),
        (made("gains", methods={"0": {"free": {"inside": 0.9}, "modules": {"inside": 0.84}}}), {"plain_inside_outside_model"}),
    ],
)
def test_a_limit_fails_by_its_own_case_and_number(row, names):
    assert failing(row) == names


def test_the_study_gives_rows_limits_and_lines():
    found, messages = small("unmodelled")
    row = found["unmodelled"][0]
    assert [each["case"] for each in found["unmodelled"]] == ["nothing", "gaussian"]
    assert row["uncorrected"] == row["methods"]["0"]["modules"]["mean"] > 4 * row["21"]
    assert row["21"] == session("nothing")[21]["modules"]["mean"]
    own = row["sessions"][0]
    assert (own["seed"], own["70"]["mean"], own["0"]["ratio"]) == (1, row["70"], None)
    assert "unmodelled_inside_as_modelled" in found["bars"]
    assert "unmodelled_inside_worst" not in found["bars"], "none of its cases is among them"
    assert all(any(line.strip() == message for line in study.describe(found)) for message in messages)
    (other,) = unmodelled(1, ["gaussian"], first=1001)
    assert other["sessions"][0]["seed"] == 1001
    assert other["sessions"][0]["0"]["mean"] != session("gaussian")[0]["modules"]["mean"]


def test_lines_give_factor_and_belief():
    assert off_by_factor(made(predicted_21=2.0, predicted_70=0.5)) == [2.0, 2.0]
    found = [made(uncorrected=7.0, believed_70=0.5, wrongly_believed_21=0.25)]
    assert believed_shares(found) == (0.75, 0.125)
    lines = unmodelled_lines(found)
    assert "75%" in lines[-1]
    assert "12.5%" in lines[-1]
    assert "2 rigs" in lines[0]


def test_a_sheet_is_as_predicted_and_better_than_the_board_it_is_not():
    row = sheet_row(2)
    json.dumps(row, allow_nan=False)
    assert {name: kept for name, kept in check_limits(sheet_limits(row)).items() if not kept["holds"]} == {}
    assert row["48"]["sheet"]["inside"] > row["48"]["board"]["inside"] + 0.2
    assert row["48"]["sheet"]["mean"] < row["48"]["surface"]["mean"] / 2.0
    assert all(20 < count < 120 for count in row["pokes"])
    assert f"{row['planned']} planned" in sheet_lines(row)[0]
