"""What the program makes of rigs of the second simulator: how it is counted, and what is asked of it."""

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from skincal.guide.verdict import Check, is_believed
from skincal.plotting import render
from skincal.rig.correction_fit import NOISE_FACTORS, LandmarkAgreement
from skincal.studies import unmodelled as study
from skincal.studies.benchmarking import check_limits
from skincal.studies.unmodelled import (
    FoundByMethod,
    along,
    believed_shares,
    inside,
    off_by_factor,
    run_one,
    unmodelled,
    unmodelled_bars,
    unmodelled_lines,
)
from skincal.taxels.result import Estimate, Method, State

NAMES = {method.value for method in Method}


@cache
def session(case, seed=1):
    return run_one(case, seed)


@cache
def rows():
    return unmodelled(1, ["nothing", "gaussian"])


def test_rigs_that_nothing_was_tuned_by_have_seeds_of_their_own():
    (row,) = unmodelled(1, ["gaussian"], first=1001)
    (own,) = row["sessions"]
    assert own["seed"] == 1001
    assert own["0"]["mean"] == session("gaussian", 1001)[0]["modules"].mean != session("gaussian")[0]["modules"].mean


# ---- how it is counted


def test_an_ellipsoid_holds_what_it_should_with_and_without_depth():
    full, flat, line = np.diag([1.0, 4.0, 9.0]), np.diag([1.0, 4.0, 0.0]), np.diag([4.0, 0.0, 0.0])
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(3), full, 4000)
    assert np.mean([inside(off, full) for off in drawn]) == pytest.approx(0.95, abs=0.012)
    assert np.mean([inside(off * [1, 1, 0], flat) for off in drawn]) == pytest.approx(0.95, abs=0.012)
    assert not inside(np.array([2.5, 0.0, 0.0]), flat)
    assert inside(np.array([2.5, 0.0, 0.0]), full)
    assert inside(np.array([3.9, 0.0, 0.0]), line)
    assert not inside(np.array([4.0, 0.0, 0.0]), line)


def test_what_a_flat_covariance_does_not_speak_of_is_left_out_wherever_it_lies():
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    flat = turn @ np.diag([1.0, 4.0, 1e-9]) @ turn.T
    parts, variances = along(turn @ np.array([1.0, 2.0, 50.0]), flat)
    assert sorted(np.abs(parts)) == pytest.approx([1.0, 2.0], abs=1e-6)
    assert sorted(variances) == pytest.approx([1.0, 4.0])
    assert inside(turn @ np.array([1.0, 2.0, 50.0]), flat)


def test_a_session_without_estimates_or_with_a_covariance_of_zero_ends_no_study():
    assert not inside(np.array([1e-6, 0.0, 0.0]), np.zeros((3, 3)))
    assert inside(np.zeros(3), np.zeros((3, 3)))
    unknown = Estimate(3, Method.FREE, State.UNSEEN, 0)
    numbers = study._errors([unknown], np.zeros((1, 3)))
    assert numbers["missing"] == 1
    none = FoundByMethod(**numbers, skin_agrees=False, ratio=float("nan"), believed=False, used=False, noisier=1.0)
    good = FoundByMethod(1.0, 0.9, 1.0, 1.0, 1.0, 0, True, 1.0, True, True, 1.0)
    sessions = [{count: dict.fromkeys(NAMES, each) for count in (0, 21, 70)} for each in (none, good)]
    (row,) = unmodelled(2, ["nothing"], each=lambda *_: sessions)
    json.dumps(row, allow_nan=False)
    assert (row["21"], row["methods"]["21"]["modules"]["missing"]) == (1.0, 0.5)


def test_a_good_rig_is_as_predicted_and_left_alone():
    found = session("gaussian")
    for own in found.values():
        assert set(own) == NAMES
        for each in own.values():
            assert each.inside >= 0.9
            assert each.predicted == pytest.approx(each.true_rms, rel=0.25)
            assert each.true_along <= each.true_rms * (1.0 + 1e-12)
            assert each.skin_agrees
            assert not each.used
            assert not each.missing
    assert not any(each.believed for each in found[0].values()), "nobody has poked a landmark"
    assert all(each.believed for count in (21, 70) for each in found[count].values())


def test_the_uncertainty_of_a_correction_is_in_the_prediction(monkeypatch):
    carried = session("nothing")
    real = study.estimate_taxels
    monkeypatch.setattr(study, "estimate_taxels", lambda *some, **named: real(*some, **{**named, "shared": None}))
    for count in (21, 70):
        bare = run_one("nothing", 1)[count]["modules"]
        with_it = carried[count]["modules"]
        assert with_it.used
        assert with_it.mean == bare.mean
        assert with_it.predicted > 1.2 * bare.predicted
        assert with_it.inside > bare.inside


def test_the_ratio_is_that_of_held_out_landmarks():
    for case in ("nothing", "wander"):
        ratios = {count: {each.ratio for each in own.values()} for count, own in session(case).items()}
        assert all(np.isnan(ratio) for ratio in ratios[0])
        assert all(len(ratios[count]) == 1 and 0.3 < next(iter(ratios[count])) < 1.6 for count in (21, 70))


def test_the_noise_that_landmarks_agree_with_is_kept():
    quiet, noisy = session("nothing"), session("bad")
    assert {each.noisier for own in quiet.values() for each in own.values()} == {1.0}
    assert noisy[0]["modules"].noisier == 1.0
    assert noisy[21]["modules"].noisier in NOISE_FACTORS[1:]


def test_the_verdict_decides_what_is_believed(monkeypatch):
    asked = []

    def never(tried, landmarks):
        asked.append((tried, landmarks))
        return False

    monkeypatch.setattr(study, "is_believed", never)
    found = run_one("gaussian", 1)
    assert not any(each.believed for own in found.values() for each in own.values())
    assert len(asked) == 9
    assert [landmarks is None for _, landmarks in asked] == [True] * 3 + [False] * 6
    tells, agrees = Check(60, 58), LandmarkAgreement(21, 1.2, True)
    assert is_believed(tells, agrees)
    assert not is_believed(tells, None)
    assert not is_believed(tells, replace(agrees, ratio=1.6))
    assert is_believed(tells, replace(agrees, noisier=1.4))
    assert not is_believed(tells, replace(agrees, noisier=2.0))
    assert not is_believed(Check(5, 5), agrees)
    assert not is_believed(Check(60, 50), agrees)


# ---- rows


def test_rows_hold_each_case_by_number_of_landmark_pokes_and_method():
    row = rows()[0]
    json.dumps(rows(), allow_nan=False)
    assert row["case"] == "nothing"
    assert row["uncorrected"] > 4 * row["21"]
    assert row["uncorrected"] == row["methods"]["0"]["modules"]["mean"]
    assert row["21"] == session("nothing")[21]["modules"].mean
    assert row["predicted"] == row["predicted_21"] == pytest.approx(session("nothing")[21]["modules"].predicted)
    assert set(row["methods"]) == {"0", "21", "70"}
    assert all(set(own) == NAMES for own in row["methods"].values())
    assert (row["sessions"][0]["seed"], row["sessions"][0]["70"]["mean"]) == (1, row["70"])
    assert row["sessions"][0]["0"]["ratio"] is None


def test_rows_are_means_over_seeds_and_of_predictions_and_ratios_root_mean_squares():
    first = FoundByMethod(1.0, 0.7, 3.0, 1.0, 1.0, 0, True, 1.0, True, True, 1.0)
    second = replace(first, mean=2.0, inside=0.9, predicted=4.0, ratio=2.0)
    found = [{count: dict.fromkeys(NAMES, each) for count in (0, 21, 70)} for each in (first, second)]
    (row,) = unmodelled(2, ["nothing"], each=lambda *_: found)
    assert (row["21"], row["inside_70"], row["believed_21"], row["wrongly_believed_21"]) == (1.5, 0.8, 1.0, 0.5)
    assert row["predicted"] == pytest.approx(np.sqrt(12.5))
    assert row["ratio_70"] == pytest.approx(np.sqrt(2.5))


def made(case="nothing", **numbers):
    """A row in which every bar holds."""
    row = {"case": case, "21": 0.1, "70": 0.1, "sessions": [{}, {}]}
    for count in (21, 70):
        row |= {f"inside_{count}": 0.95, f"predicted_{count}": 1.0, f"true_rms_{count}": 1.0}
        row |= {f"believed_{count}": 1.0, f"wrongly_believed_{count}": 0.0}
    return {**row, "methods": {"0": {name: {"inside": 0.95} for name in NAMES}}, **numbers}


def failing(*found):
    return {name.removeprefix("unmodelled_") for name, bar in check_limits(unmodelled_bars(found)).items() if not bar["holds"]}


def test_bars_are_those_that_were_asked_for():
    every = [made(case) for case in ("nothing", "moderate", "bad", "gaussian", "lean")]
    limits = {name.removeprefix("unmodelled_"): (sign, limit) for name, (_, sign, limit) in unmodelled_bars(every).items()}
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
def test_a_bar_falls_by_the_case_and_number_that_it_is_of(row, names):
    assert failing(row) == names


def test_the_study_gives_rows_limits_lines_and_a_figure():
    said = []
    found = study.run(True, said.append, 1, ["nothing", "gaussian"])
    json.dumps(found, allow_nan=False)
    assert [row["case"] for row in found["unmodelled"]] == ["nothing", "gaussian"]
    assert {"unmodelled_inside_as_modelled", "unmodelled_plain_inside_most"} < set(found["bars"])
    assert "unmodelled_inside_worst" not in found["bars"], "none of its cases is among them"
    lines = study.summary(found)
    assert len(said) == 2
    assert all(any(line.strip() == sentence for line in lines) for sentence in said)
    (picture,) = render(partial(study.draw, found), (12.0, 7.0), ("svg",), 100)
    assert b"gaussian" in picture


def test_a_prediction_is_off_alike_where_it_is_too_small_and_too_large():
    assert off_by_factor(made(predicted_21=2.0, predicted_70=0.5)) == [2.0, 2.0]


def test_lines_say_what_is_believed():
    found = [made(uncorrected=7.0, believed_70=0.5, wrongly_believed_21=0.25)]
    assert believed_shares(found) == (0.75, 0.125)
    assert "75%" in unmodelled_lines(found)[-1]
    assert "12.5%" in unmodelled_lines(found)[-1]
    assert "2 rigs" in unmodelled_lines(found)[0], "bars of few rigs fall by chance"
