"""The project in other environments than its own, each made anew: `make versions`.

The lowest versions that pyproject.toml declares, on this Python, and the newest ones on each newer Python that the machine
has. In each, a smoke test runs the installed command through help, design, export, runs and the hardware loop in lockstep.
The standard library and uv, from the project's own environment; uv is told the index that pip uses. With the argument
`installed` the smoke test alone, with what is installed for this Python.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEWER = ("3.12", "3.13", "3.14")
SMOKE = (
    "--version",
    "--help",
    "new balance",
    "run --help",
    "hil --help",
    "design --mu 0.5 --alpha 0.3 -o my.json",
    "design --method direct -o direct.json",
    "export --design my.json",
    "export --kind python -o python",
    "run tilt --set run.duration=0.5",
    "run tilt --set run.duration=0.1 --fmus python -o python.csv",
    "compare tilt --set run.duration=0.3 --draws 2",
    "hil --lockstep --duration 1",
    "replay results/hil/run.csv",
    "overlay results/hil/run.csv",
    "identify results/hil/run.csv --fit D_p",
)
PIP_TO_UV = {"index-url": "UV_DEFAULT_INDEX", "cert": "SSL_CERT_FILE"}


def index(environment: Mapping[str, str], configuration: str) -> dict[str, str]:
    """Return the environment in which uv uses pip's index, which it does not read by itself, from `pip config list`."""
    entries = (line.partition("=") for line in configuration.splitlines())
    settings = {key.rpartition(".")[2]: value.strip("'\"") for key, _, value in entries}
    return {name: settings[key] for key, name in PIP_TO_UV.items() if key in settings} | dict(environment)


def interpreter(version: str) -> str | None:
    """Return the path of a Python of this version that runs, on the PATH or among pyenv's; None: there is none."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    for candidate in (shutil.which(f"python{version}"), *sorted(versions.glob(f"{version}.*/bin/python"))):
        if (
            candidate is not None
            and subprocess.run([candidate, "-c", ""], capture_output=True, check=False).returncode == 0
        ):
            return str(candidate)
    return None


def install(python: str, resolution: str, folder: Path) -> Path:
    """Install the project on an interpreter into a new environment in `folder`; return the environment's commands."""
    listed = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    environment = index(os.environ, listed.stdout)

    def uv(*arguments: str) -> None:
        subprocess.run([Path(sysconfig.get_path("scripts")) / "uv", *arguments], cwd=ROOT, env=environment, check=True)

    uv("venv", "--quiet", "--no-config", "--no-python-downloads", "--python", python, str(folder))
    target = ("--quiet", "--no-config", "--python", str(folder))
    uv("pip", "install", *target, "hatchling")  # without isolation: the native units are built, Zig is not needed again
    uv("pip", "install", *target, "--no-build-isolation", "--resolution", resolution, "--editable", ".")
    return folder / ("Scripts" if os.name == "nt" else "bin")


def smoke(
    program: Sequence[str | Path],
    folder: Path,
    lines: Sequence[str] = SMOKE,
    environment: Mapping[str, str] = os.environ,
) -> None:
    """Run the program with every line of arguments in `folder`; raise SystemExit for the first that fails or warns."""
    plain = {**environment, "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb", "MPLBACKEND": "agg"}
    for line in lines:
        command = [*program, *shlex.split(line)]
        done = subprocess.run(command, cwd=folder, env=plain, capture_output=True, text=True, check=False)
        if done.returncode or re.search("Traceback|Warning", done.stderr):
            raise SystemExit(f"qube-ihc {line}: exit code {done.returncode}\n{done.stdout}{done.stderr}")


def tried(version: str, python: str, resolution: str) -> str:
    """Install and run everything in a temporary folder; return what was done and how long it took."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        commands, work = install(python, resolution, Path(folder) / "venv"), Path(folder) / "work"
        work.mkdir()
        smoke([commands / "qube-ihc"], work)
    seconds = time.monotonic() - begin
    return f"Python {version}, {resolution} versions: {len(SMOKE)} commands in {seconds:.0f} s"


def installed() -> None:
    """Run everything with the command that is installed beside this Python, in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        smoke([Path(sysconfig.get_path("scripts")) / "qube-ihc"], Path(folder))
    print(f"installed: {len(SMOKE)} commands")


def main() -> None:
    """Try the environments, two at a time; say what was done and what is not there."""
    newer = {version: interpreter(version) for version in NEWER}
    environments = [("{}.{}".format(*sys.version_info), sys.executable, "lowest-direct")]
    environments += [(version, python, "highest") for version, python in newer.items() if python is not None]
    with ThreadPoolExecutor(2) as pool:
        for done in pool.map(tried, *zip(*environments, strict=True)):
            print(done, flush=True)
    missing = [version for version, python in newer.items() if python is None]
    if missing:
        print(f"skipped, not on this machine: Python {', '.join(missing)}")


if __name__ == "__main__":
    installed() if sys.argv[1:] == ["installed"] else main()
