"""Makes `dist/`: the sdist and, from it, a wheel for each platform, all on this machine: `make dist`.

With the packages hatchling and ziglang of this environment; nothing is downloaded. The same sources, and the same version of
hatchling, give the same bytes; the times in the archives are hatchling's constant or SOURCE_DATE_EPOCH.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hatch_build import TAGS, VARIABLE

ROOT = Path(__file__).parent
DIST = ROOT / "dist"
BACKEND = "import sys; from hatchling import build; print(getattr(build, sys.argv[1])(sys.argv[2]))"
"""The functions of PEP 517 return the file's name."""


def build(source: Path, target: str, folder: Path, platform: str = "") -> Path:
    """Build the target, `sdist` or `wheel`, of the project in `source` into `folder`; return the path of the file."""
    command = [sys.executable, "-c", BACKEND, f"build_{target}", str(folder)]
    environment = {**os.environ, VARIABLE: platform}
    done = subprocess.run(command, cwd=source, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(f"building the {target} {platform} failed:\n{done.stdout}{done.stderr}")
    return folder / done.stdout.split()[-1]


@contextmanager
def unpacked(sdist: Path) -> Iterator[Path]:
    """Give the folder of the sdist's project, in a temporary one."""
    with tempfile.TemporaryDirectory(prefix="make-dist-") as place:
        with tarfile.open(sdist) as archive:
            archive.extractall(place, filter="data")
        yield from Path(place).iterdir()


def make(folder: Path) -> Iterator[Path]:
    """Build sdist and wheels into `folder`, one after the other; give their paths."""
    sdist = build(ROOT, "sdist", folder)
    yield sdist
    for platform in TAGS:
        with unpacked(sdist) as source:
            yield build(source, "wheel", folder, platform)


def main() -> None:
    """Make `dist/` anew and print a line for each file as sha256sum does."""
    shutil.rmtree(DIST, ignore_errors=True)
    for path in make(DIST):
        print(hashlib.sha256(path.read_bytes()).hexdigest(), path.name, sep="  ", flush=True)


if __name__ == "__main__":
    main()
