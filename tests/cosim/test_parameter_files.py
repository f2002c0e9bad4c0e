"""Parameter sets in files: exact, refused with the file and the key, and in the place of a set's name."""

import threading
from dataclasses import replace

import pytest

from cosim import parameter_files
from cosim.errors import UserError
from cosim.fmu_files import describe
from cosim.pendulum_export import export_units
from cosim.scenario import Scenario, load_scenario
from cosim.scenario_run import run_scenario
from cosim.scenario_system import build_system
from cosim.studies.engine import Job, run_all
from cosim.studies.journal import Journal
from plant_fmu.interface import start_values
from plant_fmu.parameters import PARAMETER_SETS, ParameterSet

IDENT = PARAMETER_SETS["ident"]
MINE = ParameterSet(
    "mine",
    replace(IDENT.parameters, D_r=(0.1 + 0.2) * 1e-3, T_r=1e-4 / 3),
    'measured, "twice"\non Monday',
    "",
    back_emf=False,
)


@pytest.fixture
def file(tmp_path):
    """Write the set MINE with lines of the file replaced by key; None removes one; return the path."""

    def write(name="mine.toml", **changes):
        path = tmp_path / name
        parameter_files.save(path, MINE)
        lines = path.read_text(encoding="utf-8").splitlines()
        lines = [line for line in lines if line.partition(" ")[0] not in changes]
        lines += [f"{key} = {text}" for key, text in changes.items() if text is not None]
        path.write_text("\n".join(lines), encoding="utf-8")
        return path

    return write


def plant_start(system):
    return dict(next(c.start for c in system.components if c.name == "plant"))


@pytest.mark.parametrize("chosen", [*PARAMETER_SETS.values(), MINE], ids=lambda s: s.name)
def test_a_saved_set_is_loaded_to_the_last_bit(tmp_path, chosen):
    path = tmp_path / "folder" / f"{chosen.name}.toml"
    parameter_files.save(path, chosen)
    found = parameter_files.load(path)
    assert (found.name, found.parameters) == (chosen.name, chosen.parameters)
    assert (found.source, found.back_emf) == (chosen.source, chosen.back_emf)
    assert found.use == f"read from {path.name}"


def test_dry_friction_may_be_missing_and_whole_numbers_are_numbers(file):
    assert parameter_files.load(file(T_r=None)).parameters == replace(MINE.parameters, T_r=0.0)
    found = parameter_files.load(file(R_m="8")).parameters.R_m
    assert (found, type(found)) == (8.0, float)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"D_rr": "1.0"}, "there is no entry D_rr; did you mean D_r?"),
        ({"m_p": None}, "m_p is required"),
        ({"source": None, "k_m": None}, "source is required"),
        ({"back_emf": None}, "back_emf is required"),
        ({"m_p": "'heavy'"}, "m_p must be a number, found 'heavy'"),
        ({"m_p": "true"}, "m_p must be a number, found true"),
        ({"m_p": "0.0"}, "m_p must be finite and positive, found 0.0 kg"),
        ({"L_p": "nan"}, "L_p must be finite and positive, found nan m"),
        ({"J_p": "inf"}, "J_p must be finite and positive, found inf kg.m2"),
        ({"T_r": "-1e-9"}, "T_r must be finite and non-negative, found -1e-09 N.m"),
        ({"back_emf": "1"}, "back_emf must be true or false, found 1"),
        ({"source": "3"}, "source must be a text, found 3"),
    ],
)
def test_a_wrong_file_is_one_sentence_with_file_key_rule_and_value(file, changes, problem):
    with pytest.raises(UserError) as refusal:
        parameter_files.load(file(**changes))
    sentence = str(refusal.value)
    assert f"mine.toml: {problem}" in sentence
    assert "\n" not in sentence


def test_what_is_no_file_of_numbers_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"parameter file .*nowhere\.toml does not exist"):
        parameter_files.load(tmp_path / "nowhere.toml")
    (tmp_path / "text.toml").write_text("m_p 3", encoding="utf-8")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    for name, cause in (("text", "is not TOML"), ("bytes", "must be text in UTF-8, found another byte at 0")):
        with pytest.raises(UserError, match=rf"{name}\.toml {cause}"):
            parameter_files.load(tmp_path / f"{name}.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(UserError, match="cannot be read: Is a directory"):
        parameter_files.load(tmp_path / "folder.toml")
    with pytest.raises(UserError, match=r"named \*\.toml, found .*mine\.json"):
        parameter_files.save(tmp_path / "mine.json", MINE)


def test_a_name_is_that_of_a_set_or_a_file_in_the_folder_or_the_current_one(file, tmp_path, monkeypatch):
    assert parameter_files.named_set("hcs") is PARAMETER_SETS["hcs"]
    with pytest.raises(UserError, match=r"one of matrices, .*, swapped or a file \*\.toml, found 'idnt'"):
        parameter_files.named_set("idnt")
    path = file()
    assert parameter_files.named_set("mine.toml", tmp_path) == parameter_files.load(path)
    assert parameter_files.named_set(str(path), tmp_path / "elsewhere") == parameter_files.load(path)
    with pytest.raises(UserError, match=r"parameter file mine\.toml does not exist"):
        parameter_files.named_set("mine.toml", tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    assert parameter_files.named_set("mine.toml", tmp_path / "elsewhere") == parameter_files.load(path)
    (tmp_path / "beside").mkdir()
    parameter_files.save(tmp_path / "beside" / "mine.toml", IDENT)
    assert parameter_files.named_set("mine.toml", tmp_path / "beside").parameters == IDENT.parameters


# In the place of a set's name


def test_a_scenario_takes_the_file_beside_it(file, fmus, tmp_path):
    file()
    (tmp_path / "run.toml").write_text('[plant]\nparameters = "mine.toml"', encoding="utf-8")
    scenario, folder = load_scenario(str(tmp_path / "run.toml"))
    start = plant_start(build_system(scenario, fmus, folder))
    assert start == start_values(MINE)
    assert (start["T_r"], start["back_emf"]) == (MINE.parameters.T_r, False)
    assert load_scenario(str(tmp_path / "run.toml"))[0].to_toml().count("mine.toml") == 1


def test_a_scenario_with_a_file_that_does_not_exist_is_refused(fmus, tmp_path):
    scenario = Scenario().changed({"plant.parameters": "nowhere.toml"})
    with pytest.raises(UserError, match=r"parameter file nowhere\.toml does not exist"):
        build_system(scenario, fmus, tmp_path)


def test_the_same_numbers_from_a_file_are_the_same_run(fmus, same, tmp_path):
    parameter_files.save(tmp_path / "copy.toml", PARAMETER_SETS["hcs"])
    tilt, _ = load_scenario("tilt")
    runs = [
        run_scenario(tilt.changed({"run.duration": 0.1, "plant.parameters": name}), fmus, tmp_path)
        for name in ("hcs", "copy.toml")
    ]
    same(*runs, metadata=False)


def test_an_export_takes_files_for_plant_and_nominal_model(file, design, tmp_path):
    path = str(file())
    plant, controller, _ = export_units(design, path, path, tmp_path / "fmus")
    starts = {v.name: v.start for u in (plant, controller) for v in describe(u).modelVariables}
    assert float(str(starts["T_r"])) == MINE.parameters.T_r
    assert {float(str(starts[name])) for name in ("D_r", "nominal_arm_damping")} == {MINE.parameters.D_r}
    assert starts["back_emf"] == "false"


def test_an_export_refuses_before_it_writes(design, tmp_path):
    with pytest.raises(UserError, match=r"nowhere\.toml does not exist"):
        export_units(design, str(tmp_path / "nowhere.toml"), output=tmp_path / "fmus")
    assert not (tmp_path / "fmus").exists()


# Campaigns


def test_runs_in_threads_find_a_file_of_the_current_folder(file, fmus, tmp_path, monkeypatch):
    file()
    monkeypatch.chdir(tmp_path)
    scenario = Scenario().changed({"plant.parameters": "mine.toml", "run.duration": 0.01})
    moved = threading.Event()

    def finish(result):
        if not moved.is_set():  # as FMPy does while it loads a library
            monkeypatch.chdir("/")
            moved.set()
        return result.metadata["start_values"]["plant"]["D_r"]

    found = run_all([Job(k, scenario) for k in range(3)], fmus, finish, workers=1)
    assert list(found.values()) == [MINE.parameters.D_r] * 3


def test_a_file_counts_in_the_journal_with_its_content_not_with_its_place(file, fmus, tmp_path):
    scenario = Scenario().changed({"plant.parameters": "mine.toml"})

    def digest(folder):
        return Journal(tmp_path / "journal", "test").digests(fmus)(Job(0, scenario, tmp_path / folder))

    for folder, values in (("a", {}), ("b", {}), ("c", {"D_r": "0.5"})):
        (tmp_path / folder).mkdir()
        file(f"{folder}/mine.toml", **values)
    a, b, c = map(digest, "abc")
    assert a == b != c
    file("a/mine.toml", T_r="0.5")
    assert digest("a") not in (a, c)
    with pytest.raises(UserError, match=r"parameter file mine\.toml does not exist"):
        digest("nowhere")
