"""The developers' measurement of the window: it runs, and its figures are of the window."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.benchmarks.window_bench import percentile, table

ROOT = Path(__file__).resolve().parents[2]


def test_a_percentile_is_one_of_the_values():
    assert [percentile([3.0, 1.0, 2.0, 4.0], share) for share in (0, 50, 95, 100)] == [1.0, 3.0, 4.0, 4.0]
    assert percentile([], 50) is None


def test_the_window_is_measured():
    command = [sys.executable, "-m", "tests.benchmarks.window_bench", "--seconds", "14", "--scene", "flat-patch", "--json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT, timeout=100)
    result = json.loads(done.stdout)
    assert 0.0 < result["first_paint_s"] < 60.0
    assert result["longest_stall_s"] is None or result["longest_stall_s"] > 0.0
    assert result["longest_work_starting_s"] > 0.0
    assert result["first_picture_s"] is None or result["first_picture_s"] > result["first_paint_s"]
    assert result["stalls_above_100_ms"] >= 0
    assert result["sound_device"]
    # Of a machine that may be busy: that it is of these pokes, not that it is quick.
    for pokes, name in (("sounds", "dwell_to_sound_p95_s"), ("releases", "release_to_painted_p95_s")):
        assert result[pokes] >= 1
        assert 0.0 < result[name] < 3.0
    assert "first paint" in table(result)
