# Two commands: `make demo` and `make test`. Both set up everything below .venv/ first, once.
# `make PYTHON=python3.12 ...` takes another interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/stamps

.DEFAULT_GOAL := help
.PHONY: help setup demo test lint types bench lock clean
.DELETE_ON_ERROR:

help:  ## list the commands
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

setup: $(STAMPS)/ready  ## everything below .venv/: Python packages, ROS 2 from wheels, tf2_msgs

demo: setup  ## map the bag in bags/ through the live nodes, results in out/demo
	@$(BIN)/python -m infomap_ros.nodes.demo --out out/demo

test: setup $(STAMPS)/rendering  ## every test
	@$(BIN)/python -m pytest -q $(PYTEST_ARGS)

lint: setup  ## style
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .

types: setup  ## static types
	@$(BIN)/mypy

bench: setup  ## speed against peers, one JSON line each
	@for script in benchmarks/bench_*.py; do $(BIN)/python $$script || exit 1; done

lock:  ## pin the newest versions within the ranges of setup.py into requirements.lock
	$(PYTHON) -m venv --clear $(VENV)/lock
	$(VENV)/lock/bin/pip install --quiet uv
	$(VENV)/lock/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest \
		--python-version 3.11 --all-extras --no-annotate --no-emit-index-url \
		--custom-compile-command "make lock" setup.py --output-file requirements.lock
	rm -rf $(VENV)/lock
	sed -i "/sys_platform == 'win32'/d" requirements.lock

clean:  ## remove what the set-up and the commands made
	rm -rf $(VENV) build install log out *.egg-info .mypy_cache .ruff_cache .pytest_cache

# The set-up in steps, each done again only when what it depends on has changed.

$(STAMPS)/venv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=python3.12 ..." >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || \
		{ echo "venv is missing: sudo apt-get install python3-venv" >&2; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@mkdir -p $(STAMPS)
	@touch $@

$(STAMPS)/packages: requirements.lock | $(STAMPS)/venv
	@echo "installing the Python packages of requirements.lock into $(VENV), one to three minutes"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@touch $@

$(STAMPS)/package: setup.py setup.cfg package.xml | $(STAMPS)/packages
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --no-build-isolation --editable .
	@touch $@

$(STAMPS)/tf2: requirements.lock infomap_ros/nodes/tf2_messages.py | $(STAMPS)/package
	@$(BIN)/python -m infomap_ros.nodes.tf2_messages || \
		echo "going on without tf2_msgs: no tf will be published" >&2
	@touch $@

# The simulated camera renders off screen. The demo and the maps of recorded bags do not need it.
$(STAMPS)/rendering: | $(STAMPS)/venv
	@$(PYTHON) -c 'import ctypes; ctypes.CDLL("libEGL.so.1"); ctypes.CDLL("libEGL_mesa.so.0")' \
		2>/dev/null || $(PYTHON) -c 'import ctypes; ctypes.CDLL("libOSMesa.so.8")' 2>/dev/null || \
		{ echo "OpenGL is missing: sudo apt-get install libegl1 libegl-mesa0" >&2; exit 1; }
	@touch $@

$(STAMPS)/ready: $(STAMPS)/packages $(STAMPS)/package $(STAMPS)/tf2
	@touch $@
