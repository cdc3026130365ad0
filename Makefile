# make demo   set up, smooth a real fireball, show a table, list the pictures
# make test   set up, check style and types, run all tests
# make bench  measure the speed beside other packages, ten minutes
# make accuracy  every table and figure of docs/accuracy.md (ACCURACY="--quick": a fiftieth)
# make docs   run what the documents show, build the site
# make clean  remove what these made

# The first interpreter that is new enough; make PYTHON=... takes another.
PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo-output
KERNELS := $(wildcard geograph/kernels/*.[ch])
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet

# The matrices are small, and tests run in parallel: threads would only wait for each other.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1

.DEFAULT_GOAL := demo
.PHONY: demo test check style types pytest bench accuracy docs clean

demo: $(VENV)/.demo
	$(BIN)/geograph example winchcombe -o $(DEMO)/winchcombe
	$(BIN)/geograph smooth $(DEMO)/winchcombe -o $(DEMO)/results
	@echo; echo "Pictures:"; ls $(DEMO)/results/*.png

# Types are checked on a core that the tests leave idle while they are collected and at their end.
# A file's tests stay in one process, which makes what they share once.
test: style
	@$(MAKE) --no-print-directory --jobs=2 types pytest

check: style types

style: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.test
	$(BIN)/mypy

pytest: $(VENV)/.test
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder --cov --cov-report=term

bench: $(VENV)/.bench
	$(BIN)/python tests/benchmarks/scaling.py
	$(BIN)/python tests/benchmarks/incremental.py
	$(BIN)/python tests/benchmarks/run.py

accuracy: $(VENV)/.demo
	$(BIN)/python -m geograph.scenarios.accuracy -o accuracy-output $(ACCURACY)

docs: $(VENV)/.docs $(VENV)/.test
	$(BIN)/python -m pytest -n $(JOBS) tests/test_docs.py
	$(BIN)/mkdocs build --strict --config-file .mkdocs.yml

clean:
	rm -f geograph/kernels/*.so
	rm -rf $(VENV) $(DEMO) accuracy-output bench-output build dist site htmlcov *.egg-info .coverage* .mypy_cache .ruff_cache \
		.pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV)/pyvenv.cfg:
	@test -n "$(PYTHON)" || { echo "geograph needs Python 3.11 or newer, and none was found;" \
		"install one, or name one: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
		echo "geograph needs Python 3.11 or newer; $(PYTHON) is" \
		"$$($(PYTHON) --version 2>&1)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# Stamps: a second run installs nothing.
$(VENV)/.demo: $(VENV)/pyvenv.cfg pyproject.toml $(KERNELS)
	$(PIP) --editable .
	@touch $@

$(VENV)/.test: $(VENV)/pyvenv.cfg pyproject.toml $(KERNELS)
	$(PIP) --editable '.[test]'
	@touch $@

# What does not install here is left out of the tables, and named there.
$(VENV)/.bench: $(VENV)/.test
	for name in $$($(BIN)/python tests/benchmarks/wanted.py); do \
		$(PIP) "$$name" || echo "left out: $$name" >&2; done
	@touch $@

$(VENV)/.docs: $(VENV)/pyvenv.cfg pyproject.toml $(KERNELS)
	$(PIP) --editable '.[docs]'
	@touch $@
