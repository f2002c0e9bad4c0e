"""SSP files as scenarios and scenarios as SSP files: the same runs; others' files; hostile ones."""

import zipfile
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.fmu_files import start_values_of
from cosim.scenario import load_scenario
from cosim.scenario_run import run_scenario
from cosim.ssp import DESCRIPTION, SSV
from fmu_export.ssp import SSC, SSD
from tests.cosim.command import ended, sentence
from tests.cosim.linear_fmu import linear_fmu

HEAD = (
    '<ssd:SystemStructureDescription xmlns:ssd="http://ssp-standard.org/SSP1/SystemStructureDescription" '
    'xmlns:ssc="http://ssp-standard.org/SSP1/SystemStructureCommon" '
    'xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" name="others" version="1.0">'
)
SET = f'<ssv:ParameterSet xmlns:ssv="{SSV}" version="1.0" name="s">{{}}</ssv:ParameterSet>'
TYPE = "application/x-fmu-sharedlibrary"
TANK = f'<ssd:Component name="my tank" type="{TYPE}" source="resources/a%20tank.fmu">{{}}</ssd:Component>'
HEATER = f'<ssd:Component name="controller" type="{TYPE}" source="resources/deep/heater.fmu"/>'
BINDING = "<ssd:ParameterBindings><ssd:ParameterBinding {}>{}</ssd:ParameterBinding></ssd:ParameterBindings>"
WIRE = '<ssd:Connection startElement="{}" startConnector="{}" endElement="{}" endConnector="{}"{}'
MEASURED = WIRE.format("my tank", "T", "controller", "T", "{}")
HEAT = WIRE.format("controller", "heat", "my tank", "heat", "/>")


def parameter(name, kind, value):
    return (
        f'<ssv:Parameters><ssv:Parameter name="{name}"><ssv:{kind} value="{value}"/></ssv:Parameter></ssv:Parameters>'
    )


@pytest.fixture(scope="session")
def heated(tmp_path_factory):
    """FMUs of a tank in degrees Celsius and of a heater's controller in kelvin."""
    folder = tmp_path_factory.mktemp("heated")
    linear_fmu(
        folder / "tank.fmu",
        [("heat", "W"), ("loss", "W")],
        [("T", "degC")],
        [[-0.2]],
        [[0.05, 0.05]],
        [[1.0]],
        x0=(40,),
    )
    linear_fmu(
        folder / "heater.fmu", [("T", "K"), ("more", "W")], [("heat", "W")], D=[[-0.01, 1.0]], start={"more": 2.0}
    )
    return folder


@pytest.fixture
def others(heated, tmp_path):
    """Write an SSP file as another tool might: elements, connections, what stands around them, more files."""

    def write(elements=(), connections=(), around="", more=(), description=None):
        path = tmp_path / "others.ssp"
        system = f'<ssd:System name="s">{around}<ssd:Elements>{"".join(elements)}</ssd:Elements>'
        system += f"<ssd:Connections>{''.join(connections)}</ssd:Connections></ssd:System>"
        experiment = '<ssd:DefaultExperiment startTime="0" stopTime="0.5"/>'
        with zipfile.ZipFile(path, "w") as archive:
            text = f"{HEAD}{system}{experiment}</ssd:SystemStructureDescription>"
            archive.writestr(DESCRIPTION, text if description is None else description)
            archive.write(heated / "tank.fmu", "resources/a tank.fmu")
            archive.write(heated / "heater.fmu", "resources/deep/heater.fmu")
            for name, content in more:
                archive.writestr(name, content)
        return path

    return write


def run(path, **changes):
    scenario, folder = load_scenario(str(path))
    return run_scenario(
        scenario.changed({name.replace("__", "."): value for name, value in changes.items()}), folder, folder
    )


@pytest.mark.parametrize("name", ["tilt", "tilt_ideal", "swing_up"])
def test_a_scenario_written_as_ssp_runs_to_the_last_bit_as_before(fmus, tmp_path, name, same):
    done = ended("ssp", name, "--set", "run.duration=0.5", "--fmus", fmus, "-o", "x.ssp", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    given, folder = load_scenario(name)
    expected = run_scenario(given.changed({"run.duration": 0.5}), fmus, folder)
    found = run(tmp_path / "x.ssp")
    same(found, expected, metadata=False)
    assert "evaluation" not in found.metadata  # it is the pendulum all the same
    assert found.metadata["scenario"]["run"]["duration"] == 0.5


def test_the_exported_ssp_runs(fmus, tmp_path):
    done = ended("run", fmus / "QubeWithController.ssp", "--set", "run.duration=0.2", "--no-plot", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "results" / "QubeWithController.csv").is_file()


def test_the_file_of_another_tool_runs_with_its_parameters_units_and_names(others):
    values = BINDING.format(
        "", f"<ssd:ParameterValues>{SET.format(parameter('x0[1]', 'Real', '50'))}</ssd:ParameterValues>"
    )
    system = BINDING.format('source="resources/s.ssv" type="application/x-ssp-parameter-set" prefix="my tank."', "")
    path = others(
        [TANK.format(values), HEATER],
        [
            MEASURED.format("/>"),
            HEAT,
            '<ssd:Connection startConnector="outside" endElement="my tank" endConnector="loss"/>',
        ],
        system,
        [("resources/s.ssv", SET.format(parameter("loss", "Real", "-1.5")))],
    )
    scenario, _ = load_scenario(str(path))
    assert (scenario.run.step, scenario.run.duration, scenario.description) == (0.01, 0.5, "others")
    result = run(path)
    assert result.metadata["start_values"] == {"controller": {"more": 2.0}, "my_tank": {"x0[1]": 50.0, "loss": -1.5}}
    assert result.metadata["conversions"] == {"controller.T": [1.0, 273.15]}  # degC to K, as the standard has it
    np.testing.assert_allclose(
        result["controller.heat"][1:], -0.01 * (result["my_tank.T"][:-1] + 273.15) + 2.0, rtol=1e-14
    )


def test_a_connections_own_transformation_goes_before_its_units(others):
    own = '><ssc:LinearTransformation factor="2" offset="1"/></ssd:Connection>'
    result = run(others([TANK.format(""), HEATER], [MEASURED.format(own), HEAT]))
    assert result.metadata["conversions"] == {"controller.T": [2.0, 1.0]}
    with pytest.raises(UserError, match="must join equal units, found degC and K"):
        run(others([TANK.format(""), HEATER], [MEASURED.format(' suppressUnitConversion="true"/>'), HEAT]))


def test_wires_that_convert_are_written(heated, tmp_path):
    text = """
    wires = [{ source = "plant.T", target = "controller.T", factor = 1.0, offset = 273.15 }, "controller.heat -> plant.heat"]
    plant = { fmu = "tank.fmu", start = { "x0[1]" = 30.0 } }
    controller = { fmu = "heater.fmu", start = { more = 1.0 } }
    run.duration = 0.2
    signals = [{ input = "plant.loss", kind = "step", value = 1.0 }]
    """
    (tmp_path / "tank.toml").write_text(text, encoding="utf-8")
    done = ended("ssp", "tank.toml", "--fmus", heated, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "plant.loss keeps its start value" in done.stderr
    with zipfile.ZipFile(tmp_path / "tank.ssp") as archive:
        root = ET.fromstring(archive.read(DESCRIPTION))
    found = root.find(f".//{{{SSD}}}Connection/{{{SSC}}}LinearTransformation")
    assert found is not None
    assert found.attrib == {"factor": "1.0", "offset": "273.15"}
    scenario, folder = load_scenario(str(tmp_path / "tank.toml"))
    expected = run_scenario(scenario.changed({"signals": ()}), heated, folder)
    np.testing.assert_array_equal(run(tmp_path / "tank.ssp")["plant.T"], expected["plant.T"])
    assert start_values_of(heated / "tank.fmu")["x0[1]"] == 40.0


BOMB = '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>'


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"description": "<a/>"}, "must be a SystemStructureDescription of SSP 1.0"),
        ({"description": "no xml"}, "is not a system description"),
        ({"description": f"{BOMB}{HEAD}&x;</ssd:SystemStructureDescription>"}, "a document type has no place in it"),
        ({}, "components need different names, found none"),
        ({"elements": ['<ssd:System name="inner"/>']}, "the element 'inner' must be a component, found System"),
        ({"elements": [TANK.format(""), TANK.format("")]}, "components need different names"),
        ({"elements": [f'<ssd:Component name="a" type="{TYPE}" source="../a.fmu"/>']}, "its file inside the archive"),
        (
            {"elements": [f'<ssd:Component name="a" type="{TYPE}" source="/etc/passwd"/>']},
            "its file inside the archive",
        ),
        (
            {"elements": [f'<ssd:Component name="a" type="{TYPE}" source="%2e%2e/a.fmu"/>']},
            "its file inside the archive",
        ),
        (
            {"elements": [f'<ssd:Component name="a" type="{TYPE}" source="http://x/a.fmu"/>']},
            "its file inside the archive",
        ),
        ({"elements": ['<ssd:Component name="a" type="text/plain" source="x"/>']}, "must be an FMU, found text/plain"),
        (
            {"elements": [f'<ssd:Component name="a" type="{TYPE}" source="a.fmu" implementation="Both"/>']},
            "the implementation of the component 'a' must be any, CoSimulation or ModelExchange, found 'Both'",
        ),
        ({"elements": [TANK.format("")], "connections": [HEAT]}, "must end at components, found 'controller'.'heat'"),
        (
            {
                "elements": [TANK.format(""), HEATER],
                "connections": [MEASURED.format("><ssc:IntegerMappingTransformation/></ssd:Connection>")],
            },
            "has a IntegerMappingTransformation",
        ),
        (
            {"elements": [TANK.format(BINDING.format("", "<ssd:ParameterMapping/>"))]},
            "the parameters of 'my tank' are mapped",
        ),
        (
            {"elements": [TANK.format(BINDING.format('source="../s.ssv"', ""))]},
            "a set of parameters must have its file inside the archive",
        ),
        (
            {
                "elements": [TANK.format(BINDING.format('source="resources/s.ssv"', ""))],
                "more": [("resources/s.ssv", SET.format(parameter("x0[1]", "Binary", "00")))],
            },
            r"the parameter 'x0\[1\]' must be a Real, .* found Binary",
        ),
        (
            {
                "elements": [TANK.format(BINDING.format('source="resources/s.ssv"', ""))],
                "more": [("resources/s.ssv", SET.format(parameter("x0[1]", "Real", "hot")))],
            },
            r"the parameter 'x0\[1\]' must be a number, found 'hot'",
        ),
        ({"elements": [TANK.format("")], "more": [("../out.txt", "x")]}, "must have entries inside its folder"),
    ],
)
def test_what_cannot_be_taken_is_refused_in_a_sentence(others, tmp_path, given, problem):
    path = others(**given)
    with pytest.raises(UserError, match=problem) as refusal:
        run(path)
    assert str(path) in str(refusal.value)
    assert sentence(ended("run", path, cwd=tmp_path)).startswith(str(path))


def test_what_is_no_archive_is_named(tmp_path):
    with pytest.raises(UserError, match=r"none\.ssp cannot be read: No such file"):
        load_scenario(str(tmp_path / "none.ssp"))
    (tmp_path / "text.ssp").write_text("text", encoding="utf-8")
    with pytest.raises(UserError, match="is not an SSP file: it is not a zip file"):
        load_scenario(str(tmp_path / "text.ssp"))
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as archive:
        archive.writestr("x", "y")
    with pytest.raises(UserError, match=r"it has no SystemStructure\.ssd"):
        load_scenario(str(tmp_path / "empty.ssp"))
