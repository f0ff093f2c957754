"""What the runtime study's table says: ratios, growth, bars, and all of it in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from skincal.studies.measures import LABELS, Row

BRUTE_MIN, SLSQP_MIN = 300.0, 10_000.0
"""How many times faster than brute force, and than the paper's way, a whole re-solve is on the large part."""
EQUAL_M = 1e-12
"""m. Every triangle tried one by one gives the same point."""
GROWTH_MAX = 2.0
"""How much a taxel may cost more on 100,000 triangles than on 1,000."""
POKE_MAX_MS = 2.0
RESOLVE_MAX_S = 2.0
MEMORY_MAX_MB = 2.0
"""Megabytes for each 1,000 pokes."""
AS_SHIPPED = (
    "As shipped: with uncertainty, trust and rivals, which the other ways do not give. Trust finds pokes that touched two "
    "places, and adds 1 to 2 % to the error where there are none."
)


def _row(rows: Sequence[Row], part: str, method: str, per_taxel: int, triangles: int | None = None) -> Row | None:
    """Return the row of a method on the whole part; on its own mesh, or on the one nearest to so many triangles."""
    of_part = [row for row in rows if (row["part"], row["pokes_per_taxel"]) == (part, per_taxel)]
    taxels = max(row["taxels"] for row in of_part)
    found = [row for row in of_part if row["taxels"] == taxels and row["method"] == method]
    if triangles is None:
        return found[0] if found else None
    return min(found, key=lambda row: abs(row["triangles"] - triangles))


def ratios_of(rows: Sequence[Row], part: str, per_taxel: int) -> dict[str, float]:
    """Return the ratios of median times on the large part's own mesh, and the growth with its triangles."""

    def ms(method: str, triangles: int | None = None, key: str = "time_ms") -> float | None:
        row = _row(rows, part, method, per_taxel, triangles)
        return None if row is None else row[key]["median"]

    ours, free, coarse = ms("surface"), ms("free"), ms("surface", 1_000)
    # A re-solve begins from what a session keeps of its contacts.
    again = ms("surface", key="from_session_ms")
    pairs = {
        f"{name}_over_surface": (ms(name), again) for name in ("brute", "facing", "compiled", "bounded", "slsqp", "quadprog")
    }
    pairs |= {f"{name}_over_free": (ms(name), free) for name in ("lstsq", "normal")}
    pairs["brute_over_surface_from_contacts"] = (ms("brute"), ours)
    pairs["per_taxel_100k_over_1k"] = (ours, coarse)
    return {name: top / bottom for name, (top, bottom) in pairs.items() if top is not None and bottom is not None}


def bars_of(ratios: Mapping[str, float], off: Mapping[str, float], lively: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return each bar: its value, on which side of its limit it must be, and whether it is."""
    bars = {
        "brute_over_surface": (ratios["brute_over_surface"], ">=", BRUTE_MIN),
        "slsqp_over_surface": (ratios["slsqp_over_surface"], ">=", SLSQP_MIN),
        "brute_equal_m": (off["brute"], "<=", EQUAL_M),
        "per_taxel_100k_over_1k": (ratios["per_taxel_100k_over_1k"], "<=", GROWTH_MAX),
        "poke_ms": (lively["poke"][0]["time_ms"]["median"], "<=", POKE_MAX_MS),
        "resolve_s": (lively["resolve"]["time_ms"]["median"] / 1e3, "<=", RESOLVE_MAX_S),
        "memory_mb_per_1000": (lively["memory"]["megabytes_per_1000"], "<=", MEMORY_MAX_MB),
    }
    return {
        name: {"value": value, "sign": sign, "limit": limit, "holds": value >= limit if sign == ">=" else value <= limit}
        for name, (value, sign, limit) in bars.items()
    }


def growth_of(rows: Sequence[Row], per_taxel: int) -> dict[str, list[dict[str, Any]]]:
    """Return what a taxel costs against triangles, taxels and pokes, the other two held."""
    whole: dict[str, int] = {}
    own: dict[str, int] = {}
    for row in rows:
        whole[row["part"]] = max(row["taxels"], whole.get(row["part"], 0))
        own.setdefault(row["part"], row["triangles"])
    growth: dict[str, list[dict[str, Any]]] = {"triangles": [], "taxels": [], "pokes_per_taxel": []}
    for row in rows:
        held = {
            "triangles": row["triangles"] == own[row["part"]],
            "taxels": row["taxels"] == whole[row["part"]],
            "pokes_per_taxel": row["pokes_per_taxel"] == per_taxel,
        }
        cost = {key: row["time_ms"][key] * 1e3 / row["taxels"] for key in ("median", "q1", "q3")}
        for name, points in growth.items():
            if all(is_held for other, is_held in held.items() if other != name):
                points.append({"part": row["part"], "method": row["method"], name: row[name], "us_per_taxel": cost})
    return {name: sorted(points, key=lambda point: point[name]) for name, points in growth.items()}


def told(row: Row) -> str:
    """Return a row in words."""
    error = row["error_mm"]
    return (
        f"{row['part']}, {row['taxels']} taxels, {row['triangles']} triangles, {row['pokes_per_taxel']} pokes: "
        f"{LABELS[row['method']]}: {time_words(row['time_ms']['median'])}"
        + (" (extrapolated)" if row["extrapolated_from"] else "")
        + ("" if error is None else f", {error['median']:.2f} mm")
        + ("" if row["off_ours_m"] is None else f", at most {row['off_ours_m']:.1e} m from ours")
    )


def time_words(ms: float) -> str:
    """Return a time with three digits in the unit that suits it."""
    for unit, size in (("h", 3.6e6), ("min", 6e4), ("s", 1e3)):
        if ms >= 2 * size or (unit == "s" and ms >= size):
            return f"{ms / size:.3g} {unit}"
    return f"{ms:.3g} ms"


def summary(result: dict[str, Any]) -> list[str]:
    """Return the two cells on which everything is measured, the bars, and what was left out."""
    lines: list[str] = []
    last: tuple[Any, ...] | None = None
    for row in main_rows(result):
        size = (row["part"], row["taxels"], row["triangles"], row["pokes_per_taxel"])
        if size != last:
            lines.append("{}: {} taxels, {} triangles, {} pokes a taxel".format(*size))
            last = size
        error = "" if row["error_mm"] is None else f"{row['error_mm']['median']:6.2f} mm"
        part = "  extrapolated" if row["extrapolated_from"] else ""
        lines.append(f"  {row['label']:52s}{time_words(row['time_ms']['median']):>10s} {error}{part}")
    for name, bar in result["bars"].items():
        told = "holds" if bar["holds"] else "DOES NOT HOLD"
        lines.append(f"{name}: {bar['value']:.4g}, bar {bar['sign']} {bar['limit']:g}: {told}")
    lines.append(AS_SHIPPED)
    return [*lines, *result["left_out"]]


def main_rows(result: dict[str, Any]) -> list[Row]:
    """Return the rows of the cells on which everything is measured: those of the lstsq rows' size, one a part."""
    sizes: dict[str, tuple[Any, ...]] = {}
    for row in result["table"]:
        if row["method"] == "lstsq":
            sizes.setdefault(row["part"], _size(row))
    return [row for row in result["table"] if _size(row) == sizes.get(row["part"])]


def _size(row: Row) -> tuple[Any, ...]:
    return row["taxels"], row["triangles"], row["pokes_per_taxel"]
