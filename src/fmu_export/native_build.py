"""Shared libraries of C sources by Zig's C compiler, for this machine or, on any machine, for others.

Those of the host are built once, when the package is installed, those of others on demand. The same sources give the same
bytes on every machine.

Standard library only: this module also runs while the package is being built.
"""

from __future__ import annotations

import hashlib
import os
import platform as machine
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from .files import any_file, write_file

FLAGS = (
    "-std=c99",
    "-O3",
    "-pedantic",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wshadow",
    "-Werror",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fomit-frame-pointer",
    "-fno-sanitize=undefined",  # Zig's default traps in unoptimized builds
    "-fvisibility=hidden",
    "-DFMI2_OVERRIDE_FUNCTION_PREFIX",  # the plain names of FMI
    "-g0",
)
"""Strict C99; results do not depend on whether the machine can fuse multiplication and addition. Nobody reads errno."""


@dataclass(frozen=True)
class Platform:
    """A folder under `binaries/`, the file name's end there, and Zig's targets; several become one universal file."""

    name: str
    suffix: str
    targets: tuple[str, ...]


PLATFORMS = {
    p.name: p
    for p in (
        Platform("linux64", ".so", ("x86_64-linux-gnu.2.17",)),
        Platform("aarch64-linux", ".so", ("aarch64-linux-gnu.2.17",)),
        Platform("win64", ".dll", ("x86_64-windows-gnu",)),
        Platform("darwin64", ".dylib", ("x86_64-macos.11.0", "aarch64-macos.11.0")),
    )
}
"""FMI 2.0 has no name for Linux on ARM; the folder is named as in FMI 3.0."""

BINARIES = Path(__file__).parent / "binaries"
"""Where the installation puts the host's binaries: `<platform>/<unit><suffix>`."""


class BuildError(RuntimeError):
    """The compiler is missing or refused; the message holds what it said."""


class CompilerMissingError(BuildError):
    """The package ziglang is not installed."""


def host_platform() -> Platform:
    """Return the platform of this machine; raise BuildError for one that is not among PLATFORMS."""
    systems = {"linux": "linux64", "win32": "win64", "darwin": "darwin64"}
    name = systems.get(sys.platform, sys.platform)
    arm = machine.machine().lower() in ("aarch64", "arm64")
    if arm and name == "linux64":
        name = "aarch64-linux"
    if name not in PLATFORMS or sys.maxsize < 2**32 or (arm and name == "win64"):
        raise BuildError(f"there are no native binaries for {sys.platform} on {machine.machine()}")
    return PLATFORMS[name]


def zig_command() -> list[str]:
    """Return the command that runs Zig's C compiler; raise CompilerMissingError where there is none."""
    if find_spec("ziglang") is None:
        raise CompilerMissingError("building binaries needs the package ziglang")
    return [sys.executable, "-m", "ziglang", "cc"]


def build_library(files: Mapping[str, bytes], name: str, platform: Platform) -> bytes:
    """Return the shared library `name` of the C sources among `files`, for all targets of `platform`."""
    with tempfile.TemporaryDirectory(prefix="native-build-") as folder:
        for file, text in files.items():
            (Path(folder) / file).write_bytes(text)
        sources = sorted(file for file in files if file.endswith(".c"))
        slices = [_compile(Path(folder), sources, name + platform.suffix, target) for target in platform.targets]
    return slices[0] if len(slices) == 1 else universal(slices)


def install_library(folder: Path, files: Mapping[str, bytes], name: str, platform: Platform) -> Path:
    """Build the library `name` into `folder`/<platform> unless it is there, made of the same files; return its path."""
    path = folder / platform.name / (name + platform.suffix)
    if not _is_current(path, files):
        write_file(path, build_library(files, name, platform), any_file)
        write_file(_digest_path(path), _digest(files) + "\n", any_file)
    return path


def installed_library(folder: Path, files: Mapping[str, bytes], name: str, platform: Platform) -> Path:
    """Return the path of the library that the installation built; raise BuildError where it is missing or outdated."""
    path = folder / platform.name / (name + platform.suffix)
    if not _is_current(path, files):
        state = "is older than its sources" if path.is_file() else "is missing"
        raise BuildError(f"the binary {platform.name}/{path.name} {state}; installing the package again builds it")
    return path


def _digest(files: Mapping[str, bytes]) -> str:
    digest = hashlib.sha256(repr(FLAGS).encode())
    for name in sorted(files):
        digest.update(name.encode() + b"\0" + files[name] + b"\0")
    return digest.hexdigest()


def _digest_path(path: Path) -> Path:
    return path.with_suffix(".sha256")


def _is_current(path: Path, files: Mapping[str, bytes]) -> bool:
    digest = _digest_path(path)
    return path.is_file() and digest.is_file() and digest.read_text(encoding="ascii").strip() == _digest(files)


def _compile(folder: Path, sources: Sequence[str], name: str, target: str) -> bytes:
    """Compile and link in `folder`, by names without paths: the bytes then do not depend on where it is."""
    link = ["-shared", "-s", "-o", name]
    if "macos" in target:
        link += ["-Wl,-install_name,@rpath/" + name]
    elif "linux" in target:
        link += ["-fPIC", "-lm", "-Wl,--build-id=none", "-Wl,-soname," + name]
    command = [*zig_command(), "-target", target, *FLAGS, "-isystem", ".", *sources, *link]
    done = subprocess.run(command, cwd=folder, env=_environment(), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise BuildError(f"compiling {name} for {target} failed:\n{done.stderr.strip() or done.stdout.strip()}")
    return (folder / name).read_bytes()


def _environment() -> dict[str, str]:
    """Return the environment without what would change the bytes."""
    return {k: v for k, v in os.environ.items() if k not in ("CFLAGS", "CPPFLAGS", "LDFLAGS", "CPATH", "LIBRARY_PATH")}


def universal(slices: Iterable[bytes]) -> bytes:
    """Return Apple's universal file of thin Mach-O files, each beginning at a multiple of 16 KiB."""
    parts = list(slices)
    alignment = 14
    entries, bodies, offset = b"", b"", 1 << alignment
    for part in parts:
        cpu_type, cpu_subtype = struct.unpack_from("<II", part, 4)
        entries += struct.pack(">IIIII", cpu_type, cpu_subtype, offset, len(part), alignment)
        padded = len(part) + -len(part) % (1 << alignment)
        bodies += part.ljust(padded, b"\0")
        offset += padded
    head = struct.pack(">II", 0xCAFEBABE, len(parts)) + entries
    return head.ljust(1 << alignment, b"\0") + bodies
