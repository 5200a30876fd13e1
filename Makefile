# Everything runs in .venv, which every target makes for itself from the lock files.
# Needed on the machine: Python 3.11 or newer, make, and a package registry.
PYTHON ?= python3
BIN := .venv/bin
export PYTHONDONTWRITEBYTECODE :=
SOURCES := localreg sensors calibration benchmarks tests

.PHONY: help demo test check format bench lock fuzz clean
.DEFAULT_GOAL := help

help:  ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## */\t/' | expand -t 10

demo: .venv/.installed  ## play a left-out walk through a serial line and synthesize the body live
	$(BIN)/localreg demo $(ARGS)
	@$(MAKE) -s .venv/.runtime

test: .venv/.develop  ## run the tests
	$(BIN)/pytest -n 2 --dist loadfile $(ARGS)

check: .venv/.develop  ## lint, format, types, import directions
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/basedpyright
	$(BIN)/lint-imports

format: .venv/.develop  ## rewrite the sources in the house format
	$(BIN)/ruff check --fix $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

bench: .venv/.develop  ## measure speed, memory and recall at 65,609 and 1.1 million poses (half an hour)
	$(BIN)/python -m benchmarks.scaling --work out/bench --json out/bench/figures.json \
	  --plot benchmarks/figures/speed.png --readme benchmarks/README.md $(ARGS)

lock: $(BIN)/uv  ## pin every dependency again, names, versions and hashes only
	$(BIN)/uv pip compile pyproject.toml --extra sample \
	  --universal --generate-hashes --no-header -q -o requirements.lock
	$(BIN)/uv pip compile pyproject.toml --all-extras --group dev -c requirements.lock \
	  --universal --generate-hashes --no-header -q -o requirements-dev.lock

fuzz: .venv/.develop  ## a million mutilated inputs for everything that reads bytes (ten minutes)
	$(BIN)/python -m tests.sensors.fuzzing --inputs 1000000 $(ARGS)

clean:  ## remove the environment and every cache
	rm -rf .venv .pytest_cache .ruff_cache .hypothesis .import_linter_cache

$(BIN)/uv:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "localreg needs Python 3.11 or newer; try make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install -q uv

.venv/.installed: requirements.lock pyproject.toml | $(BIN)/uv
	$(BIN)/uv pip install -q -p $(BIN)/python --require-hashes -r requirements.lock
	$(BIN)/uv pip install -q -p $(BIN)/python --no-deps -e .
	@touch $@

# Byte code is compiled once: left to the first import, it would be compiled at every start where
# Python is told to write none, and take most of it. The first demo writes what it imports, a
# quarter of all, and does not wait for the rest.
.venv/.runtime: .venv/.installed
	$(BIN)/python -m compileall -q -j 0 -x '/tests/' localreg sensors calibration \
	  $$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
	@touch $@

.venv/.develop: requirements-dev.lock .venv/.runtime
	$(BIN)/uv pip install -q -p $(BIN)/python --compile-bytecode --require-hashes \
	  -r requirements-dev.lock
	@touch $@
