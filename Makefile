# `make demo` and `make test` set up what they need; both may be repeated.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
# Headless OpenGL for the preview; the independent clients, the browser and the rival programs of tests and benchmarks.
SYSTEM := libegl1 libgl1-mesa-dri $(if $(shell $(PYTHON) -c "import ensurepip" 2>&1),$(PYTHON)-venv)
PEERS := gphoto2 nqc chromium pfstools

.PHONY: setup system peers demo test test-long check bench serve clean

setup: $(VENV)/ready

$(VENV)/ready: requirements/dev.txt pyproject.toml | system
	@command -v $(PYTHON) >/dev/null || { echo "Python 3.11 or newer is needed: make PYTHON=python3.12 ..."; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes -r requirements/dev.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

system:
	@bash scripts/install-system-packages $(SYSTEM)

peers:
	@bash scripts/install-system-packages $(PEERS)

demo: setup
	$(BIN)/rig demo --out $(OUT)/demo

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/mypy

# A worker for each core; a file's tests stay together, for they share rigs and sessions.
test: check peers
	$(BIN)/python -m pytest -n auto --dist loadfile

test-long: setup
	$(BIN)/python -m pytest -m long

# Every benchmark in its short form, and the picture of all.
bench: setup peers
	for name in $(basename $(notdir $(wildcard tests/benchmarks/*.py))); do \
		$(BIN)/rig bench $$name $(OUT)/bench-$$name.json --quick || exit 1; done
	$(BIN)/rig bench report --records $(OUT)

serve: setup
	$(BIN)/rig serve --simulated

clean:
	rm -rf $(OUT) .mypy_cache .pytest_cache .ruff_cache
