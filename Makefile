# make render   set up and render the portrait to out/        make test   set up and run the tests
# make lint     ruff and mypy on the built wheel              make clean  remove what was made
# PYTHON=...    which Python to use; otherwise the first of 3.12, 3.11, 3.13 that is there
# WORKERS=1     run the tests in one process; otherwise one per core, 8 at most
# MESH=0        leave out the extra `mesh` (open3d, 0.9 GB installed)

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := render
.PHONY: render test lint clean

VENV := .venv
BIN := $(VENV)/bin
MESH ?= 1
WORKERS ?= auto
PYTEST_ARGS ?=
# setuptools warns of every editable install as such, and pip passes it on.
PIP := PYTHONWARNINGS=ignore $(BIN)/python -m pip install --quiet --disable-pip-version-check
SOURCES := $(shell find usdskin schemas warp_kernels -name '*.py' -o -name '*.csv' -o -name '*.usda')

PORTRAIT := stages/portrait
LIBRARY := stages/skin_library
PORTRAIT_LAYERS := $(LIBRARY)/skin_library.usda \
    $(shell find $(PORTRAIT) \( -name '*.usda' -o -name '*.exr' \) -not -path '*/assets/*' 2>/dev/null)
PREPARED := $(VENV)/portrait.stamp

render: out/portrait.exr
	@echo "portrait: $(CURDIR)/out/portrait.exr"
	@echo "portrait: $(CURDIR)/out/portrait.png"

out/portrait.exr: $(PREPARED) $(PORTRAIT_LAYERS) $(SOURCES)
	@mkdir -p out
	$(BIN)/usdskin render $(PORTRAIT)/portrait.usda out/portrait.exr

# The head is downloaded once and imported; its files stay out of git.
$(PREPARED): $(wildcard $(PORTRAIT)/*.py $(LIBRARY)/*.py usdskin/meshfiles/*.py) | $(VENV)/installed.stamp
	$(BIN)/python $(PORTRAIT)/prepare.py
	@touch $@
ifeq ($(wildcard $(PORTRAIT)/assets),)
.PHONY: $(PREPARED)
endif

# A Python of the right version that can make virtual environments.
$(BIN)/python:
	@for python in $(or $(PYTHON),python3.12 python3.11 python3.13 python3 python); do \
	    if "$$python" -c 'import sys, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' \
	            2>/dev/null; then \
	        echo "environment: $(VENV), from $$python"; \
	        "$$python" -m venv $(VENV) && exit 0; \
	        rm -rf $(VENV); \
	    fi; \
	done; \
	echo "make: no usable Python. usdskin needs Python 3.11, 3.12 or 3.13 with venv" \
	    "(Debian, Ubuntu: apt install python3-venv; Rocky: dnf install python3.12), or PYTHON=/path/to/python" >&2; \
	exit 1

$(VENV)/installed.stamp: pyproject.toml | $(BIN)/python
	@echo "installing usdskin into $(VENV) (some minutes the first time)"
	$(PIP) --editable .
	@touch $@

$(VENV)/test.stamp: $(VENV)/installed.stamp
	$(PIP) --editable '.[test,lint,schema]'
	@touch $@

# open3d has no wheel for every C library: without it its tests skip, and nothing else needs it.
$(VENV)/mesh.stamp: $(VENV)/installed.stamp
	@if [ "$(MESH)" = 0 ]; then \
	    echo "open3d: left out (MESH=0); its tests skip"; \
	elif ! $(PIP) --only-binary=open3d --editable '.[mesh]' 2>$(VENV)/mesh.log; then \
	    echo "open3d: cannot be installed here, its tests skip: it has wheels for Python up to 3.12" \
	        "and glibc from 2.31 or 2.35 on (all of pip's words are in $(VENV)/mesh.log)"; \
	elif ! $(BIN)/python -c 'import open3d' 2>$(VENV)/mesh.log; then \
	    echo "open3d: installed but does not load: $$(tail -n 1 $(VENV)/mesh.log)"; \
	    echo "open3d: Debian, Ubuntu: apt install libusb-1.0-0 libgl1 libgomp1; its tests skip until then"; \
	fi
	@touch $@

test: $(VENV)/test.stamp $(VENV)/mesh.stamp
	$(BIN)/python -m pytest -p no:dash -n $(WORKERS) --maxprocesses 8 $(PYTEST_ARGS)

lint: $(VENV)/test.stamp
	$(BIN)/ruff check
	$(BIN)/ruff format --check

clean:
	rm -rf $(VENV) build dist out $(PORTRAIT)/assets *.egg-info .pytest_cache .mypy_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
