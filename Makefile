.DEFAULT_GOAL := help
SHELL := /bin/bash
PYTHON := .venv/bin/python

.PHONY: help setup demo test test-most test-slow test-all bench bench-faults fuzz mutation identity lint types lint-viewer tiles3d-tools cityjson-tools scan site package tables models i18n pictures fresh clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z0-9%-]+:.*## / { printf "make %-12s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

setup: ## install what the plugin needs here (QGIS by apt on Debian and Ubuntu, the wheels into .venv)
	@scripts/setup

demo: setup ## simulated tri-stereo images to a DSM, its accuracy against the known surface, and the time of each stage
	@$(PYTHON) scripts/demo demo

# Whole files go to the two, in order: QGIS is not started before the engine's tests, and modules' fixtures are made once.
SHARED := --numprocesses logical --maxprocesses 2 --dist loadfile --no-loadscope-reorder
test: setup ## the test suite without its long and slow tests, in two processes where there are two cores (TESTS=tests/engine for all tests of a part)
	@QT_QPA_PLATFORM=offscreen $(PYTHON) -m pytest -p no:pytest_qgis $(SHARED) $(or $(TESTS),-m 'not slow and not long' tests)

test-most: setup ## these and the long tests: whole runs, the desktop, browsers
	@$(MAKE) --no-print-directory test TESTS="-m 'not slow' tests"

test-slow: setup ## the slow tests alone: half of the whole time
	@$(MAKE) --no-print-directory test TESTS="-m slow tests"

test-all: setup ## all of them
	@$(MAKE) --no-print-directory test TESTS=tests

bench: setup ## DSMs of truth scenes and real images, beside S2P's and CARS's where these are on PATH (writes docs/benchmarks/dsm.md)
	@$(PYTHON) benchmarks dsm --write

bench-%: setup ## one subject, written to docs/benchmarks/NAME.md: ablation answers beside_open3d building_parts buildings clouds cluster confidence cuda earthquake epm files frames fusion input jitter large masks matching mosaic ortho_ready orthophoto own_rpcs pointing real registration seasons series speed subpixel tiles towns twins views water
	@$(PYTHON) benchmarks $* --write

bench-faults: setup ## kills, cancels, full disks, two runs at once, damaged files: tried and held (hours; SHARE=0.1 for a tenth)
	@$(PYTHON) benchmarks/faults.py --share $(or $(SHARE),1)

fuzz: setup ## broken RPC files against the readers (COUNT=20000 SEED=1)
	@$(PYTHON) -m tests.engine.rpc.fuzz $(or $(COUNT),20000) $(or $(SEED),1)

MUTATION := dist/mutation/tool
mutation: setup ## small faults in the code that a test must notice (SAMPLE=600, 0 for all; SEED=1; ONLY=pointing/; AGAIN=1: what survived)
	@[ -x $(MUTATION)/bin/cosmic-ray ] || { $(PYTHON) -m venv $(MUTATION) && $(MUTATION)/bin/pip install -q cosmic-ray==8.7.0 coverage==7.17.4; } || \
		{ echo "mutation: Cosmic Ray could not be installed into $(MUTATION): it needs the Python package index"; exit 1; }
	@$(MUTATION)/bin/python benchmarks/mutation.py --sample $(or $(SAMPLE),600) --seed $(or $(SEED),1) $(if $(ONLY),--only '$(ONLY)') $(if $(AGAIN),--again)

# mypy follows the plugin's side into the engine only under the name that QGIS gives the plugin's folder.
TYPES := dist/lint/types
lint: setup ## ruff's rules and format over everything, types of all parts (mypy), and lint-viewer
	@$(PYTHON) -m ruff check .
	@$(PYTHON) -m ruff format --check --quiet . || { echo "lint: run '$(PYTHON) -m ruff format .'"; exit 1; }
	@$(MAKE) --no-print-directory types
	@$(MAKE) --no-print-directory lint-viewer

types: ## types alone (mypy): engine and benchmarks, the plugin's side, scripts and the tests' helpers
	@$(PYTHON) -m mypy
	@mkdir -p $(TYPES) && ln -sfn ../../.. $(TYPES)/repm
	@MYPYPATH=$(TYPES) $(PYTHON) -m mypy --cache-dir .mypy_cache/plugin -p repm.processing_provider -p repm.desktop -m repm.plugin
	@MYPYPATH=scripts $(PYTHON) -m mypy --cache-dir .mypy_cache/scripts --explicit-package-bases --scripts-are-modules --allow-any-generics \
		$$(git ls-files 'tests/*.py' | grep -v '/test_[^/]*$$') $$(git ls-files 'scripts/*.py') $$(git grep -lI -e '^#!.*python' -- 'scripts/*' ':!*.py')

LINT := dist/lint/tool
lint-viewer: ## the scripts of the viewer's page: rules and format (Biome), and types (TypeScript's checker); needs Node 20 with npm
	@command -v npm > /dev/null || { echo "lint: the scripts of the viewer's page were not checked: that needs Node 20 with npm"; exit 0; }; \
	[ $(LINT)/node_modules -nt package.json ] || { mkdir -p $(LINT) && cp package.json $(LINT)/ && \
		npm install --silent --no-package-lock --prefix $(LINT) && touch $(LINT)/node_modules; } || \
		{ echo "lint: the scripts of the viewer's page were not checked: Biome and TypeScript need the npm registry"; exit 0; }; \
	$(LINT)/node_modules/.bin/biome check --log-level=warn --error-on-warnings && $(LINT)/node_modules/.bin/tsc

TILES3D := dist/tiles3d/tool
tiles3d-tools: ## what the tests of 3-D Tiles take where it is there: Khronos' validator of glTF and CesiumJS; needs Node with npm
	@mkdir -p $(TILES3D) && npm install --silent --no-package-lock --no-save --prefix $(TILES3D) gltf-validator@2.0.0-dev.3.10 cesium@1.145.0

CITYJSON := dist/cityjson/tool
cityjson-tools: ## CityJSON's validator cjval, which the tests of buildings take where it is there; needs Rust's cargo
	@cargo install --quiet --locked --root $(CITYJSON) --features build-binary cjval@0.10.0

scan: setup ## what plugins.qgis.org would find in the zip: Bandit, secrets, names, modes, metadata
	@$(PYTHON) scripts/scan

identity: setup ## whether this checkout makes the same results as revision BASE (default HEAD), to the byte
	@$(PYTHON) benchmarks/identity.py $(BASE)

SITE := dist/site/tool
site: ## the documents as a site in dist/site/pages; it fails where a link leads nowhere
	@[ -x $(SITE)/bin/mkdocs ] || { python3 -m venv $(SITE) && $(SITE)/bin/python -m pip install -q -r requirements-site.txt; } || \
		{ rm -rf $(SITE); echo "site: MkDocs could not be installed into $(SITE): it needs the Python package index"; exit 1; }
	@# Not --quiet: with it MkDocs does not count its warnings, and dead links pass.
	@set -o pipefail; NO_MKDOCS_2_WARNING=1 $(SITE)/bin/mkdocs build 2>&1 | { grep -v '^INFO' || true; }
	@echo "dist/site/pages/index.html"

package: ## dist/repm-VERSION.zip for "Install from ZIP"
	@/usr/bin/env python3 scripts/package dist

tables: setup ## write the tables of results in docs/algorithms again
	@$(PYTHON) scripts/result_tables.py

models: setup ## write resources/models again
	@QT_QPA_PLATFORM=offscreen QT_HASH_SEED=0 $(PYTHON) scripts/make_models.py

i18n: ## bring i18n/*.ts up to date with the source, and compile them (needs Qt's lrelease)
	@/usr/bin/env python3 scripts/i18n.py

pictures: demo ## make docs/pictures again (some need Chromium, the desktop with Xvfb, the network or the shared data; others stay as they are)
	@$(PYTHON) scripts/pictures.py

fresh: ## README's commands, the zip and 'pip install .' on a bare Debian 12 and 13, before each release (SYSTEMS=bookworm for one)
	@scripts/fresh $(SYSTEMS)

clean: ## remove what demo and package made
	@rm -rf demo dist
