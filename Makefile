# Everything a newcomer needs: `make demo` and `make test`. `make help` lists the rest.
SHELL := /bin/bash
# The first of these that runs; pyenv's shims are there also for versions that are not.
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3.14 python3; do $$p -c '' 2> /dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
PHOTOS ?=
export OMP_WAIT_POLICY ?= passive

WEB := api/web
PAGE := $(WEB)/dist/index.html
PAGE_SOURCES := $(shell find $(WEB)/src $(WEB)/public -type f -not -name schema.d.ts) $(addprefix $(WEB)/,index.html offline.html package-lock.json tsconfig.json vite.config.ts vite.offline.config.ts) api/rest/openapi.json
CPP := $(shell find service/splatting/raster/cpp -type f 2>/dev/null)

.PHONY: help setup page look lock models demo test lint lint-api protos stubs bench page-picture sample docker-check clean sample-scene docs figures

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

setup: $(VENV)/.installed $(PAGE)  ## a virtual environment with the product and its development tools

$(VENV)/.installed: pyproject.toml client/pyproject.toml constraints.txt CMakeLists.txt $(CPP)
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' || { echo "Python 3.11 to 3.14 is needed, and '$(PYTHON)' is not that. Set PYTHON=/path/to/python3"; exit 1; }
	@test -d $(VENV) || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ./client --editable '.[dev]'
	@touch $@

page: $(PAGE)  ## the web page, of api/web (Node.js 18.19 or later)

# Without Node.js the rest is of use all the same: REST, gRPC, the client and the command line.
$(PAGE): $(PAGE_SOURCES)
	@if node -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 18 || (a == 18 && b >= 19) ? 0 : 1)' 2> /dev/null && command -v npm > /dev/null; then \
	  cd $(WEB) && { test node_modules/.package-lock.json -nt package-lock.json || npm ci --loglevel=error; } && npm run --silent build && touch dist/index.html; \
	else echo "Node.js 18.19 or later with npm is needed for the web page, and is not here: the server answers at / that the page is not built, and its browser tests are skipped. REST, gRPC and the command line do without."; fi

models: setup  ## fetch and verify the default models
	$(BIN)/fastsplat models pull

demo: setup  ## the main job on the sample capture, or on PHOTOS=folder, zip or video
	$(BIN)/python -m demo $(if $(PHOTOS),--photos "$(PHOTOS)")

look: setup  ## the page with the trained sample of `make demo`, without keys, on this machine alone
	@test -f demo-output/service/fastsplat.sqlite || { echo "Run make demo first: it trains the sample that is shown"; exit 1; }
	@echo "The page is at http://localhost:8000/ as soon as the service runs; Ctrl-C ends it"
	FASTSPLAT_DATA_DIR=demo-output/service $(BIN)/fastsplat serve --no-auth

# A file's tests stay in one process, as they share its fixtures; files in their order, so that no long one is left to
# the end.
test: setup  ## every check: lint, types, architecture, laws
	$(BIN)/pytest --numprocesses auto --dist loadfile --no-loadscope-reorder

lint: setup  ## format and lint in place
	@if test -d $(WEB)/node_modules; then cd $(WEB) && npm run --silent format; fi
	$(BIN)/ruff format . && $(BIN)/ruff check --fix . && $(BIN)/mypy && $(BIN)/lint-imports
	$(BIN)/clang-format -i $(CPP)

lint-api:  ## check the API's description by redocly and spectral (npm fetches them)
	npx --yes @redocly/cli@2 lint --extends recommended --skip-rule operation-4xx-response api/rest/openapi.json
	npx --yes @stoplight/spectral-cli@6 lint --fail-severity warn --ruleset api/rest/spectral.yaml api/rest/openapi.json

sample-scene: setup  ## train the sample scene that the package brings anew (a few minutes): service/library/sample_scene.zip
	$(BIN)/python -m demo.train_sample_scene

docs: setup  ## the documentation as a site, with the reference of Python, REST and gRPC, in site/
	$(BIN)/python -m mkdocs build --strict --quiet
	@echo "Open site/index.html"

lock: setup  ## write constraints.txt from what is installed
	$(BIN)/pip freeze --exclude-editable | sed "s/+cpu$$//" > constraints.txt

stubs: setup  ## regenerate the types of the C++ extension
	$(BIN)/python -m nanobind.stubgen -q -m fastsplat.service.splatting.raster._cpu -o service/splatting/raster/_cpu.pyi
	$(BIN)/ruff format -q service/splatting/raster/_cpu.pyi

protos: setup  ## regenerate the wire contract's Python
	$(BIN)/python protos/generate.py

docker-check: setup  ## build and run the images in a clean Debian, without Docker (root; see docker/check.py)
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python docker/check.py

bench: setup  ## run the benchmark NAME=..., with ARGS="..."; without a name the list
	$(BIN)/python -m benchmarks $(NAME) $(ARGS)

page-picture: setup  ## docs/page.jpg of the trained sample of `make demo` with an answer glowing
	$(BIN)/python -m benchmarks.page.picture

figures: setup  ## write the tables of figures in README and docs from benchmarks/results
	$(BIN)/python -m benchmarks.figure_tables

clean:  ## remove what make made (models stay)
	rm -rf $(VENV) build demo-output site $(WEB)/dist $(WEB)/node_modules
