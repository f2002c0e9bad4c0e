"""The SSP file: valid, typed as the FMUs are, with what OMSimulator wants, and simulated by FMPy with all defaults."""

import zipfile
from xml.etree import ElementTree as ET

import pytest
from fmpy import read_model_description, simulate_fmu
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd

from cosim.pendulum_export import Kind, export_units
from fmu_export.errors import UserError
from fmu_export.ssp import OMS, SSC, SSD
from ihc_fmu.pendulum.start_values import default_design

UNITS = {"controller": "IhcController", "plant": "QubeServo2"}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Export the pair, natively, with the sample time [s] given."""

    def make(sample_time=1e-3, outputs=None, kind=Kind.native):
        changes = {"controller": {"sample_time": sample_time}, "plant": {"delta_0": 0.1}}
        folder = tmp_path_factory.mktemp("ssp")
        export_units(default_design(), output=folder, changes=changes, kind=kind, outputs=outputs)
        return folder

    return make


@pytest.fixture(scope="module")
def shipped(exported):
    return exported()


def structure(folder):
    with zipfile.ZipFile(folder / "QubeWithController.ssp") as archive:
        return ET.fromstring(archive.read("SystemStructure.ssd"))


def test_connectors_have_the_types_and_units_of_the_fmus(shipped):
    root = structure(shipped)
    kinds = set()
    for component in root.iter(f"{{{SSD}}}Component"):
        fmu = read_model_description(str(shipped / f"{UNITS[component.get('name', '')]}.fmu"))
        variables = {v.name: v for v in fmu.modelVariables}
        connectors = list(component.iter(f"{{{SSD}}}Connector"))
        outputs = {v.name for v in variables.values() if v.causality == "output"}
        assert {c.get("name") for c in connectors if c.get("kind") == "output"} == outputs
        for connector in connectors:
            variable, declared = variables[connector.get("name", "")], connector[0]
            kinds.add(variable.type)
            assert (
                declared.tag == f"{{{SSC}}}{variable.type.replace('Enumeration', 'Integer')}"
            )  # libcosim refuses these
            assert declared.get("unit") == variable.unit
    assert kinds == {"Real", "Enumeration"}


@pytest.mark.parametrize("sample_time", [1e-3, 2.5e-3, 3e-4])
def test_structure_is_valid_and_tells_omsimulator_the_step_of_the_controller(sample_time, exported, shipped):
    folder = shipped if sample_time == 1e-3 else exported(sample_time)
    read_ssd(str(folder / "QubeWithController.ssp"), validate=True)
    (annotation,) = structure(folder).iterfind(f"{{{SSD}}}System/{{{SSD}}}Annotations/{{{SSC}}}Annotation")
    assert annotation.get("type") == "org.openmodelica"
    (master,) = annotation.iterfind(f"{{{OMS}}}Annotations/{{{OMS}}}SimulationInformation/{{{OMS}}}FixedStepMaster")
    assert master.attrib == {
        "description": "oms-ma",
        "stepSize": repr(sample_time),
        "absoluteTolerance": "1e-4",
        "relativeTolerance": "1e-4",
    }
    if sample_time != 1e-3:  # the default step fits
        assert len(simulate_fmu(str(folder / "IhcController.fmu"))) > 300


@pytest.mark.parametrize("kind", Kind)
def test_fmpy_simulates_with_all_defaults(kind, exported, shipped):
    folder = shipped if kind is Kind.native else exported(kind=kind)
    rows = simulate_ssp(str(folder / "QubeWithController.ssp"))
    assert len(rows) == 100
    assert set(rows["controller.mode"]) >= {2, 3}
    for name in UNITS.values():
        assert len(simulate_fmu(str(folder / f"{name}.fmu"))) == 1001
        assert len(simulate_fmu(str(folder / f"{name}.fmu"), stop_time=16.0)) == 1001  # steps of 0.016 s


def test_chosen_outputs_are_the_only_ones_and_wires_need_theirs(exported):
    wired = ["controller.voltage", "plant.theta_encoder", "plant.delta_encoder"]
    folder = exported(outputs=wired)
    connectors = structure(folder).iter(f"{{{SSD}}}Connector")
    assert [c.get("name") for c in connectors if c.get("kind") == "output"] == [w.split(".")[1] for w in wired]
    for outputs, message in (
        (wired[:2], "--outputs must name plant.delta_encoder, which a wire begins at"),
        ([*wired, "motor.voltage"], "--outputs must name plant.VARIABLE or controller.VARIABLE, found 'motor.voltage'"),
        ([*wired, "plant.thet"], "QubeServo2 has no output named 'thet'; did you mean theta"),
    ):
        with pytest.raises(UserError, match=message):
            exported(outputs=outputs)
