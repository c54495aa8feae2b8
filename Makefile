# Every target sets up what it needs under .venv by itself.
PYTHON ?= python3
PYTEST_FLAGS ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
LOWEST := .venv-lowest
PYTEST := $(BIN)/python -m pytest -n auto --dist worksteal $(PYTEST_FLAGS)
KERNELS := $(wildcard ringpose/kernels/*.[ch] ringpose/kernels/*/*.[ch])

# Modules that are instrumented or rewritten for the tests are kept from run to run: half of the time to collect them.
export PYTHONDONTWRITEBYTECODE =
# As the commands do: the matrices are small, and threads that share them mostly wait for each other (tests 3:08 -> 2:48).
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help demo bench-speed bench-targets compare-baseline baseline golden structure test test-slow test-lowest \
  check lint types layers man clean

help:
	@echo "make demo         the main job on simulated shots: calibration, detection, poses, printed and drawn"
	@echo "make bench-speed  line detectors compared; speed and accuracy beside every limit of the design; status 3 if one is missed"
	@echo "make bench-targets  drift, covariances and tracks against their targets; status 3 if one is missed"
	@echo "make compare-baseline  poses of the rendered data sets beside those of the baseline; status 3 if worse"
	@echo "make baseline     make today's poses of the rendered data sets the baseline"
	@echo "make golden       show which lines of the rendered shots have changed, and make today's the golden ones"
	@echo "make test         the fast tests (make test-slow: the Monte-Carlo and whole-data-set ones)"
	@echo "make test-lowest  the main job and all file formats with the lowest versions that pyproject.toml admits"
	@echo "make structure    modules and lines by folder; modules that one shot and one calibration pass through"
	@echo "make check        lint, types, layers, man pages"

$(STAMP): pyproject.toml $(KERNELS)
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	$(BIN)/python -m compileall -q ringpose  # as pip does for packages that are not editable
	for section in 1 5 7; do mkdir -p $(VENV)/share/man/man$$section && \
	  ln -sf "$(CURDIR)"/man/*.$$section $(VENV)/share/man/man$$section; done  # man finds them beside $(BIN)
	touch $@

demo: $(STAMP)
	PATH="$(CURDIR)/$(BIN):$$PATH" sh examples/demo.sh demo

bench-speed: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m benchmarks.compare_detectors
	PYTHONPATH=tests $(BIN)/python -m benchmarks.speed

bench-targets: $(STAMP)
	@missed=0; for each in drift_targets consistency_targets track_targets track_images; do \
	  PYTHONPATH=tests $(BIN)/python -m benchmarks.$$each || missed=$$?; done; exit $$missed

structure: $(STAMP)
	$(BIN)/python tests/benchmarks/structure.py

compare-baseline: $(STAMP)
	$(BIN)/python tests/benchmarks/compare_baseline.py

baseline: $(STAMP)
	$(BIN)/python tests/benchmarks/compare_baseline.py --renew

golden: $(STAMP)
	$(BIN)/python tests/golden_lines.py --renew

test: $(STAMP)
	$(PYTEST) -m "not slow"

test-slow: $(STAMP)
	$(PYTEST) -m slow

# uv alone resolves to the lowest versions; those for which there is no wheel for this Python are passed over. The test
# tools come second, so that they cannot raise what they share with ringpose.
$(LOWEST)/.installed: pyproject.toml $(KERNELS)
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check 'uv>=0.5'
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --only-binary :all: \
	  --editable .
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python beartype hypothesis jsonschema pytest
	touch $@

test-lowest: $(LOWEST)/.installed
	$(LOWEST)/bin/python -m pytest -m "not slow" $(PYTEST_FLAGS) tests/test_main_job.py tests/files/test_images.py \
	  tests/files/test_shots.py tests/files/test_declared_sizes.py tests/cli/test_print_board.py

check: lint types layers man

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy

layers: $(STAMP)
	$(BIN)/lint-imports

man:
	@if command -v mandoc >/dev/null; then mandoc -T lint -W warning man/*.[1-9]; \
	elif [ -n "$$CI" ]; then echo "make man: mandoc is missing" >&2; exit 1; \
	else echo "make man: mandoc is missing (apt install mandoc): manual not linted" >&2; fi

clean:
	rm -rf $(VENV) $(LOWEST) build dist demo calibrate real-shots *.egg-info ringpose/kernels/*.so
