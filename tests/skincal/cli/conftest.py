"""Commands as a user runs them."""

import json

import pytest

from skincal.cli import main


@pytest.fixture(autouse=True)
def _no_broadcast(monkeypatch):
    """Search for trackers on this machine alone."""
    monkeypatch.setattr("skincal.streams.tracker_search.BROADCAST_ADDRESS", "127.0.0.1")


@pytest.fixture
def run(capsys):
    """Give a function that runs a command and returns exit code, stdout and stderr."""

    def run(*words):
        capsys.readouterr()
        code = main([str(word) for word in words])
        out, err = capsys.readouterr()
        assert "Traceback" not in err, err
        return code, out, err

    return run


@pytest.fixture
def answered(run):
    """Give a function that runs a command and returns its result, by `--json`."""

    def answered(*words):
        code, out, err = run(*words, "--json")
        assert code == 0, err
        return json.loads(out)

    return answered
