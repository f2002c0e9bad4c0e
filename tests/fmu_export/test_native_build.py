"""Binaries: the same bytes everywhere, cores without side effects, refusals of the compiler, files for other machines."""

import platform
import re
import shutil
import struct
import subprocess
import sys
from dataclasses import replace
from functools import cache

import pytest

from fmu_export import native_build
from fmu_export.native_build import (
    BINARIES,
    FLAGS,
    PLATFORMS,
    BuildError,
    build_library,
    host_platform,
    install_library,
    installed_library,
    universal,
    zig_command,
)
from fmu_export.native_unit import unit_files
from fmu_export.variables import Interface
from ihc_fmu.regulator.native_unit import NATIVE as REGULATOR

PURE = {"sin", "cos", "sincos", "exp", "log", "pow", "sqrt", "floor", "remainder", "nearbyint", "fmin", "fmax", "fabs"}
PURE |= {"frexp", "ldexp", "exp2"}
MEMORY = {"memcpy", "memset", "memmove"}
CORES = ("qube_servo2.c", "ihc_controller.c", "homogeneous_controller.c")
ADAPTERS = (
    *(core.replace(".c", "_fmu.c") for core in CORES),
    *("fmi2_adapter.c", "fmu_instance.c", "start_values_file.c"),
)
WRITABLE = re.compile(r"\.(data(?!\.rel\.ro)|bss|tdata|tbss)|\*COM\*")

COUNTER = {
    "counter.c": b"""
const char *const *count(void);
const char *const *count(void)
{
    static const char *const names[] = {"odd", "even"};
    static int zeroed, counted = 1;
    zeroed++;
    return &names[(counted += zeroed) % 2];
}
"""
}

TINY = {"tiny.c": b'__attribute__((visibility("default"))) int tiny(void);\nint tiny(void)\n{\n    return 7;\n}\n'}


# Platforms


@pytest.mark.parametrize(
    ("system", "machine", "name"),
    [
        ("linux", "x86_64", "linux64"),
        ("linux", "aarch64", "aarch64-linux"),
        ("darwin", "arm64", "darwin64"),
        ("darwin", "x86_64", "darwin64"),
        ("win32", "AMD64", "win64"),
    ],
)
def test_host_platform_is_told_from_system_and_machine(system, machine, name, monkeypatch):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    assert host_platform() == PLATFORMS[name]


@pytest.mark.parametrize(("system", "machine"), [("freebsd14", "amd64"), ("win32", "ARM64"), ("emscripten", "wasm32")])
def test_other_machines_have_no_binaries(system, machine, monkeypatch):
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(platform, "machine", lambda: machine)
    with pytest.raises(BuildError, match=f"no native binaries for {system} on {machine}"):
        host_platform()


def test_python_of_32_bits_has_no_binaries(monkeypatch):
    monkeypatch.setattr(sys, "maxsize", 2**31 - 1)
    with pytest.raises(BuildError, match="no native binaries"):
        host_platform()


# The same bytes


def test_built_again_it_is_the_same(name, native_units):
    files, host = unit_files(native_units[name]), host_platform()
    assert build_library(files, name, host) == installed_library(BINARIES, files, name, host).read_bytes()


def test_built_in_another_folder_with_empty_caches_it_is_the_same(native_units, tmp_path, monkeypatch):
    files, host = unit_files(native_units["QubeServo2"]), host_platform()
    for variable in ("ZIG_LOCAL_CACHE_DIR", "ZIG_GLOBAL_CACHE_DIR"):
        monkeypatch.setenv(variable, str(tmp_path / variable))
    folder = tmp_path / "a much longer name for the folder"
    folder.mkdir()
    monkeypatch.setattr(native_build.tempfile, "tempdir", str(folder))
    monkeypatch.setenv("CFLAGS", "-O0 -DNDEBUG")
    monkeypatch.setenv("CPATH", "/nowhere")
    installed = installed_library(BINARIES, files, "QubeServo2", host).read_bytes()
    assert build_library(files, "QubeServo2", host) == installed
    assert any((tmp_path / "ZIG_GLOBAL_CACHE_DIR").iterdir())


def test_order_of_the_files_does_not_matter():
    two = TINY | {"other.c": b"int other(void);\nint other(void)\n{\n    return 8;\n}\n"}
    host = host_platform()
    assert build_library(two, "tiny", host) == build_library(dict(reversed(two.items())), "tiny", host)


def test_binary_tells_no_path_of_the_machine(name):
    host = host_platform()
    text = (BINARIES / host.name / f"{name}{host.suffix}").read_bytes()
    for part in (b"/tmp/", b"/home/", b"/root/", b"/work/", b"native-build-"):
        assert part not in text


def test_installing_builds_once_and_again_after_a_change(tmp_path, monkeypatch):
    host = host_platform()
    path = install_library(tmp_path, TINY, "tiny", host)
    assert path == tmp_path / host.name / f"tiny{host.suffix}" == installed_library(tmp_path, TINY, "tiny", host)
    assert sorted(file.suffix for file in path.parent.iterdir()) == sorted([".sha256", host.suffix])
    built = []
    monkeypatch.setattr(native_build, "build_library", lambda *_: built.append(1) or b"binary")
    install_library(tmp_path, TINY, "tiny", host)
    assert not built
    changed = {"tiny.c": TINY["tiny.c"].replace(b"7", b"8")}
    with pytest.raises(BuildError, match=f"{host.name}/tiny{host.suffix} is older than its sources"):
        installed_library(tmp_path, changed, "tiny", host)
    assert install_library(tmp_path, changed, "tiny", host).read_bytes() == b"binary"
    assert built == [1]


def test_binary_that_is_not_there_is_called_missing(tmp_path):
    with pytest.raises(BuildError, match=r"tiny.* is missing; installing the package again builds it"):
        installed_library(tmp_path, TINY, "tiny", host_platform())


def test_other_compiler_flags_make_a_binary_outdated(tmp_path, monkeypatch):
    install_library(tmp_path, TINY, "tiny", host_platform())
    monkeypatch.setattr(native_build, "FLAGS", (*FLAGS, "-O1"))
    with pytest.raises(BuildError, match="older than its sources"):
        installed_library(tmp_path, TINY, "tiny", host_platform())


# Cores without side effects


@pytest.fixture(scope="module")
def symbols(native_units, tmp_path_factory):
    """Return {name: section} of the symbols of a C source, compiled for 64-bit Linux, as `nm` tells them."""
    nm = shutil.which("nm")
    if nm is None:
        pytest.skip("needs nm")
    folder = tmp_path_factory.mktemp("objects")
    units = (*native_units.values(), REGULATOR)
    files = {file: text for unit in units for file, text in unit_files(unit).items()} | COUNTER
    for file, text in files.items():
        (folder / file).write_bytes(text)

    @cache
    def of(source):
        target = PLATFORMS["linux64"].targets[0]
        command = [
            *zig_command(),
            "-target",
            target,
            *FLAGS,
            "-fPIC",
            "-isystem",
            ".",
            "-c",
            source,
            "-o",
            f"{source}.o",
        ]
        subprocess.run(command, cwd=folder, check=True)
        listing = [nm, "--format=sysv", f"{source}.o"]
        listing = subprocess.run(listing, cwd=folder, check=True, capture_output=True, text=True).stdout
        rows = [[part.strip() for part in line.split("|")] for line in listing.splitlines()]
        return {row[0]: row[-1] for row in rows if len(row) == 7}

    return of


@pytest.mark.parametrize("core", CORES)
def test_core_calls_nothing_but_mathematics_and_copies(core, symbols):
    undefined = {name for name, section in symbols(core).items() if section == "*UND*"}
    assert undefined - PURE - MEMORY == set()
    assert undefined & {"sin", "sincos", "exp"}


@pytest.mark.parametrize("source", [*CORES, *ADAPTERS])
def test_no_variable_outlives_a_call(source, symbols):
    """Neither initialized nor zeroed; constants with addresses in them are read-only once they are loaded."""
    sections = symbols(source)
    assert {name: section for name, section in sections.items() if WRITABLE.match(section)} == {}
    assert len(sections) > 1


def test_a_variable_that_outlives_a_call_would_be_seen(symbols):
    sections = {name.split(".")[-1]: section for name, section in symbols("counter.c").items()}
    assert WRITABLE.match(sections["zeroed"])
    assert WRITABLE.match(sections["counted"])
    assert not WRITABLE.match(sections["names"])


# What the compiler refuses


def test_error_of_the_compiler_is_reported():
    with pytest.raises(BuildError) as caught:
        build_library({"wrong.c": b"int wrong(void)\n{\n    return undeclared;\n}\n"}, "wrong", host_platform())
    for part in ("compiling wrong", host_platform().targets[0], "wrong.c:3", "undeclared"):
        assert part in str(caught.value)


@pytest.mark.parametrize(
    "warning", [b"long n = 1; int m = n; return m;", b"int m; { int m = 1; (void)m; } m = 2; return m;"]
)
def test_warnings_are_errors(warning):
    with pytest.raises(BuildError, match="error"):
        build_library({"warn.c": b"int warn(void);\nint warn(void)\n{\n" + warning + b"\n}\n"}, "warn", host_platform())


def test_missing_compiler_is_reported(monkeypatch):
    monkeypatch.setattr(native_build, "find_spec", lambda _: None)
    with pytest.raises(BuildError, match="needs the package ziglang"):
        zig_command()


def altered(unit, change):
    """The unit with variables for which `change` gives something else; None removes one."""
    interface = unit.interface
    kept = [v for v in map(change, interface.variables) if v is not None]
    return replace(
        unit,
        interface=Interface(
            interface.name, "", tuple(kept), interface.step_size, interface.stop_time, interface.variable_step
        ),
    )


@pytest.mark.parametrize(
    ("name", "change", "part"),
    [
        ("QubeServo2", lambda v: replace(v, name="mass") if v.name == "m_p" else v, "mass"),
        ("QubeServo2", lambda v: replace(v, type="Integer", start=1, min=None) if v.name == "m_p" else v, "m_p_fits"),
        (
            "QubeServo2",
            lambda v: replace(v, type="Real", start=1.0) if v.name == "noise_seed" else v,
            "noise_seed_fits",
        ),
        ("IhcController", lambda v: None if v.name == "k_lin_4" else v, "k_lin_fits"),
        ("IhcController", lambda v: replace(v, causality="input") if v.name == "smc_rho" else v, "smc_rho"),
    ],
    ids=["name", "type", "number for a count", "length of an array", "causality"],
)
def test_struct_that_differs_from_the_interface_does_not_compile(name, change, part, native_units):
    unit = native_units[name]

    def compiled(with_table_of):
        """The one source that includes the table; what it calls may be missing in a shared library."""
        files = unit_files(with_table_of)
        kept = {f: text for f, text in files.items() if not f.endswith(".c") or f == f"{unit.stem}_fmu.c"}
        return build_library(kept, name, PLATFORMS["linux64"])

    assert compiled(unit)
    with pytest.raises(BuildError, match=part):
        compiled(altered(unit, change))


# Other machines


def test_library_for_arm_linux_is_an_elf_file_for_that_machine(native_units):
    binary = build_library(unit_files(native_units["QubeServo2"]), "QubeServo2", PLATFORMS["aarch64-linux"])
    assert binary[:6] == b"\x7fELF\x02\x01"
    assert struct.unpack_from("<HH", binary, 16) == (3, 183)  # shared object, EM_AARCH64


def slices(binary):
    """Return {CPU type: thin file} of a universal file, and check how it is put together."""
    magic, count = struct.unpack_from(">II", binary)
    assert magic == 0xCAFEBABE
    machines = {}
    for i in range(count):
        cpu, subtype, offset, size, alignment = struct.unpack_from(">IIIII", binary, 8 + 20 * i)
        assert offset % (1 << alignment) == 0
        assert offset + size <= len(binary)
        machines[cpu, subtype] = binary[offset : offset + size]
    return machines


X86, ARM = (0x01000007, 3), (0x0100000C, 0)


@pytest.mark.parametrize("sizes", [(16, 20000), (16384, 16385), (100, 100)])
def test_universal_file_gives_its_slices_back(sizes):
    parts = [
        struct.pack("<III", 0xFEEDFACF, *cpu).ljust(size, bytes([i + 1]))
        for i, (cpu, size) in enumerate(zip((X86, ARM), sizes, strict=True))
    ]
    assert slices(universal(parts)) == dict(zip((X86, ARM), parts, strict=True))


def test_library_for_macs_holds_both_machines():
    machines = slices(build_library(TINY, "tiny", PLATFORMS["darwin64"]))
    assert set(machines) == {X86, ARM}
    for part in machines.values():
        assert struct.unpack_from("<I", part) == (0xFEEDFACF,)
        assert struct.unpack_from("<I", part, 12) == (6,)  # MH_DYLIB
        assert b"@rpath/tiny.dylib\0" in part
