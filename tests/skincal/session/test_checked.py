"""What `skincal export` says and writes of what was checked."""

import json

import pytest

from skincal.cli import main
from skincal.model.scene import resource

SAMPLE = str(resource("sessions/sample"))


@pytest.mark.parametrize("method", ["surface", "modules"])
def test_export_says_what_the_session_has_come_to_as_the_file_does(tmp_path, capsys, method):
    asked = ["export", SAMPLE, "--format", "json", "--out", str(tmp_path / "c.json"), "--method", method]
    assert main([*asked, "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict.startswith("Not enough yet: ")
    assert verdict == json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["verdicts"][method]
    assert main(asked) == 0
    assert f"{verdict}." in capsys.readouterr().out.splitlines()
