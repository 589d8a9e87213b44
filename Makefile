# Everything runs in .venv, made from pyproject.toml and the pins in constraints.txt.
# Another interpreter has an environment of its own: make test PYTHON=python3.13 VENV=.venv-3.13
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
LOWEST := .venv-lowest
AXE_CORE := 4.14.1
export PIP_CONSTRAINT := $(CURDIR)/constraints.txt
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYTHONDONTWRITEBYTECODE :=

# uv takes a tenth of pip's time; pip is there where uv finds no index
INSTALL = @install() { \
  $(BIN)/uv pip install --quiet --python $(BIN)/python --constraint $(PIP_CONSTRAINT) --editable "$$1" \
    || $(BIN)/python -m pip install --quiet --editable "$$1"; \
}; install

.DEFAULT_GOAL := help
.PHONY: help environment study test tier test-all test-long test-slow test-browser test-lowest release ruff lint docs pictures bench bench-history format clean

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 14

$(VENV)/.runtime: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info[:2] <= (3, 14) else "ldctoolkit needs Python 3.11 to 3.14, this is " + sys.version.split()[0] + "; choose one with PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet uv
	$(INSTALL) .
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python tools/compile_loops.py
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime
	$(INSTALL) '.[dev]'
	@touch $@

# the rules that the report is checked with, beside Python's packages; without npm their tests say that they are skipped
$(VENV)/.axe-core-$(AXE_CORE): $(VENV)/.runtime
	@if command -v npm >/dev/null 2>&1; then \
	  npm install --silent --no-save --no-package-lock --no-audit --no-fund --ignore-scripts --prefix $(VENV) axe-core@$(AXE_CORE) && touch $@; \
	else echo "npm is not on PATH: tests with axe-core are skipped"; fi

environment: $(VENV)/.dev

$(VENV)/.bench: $(VENV)/.dev
	$(INSTALL) '.[bench]'
	@touch $@

$(VENV)/.docs: $(VENV)/.runtime
	$(INSTALL) '.[docs]'
	@touch $@

study: $(VENV)/.runtime  ## run the study trigger-and-gains on the bundled model; ranking and report
	$(BIN)/ldc run trigger-and-gains -o out/trigger-and-gains

ruff: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

lint: ruff  ## ruff and mypy --strict
	$(BIN)/mypy

test: ruff  ## ruff, and the tests that a change should pass, in minutes
	@$(MAKE) --no-print-directory tier

tier:
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python tools/compile_loops.py  # before two workers would do so each for itself
	-@$(BIN)/pytest --collect-only -qq > /dev/null  # their assertions are rewritten once, not by each worker
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 -m "not slow and not browser"

test-all: test test-long  ## types, the release and the longer tier too: grids, coverage, worker pools, clusters, kills, fuzzing, browser

test-long: $(VENV)/.dev $(VENV)/.docs $(VENV)/.axe-core-$(AXE_CORE)
	@$(MAKE) --no-print-directory -j2 -Otarget test-slow test-browser lint docs release

test-slow:
	LDC_TESTS=long OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n 2 -m "(slow or hypothesis) and not browser"

test-browser: docs  # one process: a browser beside another may wait for ever; it opens the built pages too
	OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -m browser

# an environment of its own, without constraints.txt; tools that check the code itself run in the other one
test-lowest: $(VENV)/.dev  ## the tests of `make test` with the lowest versions that pyproject.toml declares
	$(BIN)/uv venv --quiet --allow-existing --python $(BIN)/python $(LOWEST)
	$(BIN)/uv pip compile --quiet --python $(LOWEST)/bin/python --resolution lowest-direct --only-binary :all: --extra dev pyproject.toml --output-file $(LOWEST)/lowest.txt
	$(BIN)/uv pip sync --quiet --python $(LOWEST)/bin/python $(LOWEST)/lowest.txt
	$(BIN)/uv pip install --quiet --python $(LOWEST)/bin/python --no-deps --editable .
	@$(MAKE) --no-print-directory tier VENV=$(LOWEST)

release: $(VENV)/.dev  ## wheel and sdist into dist, tried in a clean environment outside the checkout
	@rm -rf dist
	$(BIN)/python -m build --outdir dist . > /dev/null
	$(BIN)/python tools/try_release.py dist

docs: $(VENV)/.docs  ## the documentation into out/docs; a warning is an error
	@rm -rf docs/reference/generated
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx -W --keep-going -q -d out/docs-cache docs out/docs

pictures: $(VENV)/.dev  ## the README's pictures in docs/_pictures anew; needs Chromium
	OPENBLAS_NUM_THREADS=1 $(BIN)/python docs/_ext/front.py docs/_pictures

bench: $(VENV)/.bench  ## ratios against named references, beside those that the documentation claims
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/history.py

bench-history: $(VENV)/.bench  ## the same, and kept with date, commit and machine in out/benchmarks.jsonl
	OPENBLAS_NUM_THREADS=1 $(BIN)/python tests/benchmarks/history.py --keep out/benchmarks.jsonl

format: $(VENV)/.dev  ## rewrite the code in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:  ## remove the environments and what a study wrote
	rm -rf $(VENV) .venv-* out build dist
