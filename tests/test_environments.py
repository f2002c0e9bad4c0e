"""What `make versions` needs before it can install anything: pip's index for uv, an interpreter that runs."""

import sys

from tests.environments import index, interpreter


def test_uv_gets_the_index_that_pip_uses_unless_it_has_its_own():
    listed = "global.index-url='https://a/simple'\n:env:.index-url='https://b/simple?x=1'\nglobal.cert='/ca.pem'\n"
    assert index({"A": "1"}, listed) == {
        "A": "1",
        "UV_DEFAULT_INDEX": "https://b/simple?x=1",
        "SSL_CERT_FILE": "/ca.pem",
    }
    assert index({"UV_DEFAULT_INDEX": "https://c"}, listed)["UV_DEFAULT_INDEX"] == "https://c"
    assert index({}, "") == {}


def test_a_shim_that_runs_nothing_is_no_interpreter(tmp_path, monkeypatch):
    shim = tmp_path / "python3.99"
    shim.write_text("#!/bin/sh\nexit 127\n", encoding="utf-8")
    shim.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path))
    assert interpreter("3.99") is None
    real = tmp_path / "versions" / "3.99.1" / "bin" / "python"
    real.parent.mkdir(parents=True)
    real.symlink_to(sys.executable)
    assert interpreter("3.99") == str(real)
