"""Where native FMUs find their start values, in any folder, and how they refuse a file that is none of theirs."""

import shutil
import struct

import pytest

from tests.fmu_export.calls import INFINITY, NAN, declined
from tests.fmu_export.conftest import CONTROLLER, PLANT


@pytest.fixture
def elsewhere(native_folders, tmp_path):
    """Copy the resources of an FMU into a folder of any name."""

    def copy(name, folder):
        target = tmp_path / folder / "resources"
        shutil.copytree(native_folders[name] / "resources", target)
        return target

    return copy


FORMS = {
    "URI": lambda path: path.as_uri(),
    "URI/": lambda path: path.as_uri() + "/",
    "one slash": lambda path: path.as_uri().replace("file://", "file:"),
    "localhost": lambda path: path.as_uri().replace("file://", "file://localhost"),
    "only escapes": lambda path: "file:///" + "".join(f"%{byte:02x}" for byte in str(path)[1:].encode()),
    "plain": str,
    "plain/": lambda path: f"{path}/",
}


@pytest.mark.parametrize("folder", ["plain", "with spaces in it", "100%", "a%20b", "Grüße, 世界", "#?&+;=@[]'$!"])
@pytest.mark.parametrize("form", FORMS)
def test_resources_are_found_in_any_folder(form, folder, name, elsewhere, native):
    location = FORMS[form](elsewhere(name, folder))
    assert native(name, location=location).initialize().outputs() == native(name).initialize().outputs()


def test_missing_resource_location_is_refused(name, native):
    message = declined(native(name, location=None))
    assert "resource location" in message
    assert "none" in message


@pytest.mark.parametrize(
    "location", ["file:///nowhere/100%25", "/nowhere/100%", "http://example.org/x", "%s%n%s%n", "."]
)
def test_a_location_without_start_values_is_refused_with_the_path(location, name, native):
    message = declined(native(name, location=location))
    assert "cannot read" in message
    path = location.replace("file://", "").replace("%25", "%")
    assert f"{path}/start_values.bin" in message


def test_a_path_that_is_too_long_is_refused(name, native):
    assert "resource location" in declined(native(name, location="file:///" + "x" * 5000))


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_long_path_is_reported_in_valid_text(native):
    assert "/é" in declined(native(PLANT, location="/" + "é" * 200))


HEAD = 80  # bytes before the numbers

DAMAGES = {
    "empty": lambda data: b"",
    "head only": lambda data: data[:HEAD],
    "half of the head": lambda data: data[:40],
    "one byte short": lambda data: data[:-1],
    "one number short": lambda data: data[:-8],
    "one byte more": lambda data: data + b"\0",
    "another beginning": lambda data: b"FMUstars" + data[8:],
    "another format": lambda data: data[:8] + b"\1" + data[9:],
    "another count": lambda data: data[:12] + b"\1\0\0\0" + data[16:],
    "GUID without an end": lambda data: data[:16] + b"x" * 64 + data[HEAD:],
}


def parts(data):
    """Return what is before the names, and the names, each with a zero behind it."""
    (count,) = struct.unpack_from("<I", data, 12)
    return data[: HEAD + 8 * count], data[HEAD + 8 * count + 4 :]


def with_names(data, names, size=None):
    """Return start values with other names."""
    return parts(data)[0] + struct.pack("<I", len(names) if size is None else size) + names


def renamed(data, name):
    """Return start values with another first name."""
    return with_names(data, name + b"\0" + parts(data)[1].split(b"\0", 1)[1])


DAMAGES |= {
    "no names": lambda data: with_names(data, b""),
    "names without an end": lambda data: with_names(data, parts(data)[1][:-1]),
    "a name beyond the end": lambda data: with_names(data, parts(data)[1][:-1] + b"x"),
    "a name too many": lambda data: renamed(data, b"a\0b"),
    "a name too few": lambda data: with_names(data, parts(data)[1].split(b"\0", 1)[1]),
    "more names than bytes": lambda data: with_names(data, parts(data)[1], len(parts(data)[1]) + 1),
    "fewer names than bytes": lambda data: with_names(data, parts(data)[1], len(parts(data)[1]) - 1),
    "no end of names": lambda data: with_names(data, parts(data)[1], 2**32 - 1),
    "a name too long": lambda data: renamed(data, b"x" * 801),
    "a line feed": lambda data: renamed(data, b"a\nb"),
    "DEL": lambda data: renamed(data, b"a\x7f"),
    "a control character of two bytes": lambda data: renamed(data, b"a\xc2\x85"),
    "half a character": lambda data: renamed(data, b"a\xc3"),
    "half a character of three bytes": lambda data: renamed(data, b"\xe2\x82"),
    "the rest of a character": lambda data: renamed(data, b"\x9f"),
    "an overlong zero": lambda data: renamed(data, b"\xc0\x80"),
    "an overlong slash": lambda data: renamed(data, b"\xe0\x80\xaf"),
    "a surrogate": lambda data: renamed(data, b"\xed\xa0\x80"),
    "beyond Unicode": lambda data: renamed(data, b"\xf4\x90\x80\x80"),
    "no lead byte": lambda data: renamed(data, b"\xf8\x88\x80\x80"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_start_values_are_refused(damage, name, elsewhere, native):
    folder = elsewhere(name, "damaged")
    file = folder / "start_values.bin"
    file.write_bytes(DAMAGES[damage](file.read_bytes()))
    message = declined(native(name, location=folder.as_uri()))
    assert "this FMU's start values must be in its resources" in message


@pytest.mark.parametrize("text", ["Stoß 50 %s \\ € 𝛿", "x" * 800, "\u00a0"])
def test_messages_have_the_names_of_the_file(text, native, elsewhere):
    folder = elsewhere(PLANT, "renamed")
    data = (folder / "start_values.bin").read_bytes()
    (folder / "start_values.bin").write_bytes(renamed(data, text.encode()))
    instance = native(PLANT, location=folder.as_uri())
    assert instance.refused(*instance.setting(voltage=NAN)) == f"{text} must be finite, found nan at t = 0 s"


def test_start_values_of_the_other_unit_are_refused(native, elsewhere):
    message = declined(native(PLANT, location=elsewhere(CONTROLLER, "other").as_uri()))
    assert "this FMU's start values must be in its resources" in message


def test_a_folder_in_place_of_the_file_is_refused(name, native, elsewhere):
    folder = elsewhere(name, "folder")
    (folder / "start_values.bin").unlink()
    (folder / "start_values.bin").mkdir()
    assert "start_values.bin" in declined(native(name, location=folder.as_uri()))


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        ("voltage", NAN),
        ("m_p", INFINITY),
        ("solver_step", 1.0),
        ("encoder_counts", -1.0),
        ("motor_model", 3.0),
        ("back_emf", 2.0),
        ("noise_seed", 1e300),
        ("encoder_counts", 2.0**31),
        ("noise_seed", 1.5),
        ("back_emf", 0.5),
    ],
)
def test_a_start_value_out_of_range_is_refused(variable, value, native, elsewhere):
    folder = elsewhere(PLANT, "out of range")
    data = bytearray((folder / "start_values.bin").read_bytes())
    struct.pack_into("<d", data, HEAD + 8 * native(PLANT).reference(variable), value)
    (folder / "start_values.bin").write_bytes(data)
    assert f"the start value of {variable} must" in declined(native(PLANT, location=folder.as_uri()))
