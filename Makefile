# `make demo` does the main job, `make test` runs the test suite; each installs into .venv what it needs. Needs Python 3.10+, pip and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo

.PHONY: demo test test-slow fuzz bench notebooks docs docs-check refit lint format clean dist wheel-check release-check release-check-full measured resolve lowest
.NOTPARALLEL:  # one pip at a time

demo: $(VENV)/.show
	$(BIN)/python -m sims particles --steps 75 --output $(OUT)

# on all cores that this process may use, each worker with a share of the files; a worker that is done helps the others
PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist worksteal

test: $(VENV)/.test
	$(PYTEST)

# what takes minutes, and only that
test-slow: $(VENV)/.test
	$(PYTEST) --slow -m slow

# spoil bounders' files for an hour; what certify then calls proven is attacked, and no positive may be denied
MINUTES ?= 60
SEED ?= 0
fuzz: $(VENV)/.test
	$(BIN)/python tests/fuzz --minutes $(MINUTES) --seed $(SEED) --out out/fuzz

bench: $(VENV)/.sims
	$(BIN)/python benchmarks/rivals.py --groups points --out out/bench
	$(BIN)/python benchmarks/overhead.py

# execute the notebooks, in place
notebooks: $(VENV)/.notebooks
	$(BIN)/python notebooks/execute.py

# the documentation site, into build/docs; then all of it in a browser without a window, where there is one, with pictures in out/docs
docs: $(VENV)/.docs
	$(BIN)/python docs/site

docs-check: docs
	$(BIN)/python docs/site/browse.py build/docs --out out/docs

# fit the bounders that the demos load
refit: $(VENV)/.sims
	$(BIN)/python -m sims.refit

# sdist and wheel in dist/, looked into
dist: $(VENV)/.dev
	$(BIN)/python tools/release dist --out dist

# the wheel as a stranger would use it, in clean environments: of links to what is installed here
wheel-check: $(VENV)/.dev
	$(BIN)/python tools/release check

# the same, and no page of results may be older than the code that it measures; then with all that pip fetches
release-check: wheel-check measured

release-check-full: $(VENV)/.dev measured
	$(BIN)/python tools/release check --full

measured: $(VENV)/.dev
	$(BIN)/python tools/release/measured.py

# which versions each supported Python would get
resolve: $(VENV)/.dev
	$(BIN)/python tools/release resolve

# a part of the tests with the lowest versions that are allowed, constraints-min.txt
lowest: $(VENV)/.dev
	$(BIN)/python tools/release lowest

lint: $(VENV)/.lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# An extra of pyproject.toml, installed. The compiling of every module of every package is left to its first import.
EXTRAS := show sims test notebooks docs lint dev
$(EXTRAS:%=$(VENV)/.%): $(VENV)/.%: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "warp-bounding needs Python 3.10 or newer, this is " + sys.version.split()[0])'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt --editable '.[$*]'
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache
