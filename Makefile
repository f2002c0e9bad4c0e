# Everything runs in .venv, made here; nothing else on the machine is touched.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin

.PHONY: demo paper test lint sanitizers docs versions dist dist-check bench clean

demo: $(VENV)/installed   ## design, export, co-simulate LC, SMC and IHC, compare
	$(BIN)/qube-ihc demo

paper: $(VENV)/installed   ## the paper's experiments, repeated and judged; more than half an hour, can be interrupted and continued
	$(BIN)/qube-ihc paper

test: lint   ## lint, type check and all tests
	$(BIN)/pytest

C_FILES := src/*/native/* src/fmu_export/adapter/* cosim/native/* benchmarks/* tests/fmu_export/native/* tests/fmu_export/native/*/*

lint: $(VENV)/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run --Werror $(wildcard $(addsuffix .[ch],$(C_FILES)))
	$(BIN)/pyright

sanitizers: $(VENV)/installed   ## the C sources under the address and undefined behaviour sanitizers of gcc or clang; a part of make test
	$(BIN)/pytest tests/fmu_export/test_sanitizers.py tests/plant_fmu/linear/test_sources.py

docs: $(VENV)/installed   ## the site, in build/site; a warning fails it
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --conf-dir docs --doctree-dir build/site-cache . build/site
	@echo "build/site/index.html"

versions: $(VENV)/installed   ## the lowest declared versions, and newer Pythons where installed: a smoke test in an environment of each
	$(BIN)/python -m tests.environments

dist: $(VENV)/installed   ## sdist, and wheels for Linux x86-64 and ARM, Windows and macOS, in dist/
	$(BIN)/python make_dist.py

dist-check: dist   ## dist/ again gives the same bytes; the wheel works without network and compiler; pip finds the others
	$(BIN)/python -m tests.dist

bench: $(VENV)/installed   ## speed against one C program and against other tools, installed here for it; the hardware loop's timing; the pair in foreign tools
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]'
	$(BIN)/python -m benchmarks.native_pair
	$(BIN)/python -m benchmarks.hil --seconds 5
	$(BIN)/python -m benchmarks.foreign_tools

SOURCES := pyproject.toml hatch_build.py $(wildcard src/*/native/*.[ch] src/fmu_export/adapter/*.[ch] cosim/native/*.[ch])

$(VENV)/installed: $(SOURCES)   ## also compiles the native units, with Zig from PyPI
	@echo "Installing into $(VENV): libraries, test tools and, compiled with Zig, the native units. A few minutes the first time."
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable '.[dev]'
	@touch $@
	@echo "Installed."

clean:
	rm -rf $(VENV) build dist results fmus/*.fmu
