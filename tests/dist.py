"""The files in `dist/` as their users get them: `make dist-check`.

Made once more they are the same, byte by byte. Each platform's installer finds its wheel. That of this machine is installed
into a new environment from a folder of downloaded wheels, and used there, without network and without a compiler.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path

from fmu_export.native_build import host_platform
from hatch_build import TAGS
from make_dist import DIST, make
from tests.environments import SMOKE, smoke

UV = Path(sysconfig.get_path("scripts")) / "uv"
PLATFORMS = {
    "x86_64-manylinux_2_17": "manylinux_2_17_x86_64",
    "aarch64-manylinux_2_17": "manylinux_2_17_aarch64",
    "x86_64-pc-windows-msvc": "win_amd64",
    "x86_64-apple-darwin": "macosx_11_0_universal2",
    "aarch64-apple-darwin": "macosx_11_0_universal2",
}
"""Platforms by uv's names, and the tags of their wheels."""

WITHOUT = ("x86_64-unknown-linux-musl", "aarch64-pc-windows-msvc")
"""Platforms by uv's names that have no wheel."""


def check_bytes() -> None:
    """Make all files again, in another folder; raise SystemExit unless they are the same."""
    with tempfile.TemporaryDirectory() as folder:
        other = [path.name for path in make(Path(folder)) if path.read_bytes() != (DIST / path.name).read_bytes()]
    if other:
        raise SystemExit(f"made again, other bytes: {', '.join(other)}")
    print("made again, the same bytes", flush=True)


def installable(platform: str, version: str) -> str:
    """Return what uv says of installing from `dist/` on a platform with a version of Python, doing nothing."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["pip", "install", "--dry-run", "--no-config", "--no-index", "--no-deps", "--only-binary", ":all:"]
        command += ["--find-links", str(DIST), "--target", folder, "--verbose"]
        command += ["--python-platform", platform, "--python-version", version, "qube-ihc"]
        done = subprocess.run([UV, *command], capture_output=True, text=True, check=False)
        return done.stderr if done.returncode == 0 else ""


def check_choice() -> None:
    """Raise SystemExit unless an installer finds each platform's wheel, and none where there is none."""
    for platform, tag in PLATFORMS.items():
        for version in ("3.11", "3.14"):
            if f"{tag}.whl" not in installable(platform, version):
                raise SystemExit(f"uv does not find the wheel for {platform} and Python {version}")
    wrong = [platform for platform in WITHOUT if installable(platform, "3.14")]
    if wrong:
        raise SystemExit(f"uv finds a wheel for {', '.join(wrong)}, which has none")
    print("an installer finds the wheels of all platforms", flush=True)


def without_network() -> tuple[str, ...]:
    """Return the command before another that takes the network away; nothing where the system has none that works."""
    unshare = shutil.which("unshare")
    if unshare is None:
        return ()
    command = (unshare, "--map-root-user", "--net")
    return command if subprocess.run([*command, "true"], capture_output=True, check=False).returncode == 0 else ()


def use(environment: Path, folder: Path, lines: Sequence[str]) -> None:
    """Run `qube-ihc` of a new environment in `folder`; raise SystemExit where a line fails or a compiler is at hand."""
    commands = environment / ("Scripts" if os.name == "nt" else "bin")
    bare = {name: text for name, text in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    bare["PATH"] = str(commands)
    python = commands / "python"
    compiler = (
        "import importlib.util as u, shutil; print(u.find_spec('ziglang'), *map(shutil.which, ('cc', 'gcc', 'clang')))"
    )
    compilers = subprocess.run(
        [python, "-c", compiler], env=bare, capture_output=True, text=True, check=True
    ).stdout.split()
    if set(compilers) != {"None"}:
        raise SystemExit(f"the environment has a compiler: {compilers}")
    smoke([*without_network(), commands / "qube-ihc"], folder, lines, bare)


def check_use() -> None:
    """Download what the wheel of this machine needs, install it from there, and run every command of the smoke test."""
    (wheel,) = DIST.glob(f"*{TAGS[host_platform().name]}.whl")
    with tempfile.TemporaryDirectory() as folder:
        house, environment, work = (Path(folder) / name for name in ("wheelhouse", "venv", "work"))
        work.mkdir()
        pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
        subprocess.run([*pip, "download", "--only-binary", ":all:", "--dest", house, wheel], check=True)
        subprocess.run([sys.executable, "-m", "venv", environment], check=True)
        python = environment / ("Scripts" if os.name == "nt" else "bin") / "python"
        offline = [*without_network(), python, *pip[1:], "--isolated", "install", "--no-index", "--find-links", house]
        subprocess.run([*offline, "qube-ihc"], check=True)
        use(environment, work, SMOKE)
    cut = "the network was cut off" if without_network() else "pip was told not to use the network, which was there"
    print(f"installed and used, {len(SMOKE)} commands, without a compiler; {cut}", flush=True)


def main() -> None:
    """Check the files in `dist/`."""
    check_choice()
    check_use()
    check_bytes()


if __name__ == "__main__":
    main()
