.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON := .venv/bin/python
TESTS ?= tests

.PHONY: help setup demo test bench-epm lint package models clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## install what the plugin needs here (QGIS by apt on Debian and Ubuntu, the wheels into .venv)
	@scripts/setup

demo: setup ## simulated tri-stereo images to a DSM, its accuracy against the known surface, and the time of each stage
	@$(PYTHON) scripts/demo demo

test: setup ## the whole test suite (TESTS=tests/engine for a part)
	@QT_QPA_PLATFORM=offscreen $(PYTHON) -m pytest -p no:pytest_qgis $(TESTS)

bench-epm: setup ## the equivalent pinhole model: errors, agreement, cost (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/epm.py

lint: setup ## ruff over everything
	@$(PYTHON) -m ruff check .

package: ## dist/repm-VERSION.zip for "Install from ZIP"
	@/usr/bin/env python3 scripts/package dist

models: setup ## write resources/models again
	@QT_QPA_PLATFORM=offscreen $(PYTHON) scripts/make_models.py

clean: ## remove what demo and package made
	@rm -rf demo dist
