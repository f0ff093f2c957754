"""Write what a full run measured into docs/benchmarks.md: `python -m tools.benchmarks_page measured/runtime.json`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from skincal.studies.measuring import time_words
from skincal.studies.runtime import main_rows

PAGE = Path(__file__).resolve().parent.parent / "docs" / "benchmarks.md"
BEGIN, END = "<!-- measured -->", "<!-- end -->"


def main() -> int:
    """Replace what stands between the page's two marks."""
    if len(sys.argv) != 2:
        print(__doc__)
        return 2
    result = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(f"{before}{BEGIN}\n{measured(result)}\n{END}{after}", encoding="utf-8", newline="\n")
    return 0


def measured(result: dict[str, Any]) -> str:
    """Return the machine, the bars and the two parts, as Markdown."""
    machine = result["machine"]
    load = "" if machine["load"] is None else f", load {machine['load']:.1f}"
    about = f"{machine['platform']}, {machine['cpus']} cores{load}; Python {machine['python']}, numpy {machine['numpy']}, "
    about += f"scipy {machine['scipy']}. Clock: {machine['clock']}."
    if result["quick"]:
        about += " A quick run."
    said = {True: "holds", False: "**does not hold**"}
    bars = [[f"`{name}`", f"{bar['value']:.3g}", said[bar["holds"]]] for name, bar in result["bars"].items()]
    ratios = [[f"`{name}`", f"{value:.3g}"] for name, value in result["ratios"].items()]
    rows = [
        [
            f"{row['part']}, {row['taxels']:,} taxels, {row['triangles']:,} triangles",
            row["label"],
            time_words(row["time_ms"]["median"]) + (" (extrapolated)" if row["extrapolated_from"] else ""),
            "" if row["error_mm"] is None else f"{row['error_mm']['median']:.2f}",
        ]
        for row in main_rows(result)
    ]
    tables = (
        table(["bar", "value", ""], bars),
        table(["ratio", "value"], ratios),
        table(["part", "method", "time", "error, mm"], rows),
    )
    return "\n".join(["", about, "", *(line for lines in tables for line in (*lines, ""))])


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    return [f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows)]


if __name__ == "__main__":
    sys.exit(main())
