"""The project in other environments than its own, each made anew: `make versions`.

The lowest versions that pyproject.toml declares, on this Python, and the newest ones on each newer Python that the machine
has. In each, a smoke test runs the installed command through help, design, export, runs and the hardware loop in lockstep.
The standard library and uv, from the project's own environment; uv is told the index that pip uses.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
NEWER = ("python3.12", "python3.13", "python3.14")
SIMULATION = ("design", "export", "run", "compare", "tune", "paper", "demo")
DEVICE = ("hil", "device", "replay", "overlay", "identify")
SMOKE = (
    "--version",
    *(f"{command} --help" for command in ("", *SIMULATION, *DEVICE)),
    "design --mu 0.5 --alpha 0.3 -o my.json",
    "design --method direct -o direct.json",
    "export --design my.json",
    "export --kind python -o python",
    "run tilt --set run.duration=0.5",
    "run tilt --set run.duration=0.1 --fmus python -o python.csv",
    "compare tilt --set run.duration=0.3 --draws 2",
    "tune tilt --set run.duration=2 --a-min 1,0.8 --b-max 1 --u-max 1.5 --mu 1 --draws 1",
    "hil --lockstep --duration 1",
    "replay results/hil/run.csv",
    "overlay results/hil/run.csv",
    "identify results/hil/run.csv --fit D_p",
)
PIP_TO_UV = {"index-url": "UV_DEFAULT_INDEX", "cert": "SSL_CERT_FILE"}


def index(environment: Mapping[str, str], configuration: str) -> dict[str, str]:
    """Return the environment in which uv uses pip's index, which it does not read by itself, from `pip config list`."""
    found = dict(environment)
    for line in configuration.splitlines():
        key, _, value = line.partition("=")
        name = PIP_TO_UV.get(key.rpartition(".")[2])
        if name is not None:
            found.setdefault(name, value.strip("'\""))
    return found


def install(python: str, resolution: str, folder: Path) -> Path:
    """Install the project on an interpreter into a new environment in `folder`; return the environment's commands."""
    listed = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    environment = index(os.environ, listed.stdout)

    def uv(*arguments: str) -> None:
        subprocess.run([Path(sys.executable).parent / "uv", *arguments], cwd=ROOT, env=environment, check=True)

    uv("venv", "--quiet", "--no-config", "--python", python, str(folder))
    target = ("--quiet", "--no-config", "--python", str(folder))
    uv("pip", "install", *target, "hatchling")  # without isolation: the native units are built, Zig is not needed again
    uv("pip", "install", *target, "--no-build-isolation", "--resolution", resolution, "--editable", ".")
    return folder / ("Scripts" if os.name == "nt" else "bin")


def smoke(commands: Path, folder: Path) -> None:
    """Run every command of SMOKE in `folder`; raise SystemExit for the first one that fails or complains."""
    plain = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb", "MPLBACKEND": "agg"}
    for line in SMOKE:
        command = [commands / "qube-ihc", *shlex.split(line)]
        done = subprocess.run(command, cwd=folder, env=plain, capture_output=True, text=True, check=False)
        if done.returncode or done.stderr.strip():
            raise SystemExit(f"qube-ihc {line}: exit code {done.returncode}\n{done.stdout}{done.stderr}")


def main() -> None:
    """Try each environment; say what was done, how long it took, and what is not there."""
    newer = [name for name in NEWER if shutil.which(name)]
    for python, resolution in ((sys.executable, "lowest-direct"), *((name, "highest") for name in newer)):
        begin = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            commands, work = install(python, resolution, Path(folder) / "venv"), Path(folder) / "work"
            work.mkdir()
            smoke(commands, work)
        seconds = time.monotonic() - begin
        print(f"{Path(python).name}, {resolution} versions: {len(SMOKE)} commands in {seconds:.0f} s", flush=True)
    if not newer:
        print("skipped: no Python newer than 3.11 is installed here")


if __name__ == "__main__":
    main()
