.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON := .venv/bin/python
TESTS ?= tests

.PHONY: help setup demo test bench bench-large bench-clouds bench-confidence bench-cuda bench-epm bench-fusion bench-masks bench-matching bench-pointing bench-real bench-subpixel bench-views identity lint package models i18n pictures clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / { printf "make %-10s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## install what the plugin needs here (QGIS by apt on Debian and Ubuntu, the wheels into .venv)
	@scripts/setup

demo: setup ## simulated tri-stereo images to a DSM, its accuracy against the known surface, and the time of each stage
	@$(PYTHON) scripts/demo demo

test: setup ## the whole test suite (TESTS=tests/engine for a part)
	@QT_QPA_PLATFORM=offscreen $(PYTHON) -m pytest -p no:pytest_qgis $(TESTS)

bench: setup ## DSMs of truth scenes and real images, beside S2P's and CARS's where these are on PATH (docs/benchmarks.md)
	@$(PYTHON) benchmarks/dsm.py

bench-large: setup ## 3 x 5120 x 5120 px over 1500 m of relief, and cost from 4 to 100 Mpx (an hour; docs/benchmarks.md)
	@$(PYTHON) benchmarks/large.py

bench-epm: setup ## the equivalent pinhole model: errors, agreement, cost (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/epm.py

bench-fusion: setup ## what fusing height maps to a DSM costs: time and memory (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/fusion.py

bench-real: setup ## real Pleiades images against S2P's DSMs: agreement, time, memory (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/real_pairs.py

bench-pointing: setup ## ties and pointing: known errors found again, real images, cost (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/pointing.py

bench-matching: setup ## the matcher with one thing changed at a time (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/matching.py

bench-subpixel: setup ## fractions of a pixel taken apart against the truth: noise, smoothing, what is left (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/subpixel.py

bench-masks: setup ## water and clouds: what comes out as nodata, what is lost on land (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/masks.py

bench-confidence: setup ## whether two thirds of heights are within their expected error (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/confidence.py

bench-views: setup ## what a third view adds to the best pair on truth scenes (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/views.py

bench-cuda: setup ## COLMAP's PatchMatch on a CUDA GPU beside sgm (writes docs/benchmarks.md; says so where there is none)
	@$(PYTHON) benchmarks/colmap_cuda.py

bench-clouds: setup ## point clouds for display and meshes: CPU, memory, size (writes docs/benchmarks.md)
	@$(PYTHON) benchmarks/clouds.py

lint: setup ## ruff's rules and format over everything, and types of the engine (mypy, strict)
	@$(PYTHON) -m ruff check .
	@$(PYTHON) -m ruff format --check --quiet . || { echo "lint: run '$(PYTHON) -m ruff format .'"; exit 1; }
	@$(PYTHON) -m mypy

identity: setup ## whether this checkout makes the same results as revision BASE (default HEAD), to the byte
	@$(PYTHON) benchmarks/identity.py $(BASE)

package: ## dist/repm-VERSION.zip for "Install from ZIP"
	@/usr/bin/env python3 scripts/package dist

models: setup ## write resources/models again
	@QT_QPA_PLATFORM=offscreen QT_HASH_SEED=0 $(PYTHON) scripts/make_models.py

i18n: ## bring i18n/*.ts up to date with the source, and compile them (needs Qt's lrelease)
	@/usr/bin/env python3 scripts/i18n.py

pictures: demo ## make docs/pictures again (the report's needs Chromium)
	@$(PYTHON) scripts/pictures.py

clean: ## remove what demo and package made
	@rm -rf demo dist
