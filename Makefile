# Everything runs in a virtual environment beside this file; stamps make repeats quick.
# PYTHON chooses the interpreter the environment is made with (3.11 or later).

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
BASE := $(VENV)/.stamp-base
TEST := $(VENV)/.stamp-test
FAST := $(VENV)/.stamp-fast
DOCS := $(VENV)/.stamp-docs
BENCH := $(VENV)/.stamp-bench
# Exact versions that were tested; `make constraints` chooses them anew.
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable
PYTEST := -m pytest -q -n 2 --dist loadfile --no-loadscope-reorder
EXTRAS := test docs fast bench gurobi orbits ranges # not basilisk, which needs older packages
RUN := runs/static

.DEFAULT_GOAL := help
.PHONY: help demo test test-slow campaign test-lowest test-latest constraints lint format bench docs schema clean

help: ## List the targets
	@grep -E '^[a-z-]+:.*## ' $(firstword $(MAKEFILE_LIST)) | sed -E 's/^([a-z-]+):.*## /\1|/' | \
	  while IFS='|' read -r name text; do printf '  make %-10s %s\n' "$$name" "$$text"; done

demo: $(BASE) ## Run the static scenario and say where its report lies
	@$(BIN)/polaris run static --out $(RUN)
	@$(BIN)/polaris report $(RUN) --quiet
	@echo "Report: $(CURDIR)/$(RUN)/report.html"

test: $(TEST) ## Run the quick tests
	$(BIN)/python $(PYTEST) $(ARGS)

test-slow: $(TEST) $(FAST) ## Run the long tests, and properties on all of their examples
	HYPOTHESIS_PROFILE=whole $(BIN)/python -m pytest -q -n 2 --dist worksteal -m "slow or property" $(ARGS)

campaign: export POLARIS_CAMPAIGN := 1
campaign: test-slow ## Run the long tests with all of their seeds, runs and forgeries, which takes many hours

test-lowest: RESOLUTION := lowest-direct
test-lowest: ## Run the quick tests with the lowest versions that pyproject.toml allows
test-latest: RESOLUTION := highest
test-latest: ## Run the quick tests with the newest versions that pyproject.toml allows
test-lowest test-latest: test-%:
	rm -rf .venv-$*
	$(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt uv
	.venv-$*/bin/uv pip install --quiet --python .venv-$*/bin/python --resolution $(RESOLUTION) --editable '.[test]'
	.venv-$*/bin/python $(PYTEST) $(ARGS)

constraints: $(BIN)/python ## Choose the versions that the targets install: the newest ones that pyproject.toml allows
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(BIN)/uv pip compile --quiet --upgrade --python-version 3.11 $(EXTRAS:%=--extra %) --no-annotate --no-emit-index-url \
	  --custom-compile-command "make constraints" --output-file constraints.txt pyproject.toml

lint: $(TEST) ## Check style, formatting and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: $(TEST) ## Rewrite the code in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: $(BENCH) ## Run the benchmarks and print their tables
	@for name in $(basename $(notdir $(wildcard benchmarks/*.py))) arch; do \
	  echo "== $$name"; $(BIN)/python -m "benchmarks.$$name" || exit 1; done

schema: $(BASE) ## Rewrite the generated pages: schemas and reference of scenarios
	$(BIN)/python -m docs.generate.scenario_docs
	$(BIN)/python -m docs.generate.method_docs
	$(BIN)/python -m docs.generate.source_docs

docs: $(DOCS) schema ## Build the documentation into build/docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir build/docs

clean: ## Remove what the targets made (runs are kept)
	rm -rf $(VENV) .venv-lowest .venv-latest build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis docs/*.schema.json

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed: make PYTHON=python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(BASE): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) .
	@touch $@

# What the tests need includes the rest, so that one resolution does for both.
$(TEST): pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) '.[test]'
	@touch $(BASE) $(DOCS) $@

# Compiled loops are tested with the long tests: compiling them takes as long as some of these.
$(FAST): $(TEST)
	$(PIP) '.[fast]'
	@touch $@

$(DOCS): $(BASE)
	$(PIP) '.[docs]'
	@touch $@

$(BENCH): $(BASE)
	$(PIP) '.[bench]'
	@touch $@
