"""The command `explore` where it does not come to serve: each mistake is a sentence."""

import sys

from cosim.explore.server import listening
from tests.cosim.command import ended, sentence


def test_without_its_library_it_says_what_to_install(monkeypatch, tmp_path):
    for name in ("cosim.explore.server", "cosim.explore.page"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    done = ended("explore", "tilt", cwd=tmp_path)
    assert sentence(done) == 'explore needs NiceGUI: pip install "qube-ihc[explore]"'


def test_a_port_in_use_and_fmus_that_are_missing_end_it_before_it_serves(tmp_path):
    with listening(0) as place:
        port = place.getsockname()[1]
        assert sentence(ended("explore", "tilt", "--port", port, cwd=tmp_path)) == (
            f"--port {port} is in use; another, or none for a free one"
        )
    assert "does not exist" in sentence(ended("explore", "tilt", "--no-browser", cwd=tmp_path))
