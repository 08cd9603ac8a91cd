# Everything a newcomer needs: `make look`, `make demo` and `make test`. `make help` lists the rest.
SHELL := /bin/bash
# The first of these that runs; pyenv's shims are there also for versions that are not. make takes nothing from a shell
# that ends with 127, as that of a missing last one would.
PYTHONS := $(shell for p in python3.11 python3.12 python3.13 python3.14; do $$p -c '' 2> /dev/null && echo $$p; done; true)
PYTHON ?= $(firstword $(PYTHONS) python3)
VENV := .venv
BIN := $(VENV)/bin
PHOTOS ?=
export OMP_WAIT_POLICY ?= passive

WEB := api/web
PAGE := $(WEB)/dist/index.html
PAGE_SOURCES := $(shell find $(WEB)/src $(WEB)/public -type f -not -name schema.d.ts) $(addprefix $(WEB)/,index.html offline.html package-lock.json tsconfig.json vite.config.ts vite.offline.config.ts) api/rest/openapi.json
CPP := $(shell find service/splatting/raster/cpp -type f 2>/dev/null)
INSTALLED_FROM := pyproject.toml client/pyproject.toml constraints.txt CMakeLists.txt $(CPP)
PIP_INSTALL := $(BIN)/pip install --disable-pip-version-check --constraint constraints.txt
# A file's tests stay in one process, as they share its fixtures; tests/lanes.py says which files share one, and which
# come first. Bytecode is kept, also where the environment says no: each of a hundred processes would compile it again.
# BLAS has one thread a process, as there are more processes than cores.
TESTS := PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 $(BIN)/pytest --numprocesses auto --dist loadgroup --no-loadscope-reorder --durations=20

.PHONY: help setup installed page page-can-be-built look lock models demo test test-rest test-all lint lint-api protos stubs bench page-picture sample docker-check clean sample-scene docs figures dist first-gpu

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

setup:  ## a virtual environment with the product and its development tools
	@$(MAKE) --no-print-directory --jobs=2 installed

installed: $(VENV)/.installed $(PAGE)
	@:

# What a person must have installed is checked before anything is downloaded, all of it at once.
$(VENV)/.product: $(INSTALLED_FROM)
	@demo/check_machine.sh "$(PYTHON)"
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --editable ./client --editable .
	@touch $@

$(VENV)/.installed: $(INSTALLED_FROM)
	@demo/check_machine.sh "$(PYTHON)"
	@test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --editable ./client --editable '.[dev]'
	@touch $(VENV)/.product $@

page: $(PAGE)  ## the web page, of api/web (Node.js 18.19 or later)

# Without Node.js the rest is of use all the same: REST, gRPC, the client and the command line.
$(PAGE): $(PAGE_SOURCES)
	@if node -e 'const [a, b] = process.versions.node.split("."); process.exit(a > 18 || (a == 18 && b >= 19) ? 0 : 1)' 2> /dev/null && command -v npm > /dev/null; then \
	  cd $(WEB) && { test node_modules/.package-lock.json -nt package-lock.json || npm ci --loglevel=error; } && npm run --silent build && touch dist/index.html; \
	else echo "Node.js 18.19 or later with npm is needed for the web page, and is not here: the server answers at / that the page is not built, and its browser tests are skipped. REST, gRPC and the command line do without."; fi

models: $(VENV)/.product $(PAGE)  ## fetch and verify the default models
	$(BIN)/fastsplat models pull

demo: $(VENV)/.product $(PAGE)  ## the main job on the sample capture, or on PHOTOS=folder, zip or video
	$(BIN)/fastsplat demo --train $(if $(PHOTOS),--photos "$(PHOTOS)")

look: page-can-be-built $(VENV)/.product $(PAGE)  ## the page with a trained scene, without keys: the sample's, or that of `make demo`
	$(BIN)/fastsplat demo

page-can-be-built:
	@test -f $(PAGE) || demo/check_machine.sh "$(PYTHON)" page

test: setup  ## what a change must pass first: lint, types, architecture, laws, one server, one page, one training
	$(TESTS) -m "not rest"

test-rest: setup  ## every test that `make test` leaves out
	$(TESTS) -m rest

test-all: setup  ## every test, in one run
	$(TESTS)

lint: setup  ## format and lint in place
	@if test -d $(WEB)/node_modules; then cd $(WEB) && npm run --silent format; fi
	$(BIN)/ruff format . && $(BIN)/ruff check --fix . && $(BIN)/mypy && $(BIN)/lint-imports
	$(BIN)/clang-format -i $$(git ls-files '*.cpp' '*.h')

lint-api:  ## check the API's description by redocly and spectral (npm fetches them)
	npx --yes @redocly/cli@2 lint --extends recommended --skip-rule operation-4xx-response api/rest/openapi.json
	npx --yes @stoplight/spectral-cli@6 lint --fail-severity warn --ruleset api/rest/spectral.yaml api/rest/openapi.json

sample-scene: setup  ## train the sample scene that the package brings anew (a few minutes): service/store/care/sample_scene.zip
	$(BIN)/python -m demo.train_sample_scene

docs: setup  ## the documentation as a site, with the reference of Python, REST and gRPC, in site/
	$(BIN)/python -m mkdocs build --strict --quiet
	@echo "Open site/index.html"

lock: setup  ## write constraints.txt from what is installed
	$(BIN)/pip freeze --exclude-editable | sed "s/+cpu$$//" > constraints.txt

stubs: setup  ## regenerate the types of the C++ extension
	$(BIN)/python -m nanobind.stubgen -q -m fastsplat.service.splatting.raster._cpu -o service/splatting/raster/_cpu.pyi
	$(BIN)/ruff format -q service/splatting/raster/_cpu.pyi

protos: setup  ## write the .proto from the contract's types, and its Python
	$(BIN)/python -m protos.generate

# The C++ library goes into the extension, so that the wheel runs where it is older than here; what must be as new as
# here is glibc alone, and auditwheel writes which one into the name.
dist: setup page-can-be-built  ## wheels in dist/ for each CPython 3.11 to 3.14 that is here, and a check that they run without compiler and Node.js
	$(PIP_INSTALL) $$($(BIN)/python docker/requirements.py release)
	rm -rf dist build/wheels
	for python in $(PYTHONS); do LDFLAGS="-static-libstdc++ -Wl,--exclude-libs,ALL" \
	  $(BIN)/pip --python "$$(command -v $$python)" wheel --no-deps --wheel-dir build/wheels . || exit 1; done
	$(BIN)/pip wheel --no-deps --wheel-dir dist ./client
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/auditwheel repair --strip --wheel-dir dist build/wheels/fastsplat-*.whl
	$(BIN)/python release/check_wheels.py dist

docker-check: setup  ## build and run the images in a clean Debian, without Docker (root; see docker/check.py)
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python docker/check.py

bench: setup  ## run the benchmark NAME=..., with ARGS="..."; without a name the list
	$(BIN)/python -m benchmarks $(NAME) $(ARGS)

# The tests that a GPU alone can run come last: what they say is a yes or no, and a lent GPU may be gone by then.
first-gpu: setup  ## on a machine with an NVIDIA GPU: kernels, parity with the CPU, joint against RGB-only training; into build/first-gpu
	DRAFT=build/first-gpu $(BIN)/python -m benchmarks gpu --rounds 20 $(ARGS)
	$(BIN)/pytest --numprocesses 0 tests/splatting/raster/test_raster_cuda.py tests/splatting/training/test_train_backends.py

page-picture: setup  ## docs/page.jpg of the trained sample of `make demo` with an answer glowing
	$(BIN)/python -m benchmarks.page.picture

figures: setup  ## write the tables of figures in README and docs from benchmarks/results
	$(BIN)/python -m benchmarks.figure_tables

clean:  ## remove what make made (models stay)
	rm -rf $(VENV) build demo-output site $(WEB)/dist $(WEB)/node_modules
