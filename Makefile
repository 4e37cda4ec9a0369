# `make demo` and `make test` set up what they need; both may be repeated.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
SYSTEM := libegl1 libgl1-mesa-dri gphoto2 nqc

.PHONY: setup system demo test test-long check bench serve clean

setup: $(VENV)/ready

$(VENV)/ready: requirements/dev.txt pyproject.toml | system
	@command -v $(PYTHON) >/dev/null || { echo "Python 3.11 or newer is needed: make PYTHON=python3.12 ..."; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements/dev.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

# Headless OpenGL for the preview, and the independent clients of the conformance tests.
system:
	@bash scripts/install-system-packages $(SYSTEM)

demo: setup
	$(BIN)/rig demo --out $(OUT)/demo

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

test: check
	$(BIN)/python -m pytest

test-long: setup
	$(BIN)/python -m pytest -m long

bench: setup
	mkdir -p $(OUT)
	$(BIN)/rig bench demo --json $(OUT)/bench-demo.json

serve: setup
	$(BIN)/rig serve --simulated

clean:
	rm -rf $(OUT) .mypy_cache .pytest_cache .ruff_cache
