"""Rigs with errors that the program does not model, from an independent simulator (`independent_simulator`).

Each case is a rig with the paper's errors and one more, poked 504 times in seven arm poses. It is solved as it reports itself,
and corrected by 21 and by 70 pokes at landmarks. The study compares true and predicted errors, and counts how often the verdict
believes a wrong prediction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.guide.verdict import Check, check, is_believed
from skincal.mesh.surface import Surface, make_surface
from skincal.methods import estimate_taxels
from skincal.model.scene import Scene
from skincal.modules.pose import ModuleModel
from skincal.palette import BLACK, BLUE, VERMILION
from skincal.plotting import GREY, Axes, Figure
from skincal.rig.correction import RIG, CorrectionErrors, UsedCorrection
from skincal.rig.correction_fit import LandmarkAgreement, RigRequest, correct_rig, landmark_agreement
from skincal.session.snapshot import snapshot_of
from skincal.simulation.example_parts import forearm
from skincal.studies.benchmarking import check_limits, finite, limit_lines, processes
from skincal.studies.independent_simulator import CASES, SimulatedSession, simulate_session
from skincal.studies.unmodelled_sheet import AS_BOARD, AT_END, SHEET_CASE, SHEET_COUNTS, run_sheet
from skincal.taxels.result import Estimate, Method
from skincal.taxels.shared_errors import SharedRows

LANDMARK_COUNTS = (0, 21, 70)
"""Landmark pokes: none, those that the guide asks for, and ten in each arm pose."""
RANDOM_SEEDS_PER_CASE = 12
SHEET_SEEDS, QUICK_SHEET_SEEDS = 24, 8
EXTRA_SEEDS = {"gaussian": 48, "mesh_inflated": 48}
"""More seeds for cases near their limit: with twelve seeds, chance moves the share inside by 0.8 % and the error by 1.5 %."""
SPREAD_CASES = tuple(case for case in CASES if "_taxels_aim_" in case)
"""Skins that spread a press over 2 to 5 taxels, aimed at to 1 and to 3 mm."""
RIGHT_PREDICTION_MIN_COVERAGE = 0.90
"""Share of the taxels inside their 95 % ellipsoids from which a session's prediction is right: it should be believed."""
QUICK_SEEDS, QUICK_CASES = 2, ("nothing", "quadratic_2", "moderate", "gaussian")
ZERO_VARIANCE_MAX_RATIO = 1e-6
"""Variances below this share of the largest are taken for zero: the estimate lies on a surface."""
CHI2_95 = {1: 3.841, 2: 5.991, 3: 7.815}
"""95 % quantile of chi-square by degrees of freedom."""
WRONG_PREDICTION_MAX_COVERAGE = 0.80
"""Share of the taxels inside their 95 % ellipsoids below which a prediction is wrong, and belief in it a mistake."""
MEAN_MAX_MM = {
    "nothing": (0.79, 0.68), "quadratic_2": (1.08, 0.96), "quadratic_5": (2.83, 1.94), "correlated_0.2N": (1.56, 1.23),
    "wander": (1.74, 1.82), "landmarks_1.5mm": (1.13, 1.19), "landmarks_3mm": (2.27, 2.42), "mesh_shifted": (1.21, 1.10),
    "mesh_inflated": (1.80, 1.70), "mesh_bumpy": (1.65, 1.57), "moderate": (1.48, 1.29), "bad": (3.16, 2.72),
}  # fmt: skip
"""Mean errors with 21 and 70 landmark pokes from an earlier independent measurement; used as upper limits."""
RELAXED_CASES = ("bad", "wander")
"""Cases with a lower limit."""
OUTSIDE_MODEL = ("drift_0.1N", "lean", "wide_foam", "gains")
"""Cases of a rig without an error of its own that the noise of the scene does not describe."""
ByMethod: TypeAlias = dict[str, dict[str, Any]]
"""Numbers by method.

`mean`, `predicted`, `true_rms` : mm; `true_along` is the rms part of the error in the directions of the covariance
`inside` : share of the taxels in their 95 % ellipsoid; `missing` have no estimate
`skin_agrees` : whether held-out pokes agree with the prediction
`ratio` : of measured to predicted misses at landmarks, NaN without them; `noisier` is the noise factor of landmark pokes
`believed`, `wrongly_believed` : by the verdict; `used` : whether the rig was corrected
"""
ROOT_MEAN_SQUARES = ("predicted", "true_rms", "true_along", "ratio", "predicted_mm", "true_rms_mm")
"""Numbers that are averaged as root mean squares, also those of `robot`."""
Session: TypeAlias = dict[int, ByMethod]
"""By number of landmark pokes."""


def run(
    quick: bool, progress: Callable[[str], None], seeds: int | None = None, cases: Sequence[str] | None = None
) -> dict[str, Any]:
    """Measure; quick with few rigs of few cases.

    Returns
    -------
    JSON: `seeds` (rigs of most cases), `unmodelled` (a row for each case, see `unmodelled`), `sheet` (see `sheet_row`; `None`
    if `cases` are given) and `bars`
    """
    seeds = seeds or (QUICK_SEEDS if quick else RANDOM_SEEDS_PER_CASE)
    rows: list[dict[str, Any]] = []
    with processes() as pool:
        for case in cases or (QUICK_CASES if quick else tuple(CASES)):
            rows += unmodelled(seeds, [case], each=pool.map)
            progress(_row_text(rows[-1]).strip())
        sheet = None if cases else sheet_row(QUICK_SHEET_SEEDS if quick else SHEET_SEEDS, each=pool.map)
    limits = unmodelled_limits(rows) | ({} if sheet is None else sheet_limits(sheet))
    return {
        "study": "unmodelled", "quick": quick, "seeds": seeds, "unmodelled": rows, "sheet": sheet,
        "bars": check_limits(limits),
    }  # fmt: skip


def summary(result: Mapping[str, Any]) -> list[str]:
    """Describe each case and each limit."""
    of_sheet = [] if result["sheet"] is None else sheet_lines(result["sheet"])
    return [*unmodelled_lines(result["unmodelled"]), *of_sheet, *limit_lines(result["bars"])]


def in_known_directions(off: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project an error (3,) onto the directions with nonzero variance. Return the components and their variances, (d,)."""
    values, axes = np.linalg.eigh(covariance)
    known = values > ZERO_VARIANCE_MAX_RATIO * max(values[-1], 0.0)
    return axes[:, known].T @ off, values[known]


def inside_95_ellipsoid(off: FloatArray, covariance: FloatArray) -> bool:
    """Whether an error (3,) lies inside the 95 % ellipsoid of a covariance (3, 3), or its ellipse on a surface.

    A covariance of zero claims an exact position: only a zero error lies inside.
    """
    parts, variances = in_known_directions(off, covariance)
    if not len(parts):
        return not off.any()
    return float(np.sum(parts**2 / variances)) < CHI2_95[len(parts)]


def run_session(case: str, seed: int) -> Session:
    """Simulate a session, and solve it without landmarks, with 21 and with 70 pokes at them."""
    scene, true = forearm().scene, forearm().surface
    poked = simulate_session(scene, true.vertices, true.triangles, CASES[case], seed)
    surface = make_surface(poked.vertices, true.triangles)
    plain = _solve(scene, surface, poked, poked.contacts)
    found = {0: _judge(plain, None, used=False)}
    for count in LANDMARK_COUNTS[1:]:
        known = poked.known if count == LANDMARK_COUNTS[-1] else poked.known[poked.planned]
        answer = correct_rig(RigRequest(scene, surface, poked.contacts, known))
        if answer.used and answer.correction is not None:
            used = UsedCorrection(RIG, answer.correction, answer.before, answer.after, len(known), answer.ratio)
            right = [answer.correction.corrected(contact) for contact in poked.contacts]
            shared = CorrectionErrors(answer.correction, {contact.poke: contact for contact in right}.__getitem__)
            solved = _solve(scene, surface, poked, right, shared)
            found[count] = _judge(solved, landmark_agreement(answer, used), used=True)
        else:
            found[count] = _judge(plain, landmark_agreement(answer, None), used=False)
    return found


Solved: TypeAlias = dict[str, tuple[dict[str, Any], Check]]
"""By method the numbers of `error_numbers`, and the check by held-out pokes on the skin."""


def _solve(
    scene: Scene, surface: Surface, poked: SimulatedSession, contacts: Sequence[Contact], shared: SharedRows | None = None
) -> Solved:
    layout = scene.skin.layout
    assert layout is not None
    model, channels = ModuleModel(layout, scene.skin.anchor, surface), poked.channels.tolist()
    estimates = estimate_taxels(contacts, channels, tuple(Method), scene.noise, surface, model=model, shared=shared)
    solved: Solved = {}
    for method, by_channel in estimates.items():
        own = list(by_channel.values())
        moment = snapshot_of(contacts, {method: own})
        tried = check(moment, channels, method, scene.noise, surface, model)
        solved[method.value] = error_numbers(own, poked.places), tried
    return solved


def _judge(solved: Solved, landmarks: LandmarkAgreement | None, used: bool) -> ByMethod:
    ratio, noisier = (float("nan"), 1.0) if landmarks is None else (landmarks.ratio, landmarks.noisier)
    found: ByMethod = {}
    for name, (errors, tried) in solved.items():
        believed = is_believed(tried, landmarks)
        found[name] = {
            **errors, "skin_agrees": tried.has_enough and tried.agrees, "ratio": ratio, "believed": believed, "used": used,
            "noisier": noisier, "wrongly_believed": believed and errors["inside"] < WRONG_PREDICTION_MAX_COVERAGE,
        }  # fmt: skip
    return found


def error_numbers(estimates: Sequence[Estimate], places: FloatArray) -> dict[str, Any]:
    """Compare estimates with the true positions (n, 3): the numbers of `ByMethod` up to `missing`."""
    both: list[tuple[FloatArray, FloatArray]] = [
        (estimate.position - place, estimate.covariance)
        for estimate, place in zip(estimates, places, strict=True)
        if estimate.position is not None and estimate.covariance is not None
    ]
    if not both:
        return {**dict.fromkeys(("mean", "inside", "predicted", "true_rms", "true_along"), np.nan), "missing": len(estimates)}
    off: FloatArray = np.linalg.norm([error for error, _ in both], axis=1)
    along = [np.sum(in_known_directions(error, covariance)[0] ** 2) for error, covariance in both]
    return {
        "mean": 1e3 * float(off.mean()),
        "inside": float(np.mean([inside_95_ellipsoid(error, covariance) for error, covariance in both])),
        "predicted": 1e3 * float(np.sqrt(np.mean([float(covariance.trace()) for _, covariance in both]))),
        "true_rms": 1e3 * float(np.sqrt(np.mean(off**2))),
        "true_along": 1e3 * float(np.sqrt(np.mean(along))),
        "missing": len(estimates) - len(both),
    }


def sheet_row(
    seeds: int, each: Callable[[Callable[[int], dict[str, Any]], Iterable[int]], Iterable[dict[str, Any]]] = map, first: int = 1
) -> dict[str, Any]:
    """Measure the case "sheet" (`unmodelled_sheet`), seeds from `first` on; `each` is `map`, or that of a pool.

    Returns
    -------
    JSON: `pokes` until the guide asks no more (of each seed), `planned` by the layout alone, and by number of pokes and method
    the means over seeds, with `ratio`, predicted over true error along the surface
    """
    found = list(each(partial(run_sheet, compare=error_numbers), range(first, first + seeds)))
    row: dict[str, Any] = {"planned": found[0]["planned"], "pokes": [session["pokes"] for session in found]}
    for count in (*map(str, SHEET_COUNTS), AT_END):
        own = [session[count] for session in found if count in session]
        row[count] = {name: mean_over_seeds([numbers[name] for numbers in own]) for name in own[0]}
        for numbers in row[count].values():
            known = numbers["predicted"] is not None and numbers["true_along"]
            numbers["ratio"] = numbers["predicted"] / numbers["true_along"] if known else None
    return row


def sheet_limits(row: Mapping[str, Any]) -> dict[str, tuple[float, str, float]]:
    """Return the limits of the case "sheet", as `unmodelled_limits`."""
    own = [row[count][SHEET_CASE] for count in (*map(str, SHEET_COUNTS), AT_END)]
    board = [row[count][AS_BOARD] for count in map(str, SHEET_COUNTS)]
    pokes = [row["planned"] / count for count in row["pokes"] if count is not None]
    return {
        "unmodelled_sheet_inside": (min(each["inside"] for each in own), ">=", 0.90),
        "unmodelled_sheet_ratio_least": (min(each["ratio"] for each in own), ">=", 0.7),
        "unmodelled_sheet_ratio_most": (max(each["ratio"] for each in own), "<=", 1.5),
        "unmodelled_sheet_over_board_error": (
            max(each["mean"] / other["mean"] for each, other in zip(own, board, strict=False)), "<=", 1.0,
        ),
        "unmodelled_sheet_finished_share": (len(pokes) / len(row["pokes"]), ">=", 1.0),
        "unmodelled_sheet_planned_over_pokes": (float(np.median(pokes)), "<=", 1.5),
    }  # fmt: skip


def sheet_lines(row: Mapping[str, Any]) -> list[str]:
    """Describe the case "sheet"."""
    counts = [count for count in row["pokes"] if count is not None]
    lines = [
        "a sheet of 48 taxels, stretched by 3 %, sheared by 2 degrees, folded by 2 mm: "
        f"finished after {np.median(counts):.0f} pokes ({min(counts)} to {max(counts)}), {row['planned']} planned"
    ]
    for count in (*map(str, SHEET_COUNTS), AT_END):
        texts = [
            f"{name} {own['mean']:.2f} mm, inside {own['inside']:.2f}, predicted {own['ratio']:.2f} x true, "
            f"{own['missing']:.1f} missing"
            for name, own in row[count].items() if own["mean"] is not None
        ]  # fmt: skip
        lines.append(f"  {count}{' pokes' if count.isdecimal() else ''}: {'; '.join(texts)}")
    return lines


Each: TypeAlias = Callable[[Callable[[str, int], Session], Iterable[str], Iterable[int]], Iterable[Session]]
"""`map`, or that of a pool of processes."""


def unmodelled(
    seeds: int = RANDOM_SEEDS_PER_CASE, cases: Sequence[str] = tuple(CASES), each: Each = map, first: int = 1
) -> list[dict[str, Any]]:
    """Try the program on rigs of each case, seeds from `first` on. Its thresholds were found with seeds from 1 on.

    Returns
    -------
    JSON, a row for each case: `case`; by the modules method, means over seeds: errors, mm, `uncorrected`, with `21` and `70`
    landmark pokes, and the numbers of `ByMethod` as `inside_21` and so on; `predicted` is that with 21. `methods`: the same for
    each number of landmark pokes and each method. `believed_where_right`: share that is believed of the sessions with at least
    `RIGHT_PREDICTION_MIN_COVERAGE` of the taxels inside, over all methods. `sessions`: the modules method's numbers of each
    seed
    """
    of_case = {case: seeds if seeds < RANDOM_SEEDS_PER_CASE else max(seeds, EXTRA_SEEDS.get(case, 0)) for case in cases}
    jobs = [(case, seed) for case, count in of_case.items() for seed in range(first, first + count)]
    found = iter(each(run_session, [case for case, _ in jobs], [seed for _, seed in jobs]))
    return [_row(case, list(islice(found, count)), first) for case, count in of_case.items()]


def _row(case: str, found: Sequence[Session], first: int) -> dict[str, Any]:
    means = {
        str(count): {method.value: mean_over_seeds([session[count][method.value] for session in found]) for method in Method}
        for count in LANDMARK_COUNTS
    }
    lead = {count: own[Method.MODULES.value] for count, own in means.items()}
    row: dict[str, Any] = {"case": case, "uncorrected": lead["0"]["mean"], "21": lead["21"]["mean"], "70": lead["70"]["mean"]}
    for name in ("inside", "predicted", "true_rms", "true_along", "ratio", "believed", "wrongly_believed"):
        row |= {f"{name}_{count}": own[name] for count, own in lead.items()}
    every = [session[count][method.value] for session in found for count in LANDMARK_COUNTS[1:] for method in Method]
    right = [bool(own["believed"]) for own in every if own["inside"] >= RIGHT_PREDICTION_MIN_COVERAGE]
    return {
        **row, "predicted": row["predicted_21"], "methods": means,
        "believed_where_right": float(np.mean(right)) if right else None,
        "wrongly_believed_by_any_method": float(np.mean([bool(own["wrongly_believed"]) for own in every])),
        "sessions": [
            {
                "seed": seed,
                **{
                    str(count): {
                        name: finite(value) if isinstance(value, float) else value
                        for name, value in session[count][Method.MODULES.value].items()
                    }
                    for count in LANDMARK_COUNTS
                },
            }
            for seed, session in enumerate(found, start=first)
        ],
    }  # fmt: skip


def mean_over_seeds(found: Sequence[Mapping[str, Any]]) -> dict[str, float | None]:
    """Average over seeds: predicted and true errors and ratios as root mean squares, the others as means."""
    means: dict[str, float | None] = {}
    for name in found[0]:
        own = np.array([session[name] for session in found], dtype=float)
        # A session without any estimate has no errors (NaN); it counts under `missing`.
        own = own[np.isfinite(own)]
        means[name] = None if not len(own) else float(np.sqrt(np.mean(own**2)) if name in ROOT_MEAN_SQUARES else own.mean())
    return means


def unmodelled_limits(rows: Sequence[Mapping[str, Any]]) -> dict[str, tuple[float, str, float]]:
    """Return by name the worst value of the rows, ">=" or "<=", and its limit, for `check_limits`.

    A limit whose cases are not among the rows is left out.
    """
    by_case = {row["case"]: row for row in rows}
    limits: dict[str, tuple[float, str, float]] = {}

    def require(name: str, values: Sequence[float], sign: str, limit: float) -> None:
        if values:
            limits[f"unmodelled_{name}"] = (max(values) if sign == "<=" else min(values), sign, limit)

    def inside_corrected(cases: Iterable[str]) -> list[float]:
        return [by_case[case][f"inside_{count}"] for case in cases if case in by_case for count in LANDMARK_COUNTS[1:]]

    def inside_plain(cases: Iterable[str]) -> list[float]:
        return [own["inside"] for case in cases if case in by_case for own in by_case[case]["methods"]["0"].values()]

    require("inside_as_modelled", inside_corrected(["nothing"]), ">=", 0.90)
    require(
        "inside", inside_corrected([case for case in by_case if case not in RELAXED_CASES]), ">=", WRONG_PREDICTION_MAX_COVERAGE
    )
    require("inside_worst", inside_corrected(RELAXED_CASES), ">=", 0.65)
    require("predicted_off_by_factor", [factor for row in rows for factor in off_by_factor(row)], "<=", 1.5)
    audited = [
        row[str(count)] / most for case, row in by_case.items() if case in MEAN_MAX_MM
        for count, most in zip(LANDMARK_COUNTS[1:], MEAN_MAX_MM[case], strict=True)
    ]  # fmt: skip
    require("mean_over_audit", audited, "<=", 1.0)
    require("wrongly_believed_share", [believed_shares(rows)[1]], "<=", 0.05)
    require("plain_inside_least", inside_plain(["gaussian"]), ">=", 0.93)
    require("plain_inside_most", inside_plain(["gaussian"]), "<=", 0.97)
    require("plain_inside_outside_model", inside_plain(OUTSIDE_MODEL), ">=", 0.85)
    spread = [row for case, row in by_case.items() if case in SPREAD_CASES]
    require("believed_where_right", [row["believed_where_right"] for row in spread], ">=", 0.80)
    if len(spread) == len(SPREAD_CASES):
        wrong = float(np.mean([row["wrongly_believed_by_any_method"] for row in spread]))
        require("wrongly_believed_spread", [wrong], "<=", 0.02)
    return limits


def off_by_factor(row: Mapping[str, Any]) -> list[float]:
    """Return the factors, at least 1, between predicted and true error with 21 and with 70 landmark pokes."""
    shares = [row[f"predicted_{count}"] / row[f"true_rms_{count}"] for count in LANDMARK_COUNTS[1:]]
    return [max(share, 1.0 / share) for share in shares]


def believed_shares(rows: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Return the shares of all sessions with landmarks that are believed, and wrongly believed."""
    every = [(row[f"believed_{count}"], row[f"wrongly_believed_{count}"]) for row in rows for count in LANDMARK_COUNTS[1:]]
    believed, wrongly = np.mean(every, axis=0).tolist()
    return believed, wrongly


def unmodelled_lines(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Describe each case, and the share of sessions that are believed."""
    believed, wrongly = believed_shares(rows)
    of = f"{len(rows[0]['sessions'])} rigs of each kind"
    return [
        f"independent simulator, {of}, modules method without landmarks -> with 21 / 70 pokes at them:",
        *map(_row_text, rows),
        f"  {believed:.0%} of them are believed, {wrongly:.1%} with fewer than "
        f"{WRONG_PREDICTION_MAX_COVERAGE:.0%} of the taxels inside",
    ]


def _row_text(row: Mapping[str, Any]) -> str:
    def both(name: str, form: str = ".2f") -> str:
        values = (row[f"{name}{count}"] for count in LANDMARK_COUNTS[1:])
        return " / ".join("unknown" if value is None else format(value, form) for value in values)

    before = "unknown" if row["uncorrected"] is None else f"{row['uncorrected']:.1f}"
    return (
        f"  {row['case']}: {before} -> {both('')} mm, inside {both('inside_')}, predicted {both('predicted_')} mm rms of "
        f"{both('true_rms_')}, believed in {both('believed_', '.0%')}"
    )


# ---- figure ----


LANDMARK_LOOKS = {21: (BLUE, "o"), 70: (VERMILION, "s")}
"""Colour and mark by landmark pokes."""


def draw(result: Mapping[str, Any], figure: Figure) -> None:
    """Draw the predicted and the true error of each case, and the share of taxels inside their 95 % regions."""
    rows: Sequence[Mapping[str, Any]] = result["unmodelled"]
    figure.set_size_inches(13.0, 5.0)
    panels: tuple[Axes, Axes] = figure.subplots(1, 2, sharey=True)
    errors, shares = panels
    for offset, (count, (colour, mark)) in zip((0.15, -0.15), LANDMARK_LOOKS.items(), strict=True):
        places = [offset - row for row in range(len(rows))]
        predicted, true = ([row[f"{name}_{count}"] for row in rows] for name in ("predicted", "true_rms"))
        look = {"color": colour, "marker": mark, "s": 28, "zorder": 3}
        errors.hlines(places, predicted, true, color=colour, linewidth=1.0)
        errors.scatter(true, places, label=f"true, {count} landmark pokes", **look)
        errors.scatter(predicted, places, label="predicted", **{**look, "color": "white", "edgecolors": colour})
        shares.scatter([row[f"inside_{count}"] for row in rows], places, label=f"{count} landmark pokes", **look)
    least = min(row[f"predicted_{count}"] for row in rows for count in LANDMARK_LOOKS)
    most = max(row[f"true_rms_{count}"] for row in rows for count in LANDMARK_LOOKS)
    ticks = [at for at in (0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if least / 2.5 <= at <= 2.5 * most]
    errors.set_xscale("log")
    errors.set_xticks(ticks, [f"{at:g}" for at in ticks])
    errors.set_xticks([], minor=True)
    errors.set_yticks([-row for row in range(len(rows))], [row["case"] for row in rows])
    errors.set(xlabel="error of the taxels (mm rms), modules method", title="Independent simulator: predicted and true error")
    shares.axvline(0.95, color=BLACK, linewidth=1.0)
    shares.axvline(0.80, color=GREY, linewidth=1.0, linestyle="--")
    shares.set(
        xlim=(0.0, 1.02),
        xlabel="share of taxels inside their 95 % ellipsoid",
        title="Inside: 0.95 expected, at least 0.80 required",
    )
    for axes in (errors, shares):
        axes.grid(visible=True)
        axes.legend(loc="best")
