"""Writes the tables of `docs/devices.md` from the registry of device families: `python -m tools.device_tables`."""

from __future__ import annotations

from pathlib import Path

from skincal.devices.registry import FAMILIES, load_family

PAGE = Path(__file__).resolve().parents[1] / "docs" / "devices.md"
DEVICES_HEAD = "| device | address | tried by | rate | its own status |"
WIRING_HEAD = "| device | how it reaches the computer |"


def device_table() -> list[str]:
    """Build the table of devices."""
    rows = [row for file in FAMILIES for row in load_family(file).table]
    cells = [f"| {row.device} | {row.address} | {row.tried_by} | {row.rate} | {row.reports} |" for row in rows]
    return [DEVICES_HEAD, "|---|---|---|---|---|", *cells]


def wiring_table() -> list[str]:
    """Build the table of wiring."""
    rows = [row for file in FAMILIES for row in load_family(file).wiring]
    return [WIRING_HEAD, "|---|---|", *(f"| {device} | {wiring} |" for device, wiring in rows)]


def with_tables(page: str) -> str:
    """Replace the tables of a page."""
    lines = page.split("\n")
    for table in (device_table(), wiring_table()):
        begin = lines.index(table[0])
        end = next(at for at in range(begin, len(lines)) if not lines[at].startswith("|"))
        lines[begin:end] = table
    return "\n".join(lines)


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
