# make demo    map the sample survey and say where the layers are
# make test    install what the suite needs and run it; TESTS=FILE for a part of it
# make test-fast  without the tests that are marked slow: every room, in about a minute
# A checkout that cannot be written: make VENV=/some/where/venv DEMO_OUT=/some/where/demo_out demo
PYTHON ?= python3
VENV ?= .venv
DEMO_OUT ?= demo_out
TESTS ?=
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
CONSTRAINTS := .ci/constraints.txt

.PHONY: demo test test-fast lint types docs wheel check clean
.DEFAULT_GOAL := demo

$(VENV)/.installed: pyproject.toml $(CONSTRAINTS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "bumpymap needs Python 3.11 or newer, and '$(PYTHON)' is not. Name another one: make PYTHON=/path/to/python3"; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "'$(PYTHON)' cannot make environments: its venv module is missing. Debian and Ubuntu: sudo apt-get install python3-venv"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet --constraint $(CONSTRAINTS) --upgrade pip
	$(PIP) install --quiet --constraint $(CONSTRAINTS) --editable .
	-$(BIN)/bumpymap compile
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(PIP) install --quiet --constraint $(CONSTRAINTS) --editable '.[sim,learn,o3d,dask,remote,csf]' --group dev
	@touch $@

demo: $(VENV)/.installed
	$(BIN)/bumpymap demo --survey sample_data/quarry.laz --out $(DEMO_OUT)

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses auto $(TESTS)

test-fast: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses auto -m "not slow" $(TESTS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed-dev
	$(BIN)/mypy

docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet --config-file docs/mkdocs.yml --site-dir ../site

# The built wheel, alone in a new environment, must map what it generates.
wheel: $(VENV)/.installed
	rm -rf dist && mkdir dist
	$(PIP) wheel --quiet --no-deps --wheel-dir dist .
	$(PYTHON) -m venv dist/venv
	dist/venv/bin/python -m pip --disable-pip-version-check install --quiet --constraint $(CONSTRAINTS) dist/*.whl
	cd dist && venv/bin/bumpymap --version && venv/bin/bumpymap demo --out demo

check: lint types docs test

clean:
	rm -rf $(VENV) $(DEMO_OUT) dist site
