# Everything runs in .venv, made from pyproject.toml and the pins in constraints.txt.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
AXE_CORE := 4.14.1
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help study test test-all test-long test-slow test-browser ruff lint docs pictures bench format clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

$(VENV)/.runtime: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info[:2] <= (3, 14) else "ldctoolkit needs Python 3.11 to 3.14, this is " + sys.version.split()[0] + "; choose one with PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable .
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python tools/compile_loops.py
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	$(BIN)/python -m pip install --quiet --editable '.[dev]'
	@touch $@

# the rules that the report is checked with, beside Python's packages; without npm their tests say that they are skipped
$(VENV)/.axe-core-$(AXE_CORE): $(VENV)/.runtime
	@if command -v npm >/dev/null 2>&1; then \
	  npm install --silent --no-save --no-package-lock --no-audit --no-fund --ignore-scripts --prefix $(VENV) axe-core@$(AXE_CORE) && touch $@; \
	else echo "npm is not on PATH: tests with axe-core are skipped"; fi

$(VENV)/.bench: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	@touch $@

$(VENV)/.docs: $(VENV)/.runtime
	$(BIN)/python -m pip install --quiet --editable '.[docs]'
	@touch $@

study: $(VENV)/.runtime  ## run the study trigger-and-gains on the bundled model; ranking and report
	$(BIN)/ldc run trigger-and-gains -o out/trigger-and-gains

ruff: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

lint: ruff  ## ruff and mypy --strict
	$(BIN)/mypy

test: ruff  ## ruff, and the tests that a change should pass, in minutes
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python tools/compile_loops.py  # before two workers would do so each for itself
	-@$(BIN)/pytest --collect-only -qq > /dev/null  # their assertions are rewritten once, not by each worker
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 -m "not slow and not browser"

test-all: test test-long  ## types and the longer tier too: grids, coverage, worker pools, clusters, kills, fuzzing, browser

test-long: $(VENV)/.dev $(VENV)/.docs $(VENV)/.axe-core-$(AXE_CORE)
	@$(MAKE) --no-print-directory -j2 -Otarget test-slow test-browser lint docs

test-slow:
	LDC_TESTS=long OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 -m "(slow or hypothesis) and not browser"

test-browser: docs  # one process: a browser beside another may wait for ever; it opens the built pages too
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -m browser

docs: $(VENV)/.docs  ## the documentation into out/docs; a warning is an error
	@rm -rf docs/reference/generated
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx -W --keep-going -q -d out/docs-cache docs out/docs

pictures: $(VENV)/.dev  ## the README's pictures in docs/_pictures anew; needs Chromium
	OPENBLAS_NUM_THREADS=1 $(BIN)/python docs/_ext/front.py docs/_pictures

bench: $(VENV)/.bench  ## ratios against named references
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/closed_loop.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/against_plain_numba.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/extraction.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/linear_mpc.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/mixture.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/nonlinear_mpc.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/ranking.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/report_size.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/risk.py
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/study_overhead.py

format: $(VENV)/.dev  ## rewrite the code in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove the environment and what a study wrote
	rm -rf $(VENV) out build dist
