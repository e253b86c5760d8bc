# Each target works from a clean clone: it sets up what it needs first.
PYTHON ?= python3
BIN := .venv/bin
# Packages come without byte code; kept after the first use, or each of many processes compiles them anew, for 6 s.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: setup demo test test-slow lint bench clean

setup: .venv/dev

# Pinned packages in .venv, and the system packages that headless rendering needs. The lock files are complete, so that
# pip need not look for what a package depends on.
.venv/ready: pyproject.toml requirements.lock scripts/system_packages.sh
	sh scripts/system_packages.sh
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "keycld needs Python 3.11 or newer: make PYTHON=python3.12")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes --requirement requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# With what tests, checks and the package's optional extras need.
.venv/dev: .venv/ready requirements-dev.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile --no-deps --require-hashes --requirement requirements-dev.lock
	touch $@

# Data, training, evaluation, control and report for the pendulum; five to ten minutes on two cores.
demo: .venv/ready
	$(BIN)/keycld demo

# Whole files, in the order of tests/conftest.py: it has the few long ones first.
test: MARKED = not slow
test-slow: MARKED = slow
test test-slow: setup
	sh scripts/system_packages.sh test
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder -m "$(MARKED)"

lint: setup
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

bench: setup
	for bench in benches/*.py; do $(BIN)/python $$bench; done

clean:
	rm -rf .venv .pytest_cache .ruff_cache
