# Each target does all the set-up it needs; a fresh machine needs only Python 3.11 (or 3.13) and make.
PYTHON ?= $(shell command -v python3.11 || command -v python3.13 || command -v python3)
BIN := .venv/bin

.PHONY: demo test long check lint bench extension window setup clean

setup:
	@$(PYTHON) tools/prepare.py

demo: setup
	$(BIN)/wrinkle demo --out demo-out $(DEMO)

test: setup
	$(BIN)/pytest -m "not long" $(TESTS)

long: extension
	$(BIN)/pytest -m long
	$(PYTHON) tools/other_blenders.py

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright --level error --pythonpath $(BIN)/python

check: lint test

bench: setup
	for file in benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

extension: setup
	$(BIN)/python tools/extension.py
	$(BIN)/python tools/main_job.py

window: extension
	$(BIN)/python tools/window.py $(WINDOW)

.PHONY: docs
docs:
	@$(PYTHON) tools/docs.py

clean:
	rm -rf .venv .venv-docs build dist demo-out
