# Two commands: `make demo` and `make test`. Both set up everything below .venv/ first, once.
# `make PYTHON=python3.12 ...` takes another interpreter.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMPS := $(VENV)/stamps
READY := $(STAMPS)/package $(STAMPS)/messages

# Processes that test at the same time.
WORKERS ?= 2

EXTRAS := ros tf2 viewer cluster merge test bench dev docs

OPENGL := libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0
CAN_LOAD = $(PYTHON) -c 'import ctypes, sys; [ctypes.CDLL(name) for name in sys.argv[1:]]'
HAS_OPENGL = { $(CAN_LOAD) libEGL.so.1 libOpenGL.so.0 || $(CAN_LOAD) libOSMesa.so.8; } 2>/dev/null
RENDER = from infomap_ros.simulation import select_backend; select_backend(); import mujoco; \
	mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16).close()
BROWSERS := chromium chromium-browser google-chrome google-chrome-stable
HAS_BROWSER = $(PYTHON) -c 'import shutil, sys; sys.exit(not any(map(shutil.which, sys.argv[1:])))' \
	$(BROWSERS)
HAS_HEADERS = $(PYTHON) -c 'import os, sysconfig as s, sys; \
	sys.exit(not os.path.isfile(s.get_path("include") + "/Python.h"))'

.DEFAULT_GOAL := help
.PHONY: help setup demo demo-team demo-bag test lint types docs bench kpi explore-gate lock clean
.DELETE_ON_ERROR:

help:  ## list the commands
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(READY)  ## everything below .venv/: Python packages, ROS 2 from wheels, messages it lacks
	@echo "ready: . $(BIN)/activate"

demo: $(READY) $(STAMPS)/rendering  ## a simulated rover explores a rough world, results in out/demo
	@$(BIN)/python -m infomap_ros.nodes.live.demo --out out/demo

demo-team: $(READY) $(STAMPS)/rendering  ## two rovers map one world together, results in out/demo-team
	@$(BIN)/python -m infomap_ros.nodes.live.demo_team --out out/demo-team

demo-bag: $(READY)  ## map the bag in bags/ through the live nodes, results in out/demo-bag
	@$(BIN)/python -m infomap_ros.nodes.live.bag_demo --out out/demo-bag

# Kernels are compiled once before, not by each of the processes that test.
test: $(READY) $(STAMPS)/rendering $(STAMPS)/browser  ## every test
	@$(BIN)/python -m infomap_ros.nodes.live.kernels >/dev/null
	@$(BIN)/python -m pytest -q -n $(WORKERS) --dist loadfile --no-loadscope-reorder $(PYTEST_ARGS)

lint: $(READY)  ## style
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .

types: $(READY)  ## static types
	@$(BIN)/mypy

docs: $(READY)  ## this documentation as a site, in out/docs
	@$(BIN)/sphinx-build -W --keep-going -q -b html -d out/docs/.doctrees docs out/docs
	@echo "open out/docs/index.html"

bench: $(READY)  ## speed against peers, one JSON line each
	@for script in benchmarks/bench_*.py; do $(BIN)/python $$script || exit 1; done

kpi: $(READY)  ## the figures of a release on real data, into docs/results/kpi.md
	@$(BIN)/python benchmarks/kpi.py --write

# `make explore-gate QUICK=1` takes five of the runs, GATE_ARGS="--only cave:2" others.
explore-gate: $(READY) $(STAMPS)/rendering  ## explore ten worlds and with six other robots, 1 if a run falls short
	@$(BIN)/python benchmarks/explore_gate.py $(if $(QUICK),--quick) $(GATE_ARGS)

lock:  ## pin the newest versions within the ranges of setup.py into requirements.lock
	$(PYTHON) -m venv --clear $(VENV)/lock
	$(VENV)/lock/bin/pip install --quiet uv
	$(VENV)/lock/bin/uv pip compile --quiet --upgrade --universal --fork-strategy fewest \
		--python-version 3.11 $(EXTRAS:%=--extra %) --no-annotate --no-emit-index-url \
		--custom-compile-command "make lock" setup.py --output-file requirements.lock
	rm -rf $(VENV)/lock
	sed -i "/sys_platform == 'win32'/d" requirements.lock

clean:  ## remove what the set-up and the commands made
	rm -rf $(VENV) build install log out *.egg-info .mypy_cache .ruff_cache .pytest_cache

# The set-up in steps, each done again only when what it depends on has changed. What is missing
# outside Python is said in one line; only Python itself is needed to go on.

$(STAMPS)/venv:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' || \
		{ echo "Python 3.11, 3.12 or 3.13 is needed: make PYTHON=python3.12 ..." >&2; exit 1; }
	@missing=""; \
	$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || missing="$$missing python3-venv"; \
	$(HAS_HEADERS) || missing="$$missing python3-dev"; \
	command -v c++ >/dev/null || missing="$$missing g++"; \
	$(HAS_OPENGL) || missing="$$missing $(OPENGL)"; \
	test -z "$$missing" || echo "missing outside Python: sudo apt-get install$$missing" >&2; \
	case "$$missing" in *venv*) exit 1 ;; esac
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@mkdir -p $(STAMPS)
	@touch $@

$(STAMPS)/packages: requirements.lock | $(STAMPS)/venv
	@echo "installing the Python packages of requirements.lock into $(VENV), one to three minutes"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --use-pep517 \
		-r requirements.lock
	@touch $@

$(STAMPS)/package: setup.py setup.cfg package.xml $(STAMPS)/packages
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --no-build-isolation --editable .
	@touch $@

# Tried again each time until they are there; all but tf, the actions of robots and octrees works without.
$(STAMPS)/messages: infomap_ros/nodes/common/message_packages.py | $(STAMPS)/package
	@if $(BIN)/python -m infomap_ros.nodes.common.message_packages; then touch $@; \
	else echo "going on without: no tf (tf2_msgs), actions (control_msgs, nav2_msgs), detections (apriltag_msgs), octrees (octomap_msgs)" >&2; fi

# The simulated camera renders off screen; recorded bags are mapped without.
$(STAMPS)/rendering: | $(STAMPS)/package
	@$(BIN)/python -c '$(RENDER)' 2>/dev/null || \
		{ echo "rendering needs: sudo apt-get install $(OPENGL)" >&2; exit 1; }
	@touch $@

# The report is tested as it is read: in a browser.
$(STAMPS)/browser: | $(STAMPS)/venv
	@$(HAS_BROWSER) || \
		{ echo "testing the report needs: sudo apt-get install chromium (or Google Chrome)" >&2; exit 1; }
	@touch $@
