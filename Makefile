# `make demo` does the main job, `make test` runs the test suite; both set up .venv first. Needs Python 3.10+, pip and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo

.PHONY: demo test test-slow fuzz bench notebooks docs docs-check refit lint format clean dist release-check release-check-full resolve lowest

demo: $(VENV)/.installed
	$(BIN)/python -m sims particles --out $(OUT)

# on all cores that this process may use, each worker with a share of the files; a worker that is done helps the others
PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist worksteal

test: $(VENV)/.installed
	$(PYTEST)

# what takes minutes, and only that
test-slow: $(VENV)/.installed
	$(PYTEST) --slow -m slow

# spoil bounders' files for an hour; what certify then calls proven is attacked, and no positive may be denied
MINUTES ?= 60
SEED ?= 0
fuzz: $(VENV)/.installed
	$(BIN)/python tests/fuzz --minutes $(MINUTES) --seed $(SEED) --out out/fuzz

bench: $(VENV)/.installed
	$(BIN)/python benchmarks/inference.py
	$(BIN)/python benchmarks/overhead.py

# execute the notebooks, in place
notebooks: $(VENV)/.installed
	$(BIN)/python notebooks/execute.py

# the documentation site, into build/docs; then all of it in a browser without a window, where there is one, with pictures in out/docs
docs: $(VENV)/.installed
	$(BIN)/python docs/site

docs-check: docs
	$(BIN)/python docs/site/browse.py build/docs --out out/docs

# fit the bounders that the demos load
refit: $(VENV)/.installed
	$(BIN)/python -m sims.refit

# sdist and wheel in dist/, looked into
dist: $(VENV)/.installed
	$(BIN)/python tests/release dist --out dist

# the wheel as a stranger would use it, in clean environments: of links to what is installed here, or of all that pip fetches
release-check: $(VENV)/.installed
	$(BIN)/python tests/release check

release-check-full: $(VENV)/.installed
	$(BIN)/python tests/release check --full

# which versions each supported Python would get
resolve: $(VENV)/.installed
	$(BIN)/python tests/release resolve

# a part of the tests with the lowest versions that are allowed, constraints-min.txt
lowest: $(VENV)/.installed
	$(BIN)/python tests/release lowest

lint: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "warp-bounding needs Python 3.10 or newer, this is " + sys.version.split()[0])'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[all]'
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache
