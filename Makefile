# Every target sets up what it needs under .venv by itself.
PYTHON ?= python3
PYTEST_FLAGS ?=
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
LOWEST := .venv-lowest
PORTABLE := build/portable
WHEEL := build/wheel
IN_PARALLEL := -n auto --dist worksteal $(PYTEST_FLAGS)
PYTEST := $(BIN)/python -m pytest $(IN_PARALLEL)
# Checks of shapes take a sixth of the tests' time. One run of the numeric tests, the slow tests and plain pytest have them.
UNCHECKED := --jaxtyping-packages=
# Whose results depend on how a processor rounds; the commands and devices above them add no arithmetic.
NUMERIC := $(addprefix tests/,kernels geometry types estimate detect pose track files simulate calibrate)
KERNELS := $(wildcard ringpose/kernels/*.[ch] ringpose/kernels/*/*.[ch])

# A virtual environment that is there keeps its Python, whatever PYTHON is. Empty if that is supported.
UNSUPPORTED = $(shell python=$(BIN)/python; test -x $$python || python='$(PYTHON)'; \
  $$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>&- || \
  echo "$$python is $$($$python -V 2>&- || echo missing)")
REQUIRE_PYTHON = $(if $(UNSUPPORTED),$(error $(UNSUPPORTED), ringpose needs 3.11 or later (sys.exception): \
  give another one, make PYTHON=..., after make clean if it is that of $(VENV)))

# Modules that are instrumented or rewritten for the tests are kept from run to run: half of the time to collect them.
export PYTHONDONTWRITEBYTECODE =
# As the commands do: the matrices are small, and threads that share them mostly wait for each other (tests 3:08 -> 2:48).
export OPENBLAS_NUM_THREADS ?= 1
# The memory of an image is kept for the next one; otherwise the system clears it each time: half of its time.
test test-slow test-baseline-cpu test-other-cpu: export MALLOC_MMAP_THRESHOLD_ = 33554432
test test-slow test-baseline-cpu test-other-cpu: export MALLOC_TRIM_THRESHOLD_ = 536870912

.PHONY: help demo ablation bench-live bench-speed bench-targets compare-baseline baseline golden mutants man-tables results structure test test-slow test-lowest \
  test-baseline-cpu test-other-cpu wheel check lint types layers man clean

help:
	@echo "make demo         the main job on simulated shots: calibration, detection, poses, printed and drawn"
	@echo "make bench-speed  line detectors compared; speed (also drawn: build/bench-speed.png) and accuracy beside every limit of the design; status 3 if one is missed"
	@echo "make bench-live   live tracking from memory: poses, latencies, dropped shots, processors, memory; status 3 if one is missed"
	@echo "make bench-targets  drift, covariances and tracks against their targets; status 3 if one is missed"
	@echo "make compare-baseline  poses of the rendered data sets beside those of the baseline; status 3 if worse"
	@echo "make baseline     make today's poses of the rendered data sets the baseline"
	@echo "make golden       show which lines of the rendered shots have changed, and make today's the golden ones"
	@echo "make results      the tables and charts of the page on results: studies and shared renders, about an hour"
	@echo "make ablation     each named number of detection and estimation halved and doubled, and what that changes; hours, resumable"
	@echo "make mutants      small changes to the package of which each must fail a test, some hours; status 3 if one survives"
	@echo "make man-tables   write the manual's tables of flags from the code"
	@echo "make test         the fast tests (make test-slow: the Monte-Carlo and whole-data-set ones)"
	@echo "make test-lowest  the main job and all file formats with the lowest versions that pyproject.toml admits"
	@echo "make test-baseline-cpu  the numeric fast tests as on a processor without AVX, also in the kernels (x86-64)"
	@echo "make test-other-cpu     the same as on one with another vector unit than this machine's"
	@echo "make wheel        the wheel of this machine in dist/, and the fast tests of kernels and Python API with it"
	@echo "make structure    modules and lines by folder; modules that one shot and one calibration pass through"
	@echo "make manual       the manual as HTML pages in build/manual, index.html first"
	@echo "make check        lint, types, layers, man pages"

$(STAMP): pyproject.toml $(KERNELS)
	@$(REQUIRE_PYTHON)
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
	PYTHONPATH=tests $(BIN)/python -m benchmarks.speed --chart build/bench-speed.png

bench-live: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m benchmarks.live --check

bench-targets: $(STAMP)
	@missed=0; for each in drift_targets consistency_targets track_targets track_images; do \
	  PYTHONPATH=tests $(BIN)/python -m benchmarks.$$each || missed=$$?; done; exit $$missed

results: $(STAMP)
	PYTHONPATH=tests $(BIN)/python -m benchmarks.results

structure: $(STAMP)
	$(BIN)/python tests/benchmarks/structure.py

compare-baseline: $(STAMP)
	$(BIN)/python tests/benchmarks/compare_baseline.py

baseline: $(STAMP)
	$(BIN)/python tests/benchmarks/compare_baseline.py --renew

man-tables: $(STAMP)
	$(BIN)/python tests/manual_tables.py

ablation: $(STAMP)
	$(BIN)/python tests/benchmarks/ablation.py

mutants: $(STAMP)
	$(BIN)/python tests/benchmarks/mutants.py

golden: $(STAMP)
	$(BIN)/python tests/golden_lines.py --renew

test: $(STAMP)
	$(PYTEST) $(UNCHECKED) -m "not slow"

test-slow: $(STAMP)
	$(PYTEST) -m slow

# uv alone resolves to the lowest versions; those for which there is no wheel for this Python are passed over. The test
# tools come second, so that they cannot raise what they share with ringpose.
$(LOWEST)/.installed: pyproject.toml $(KERNELS)
	@$(REQUIRE_PYTHON)
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet --disable-pip-version-check 'uv>=0.5'
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --only-binary :all: \
	  --editable .
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python beartype hypothesis jsonschema pytest
	touch $@

test-lowest: $(LOWEST)/.installed
	$(LOWEST)/bin/python -m pytest -m "not slow" $(PYTEST_FLAGS) tests/test_main_job.py tests/files/test_images.py \
	  tests/files/test_shots.py tests/files/test_declared_sizes.py tests/cli/test_print_board.py \
	  tests/calibrate/mount/test_mount.py
	$(LOWEST)/bin/python -m pytest -m slow $(PYTEST_FLAGS) tests/test_main_job.py -k calibrated_from_carried

# Built from a copy, so that no file of the normal build is taken or replaced. Of a function with clones, the object file
# has a symbol whose name ends in .avx2.
$(PORTABLE)/.installed: $(STAMP) $(shell find ringpose -name '*.py') $(KERNELS)
	rm -rf $(PORTABLE)
	mkdir -p $(PORTABLE)/source
	cp -r ringpose man pyproject.toml README.md LICENSE $(PORTABLE)/source
	rm -f $(PORTABLE)/source/ringpose/kernels/*.so
	CFLAGS=-DRINGPOSE_PORTABLE $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
	  --target $(PORTABLE)/packages $(PORTABLE)/source
	! grep -q '[.]avx2' $(PORTABLE)/packages/ringpose/kernels/*.so
	touch $@

# As a user gets it: built from a copy, installed beside the packages of $(VENV), and imported from there.
wheel: $(STAMP)
	rm -rf $(WHEEL) dist
	mkdir -p $(WHEEL)/source
	cp -r ringpose man pyproject.toml README.md LICENSE $(WHEEL)/source
	rm -f $(WHEEL)/source/ringpose/kernels/*.so
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist $(WHEEL)/source
	test -f dist/ringpose-*-cp311-abi3-linux_$$(uname -m).whl
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(WHEEL)/packages dist/*.whl
	for file in ringpose/py.typed ringpose/files/rings.yaml ringpose/console/replay.html share/man/man1/ringpose-pose.1; do \
	  test -f $(WHEEL)/packages/$$file || exit 1; done
	export PYTHONSAFEPATH=1 PYTHONPATH=$(CURDIR)/$(WHEEL)/packages; \
	$(BIN)/python -c 'import ringpose; assert "$(WHEEL)" in ringpose.__file__, ringpose.__file__' && \
	$(PYTEST) $(UNCHECKED) -m "not slow" tests/kernels tests/test_api.py

test-baseline-cpu: $(PORTABLE)/.installed
	PYTHONSAFEPATH=1 PYTHONPATH=$(CURDIR)/$(PORTABLE)/packages \
	  $(BIN)/python tests/processors.py baseline $(IN_PARALLEL) -m "not slow" $(NUMERIC)

test-other-cpu: $(STAMP)
	$(BIN)/python tests/processors.py other $(IN_PARALLEL) $(UNCHECKED) -m "not slow" $(NUMERIC)

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

manual:
	$(PYTHON) man/html/build.py build/manual

clean:
	rm -rf $(VENV) $(LOWEST) build dist demo calibrate real-shots *.egg-info ringpose/kernels/*.so
