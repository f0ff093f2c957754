"""Commands on a simulated session with three axes: solve and compare say the turns, files bring them back."""

import pytest

import skincal
from skincal.cli.record import finish
from skincal.session.importing import KeptError


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    from tests.skincal.simulation.test_vector_rig import simulate

    folder = tmp_path_factory.mktemp("axes") / "trial"
    simulate(folder)
    return folder


def test_solve_summarizes_the_turns(session, run, answered):
    found = answered("solve", session)["turns"]
    assert found["states"] == {"by module": 24}
    assert found["log_odds_shared"] > 10.0
    assert len(found["taxels"]) == 24
    assert all(each["z_sd_deg"] < 1.0 > each["in_plane_sd_deg"] for each in found["taxels"].values())
    text = run("solve", session)[1]
    assert "turns: 24 of 24 taxels known, expected error " in text
    assert "All taxels of a module report in the module's axes (odds " in text


def test_the_end_of_a_recording_summarizes_the_turns(session, capsys):
    pipeline = skincal.Session.load(session).results.pipeline
    with pytest.raises(KeptError, match="not opened yet"):  # its devices are not connected
        finish(pipeline, session, False)
    assert "turns: 24 of 24 taxels known, expected error " in capsys.readouterr().out


def test_compare_gives_the_turns_also_of_files_that_were_exported(session, run, answered, tmp_path):
    found = answered("compare", session, f"{session}:truth")["turns"]
    assert found["taxels"] == 24
    assert max(each["z_deg"] for each in found["apart"].values()) < 2.0
    assert max(each["in_plane_deg"] for each in found["apart"].values()) < 2.0
    for format_ in ("json", "csv"):
        path = tmp_path / f"pad.{format_}"
        assert run("export", session, "--format", format_, "--out", path)[0] == 0
        own = answered("compare", path, session)["turns"]
        assert own["taxels"] == 24
        assert max(max(each.values()) for each in own["apart"].values()) < 1e-5
    assert run("compare", path, session)[1].splitlines()[-1].startswith("Turns: z axes of 24 taxels differ by 0.0")


def test_every_format_of_the_session_is_written(session, run, tmp_path):
    assert run("solve", session, "--out", tmp_path / "all")[0] == 0
    assert "rotation:" in (tmp_path / "all" / "taxels-modules.yaml").read_text()
