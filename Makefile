# A newcomer's two commands: `make demo` and `make test`. Both set up everything they need.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: setup demo test lint clean

setup: $(READY)

$(READY): pyproject.toml constraints.txt .ci/install_system.sh
	sh .ci/install_system.sh $(PYTHON)
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet -c constraints.txt --upgrade pip
	$(BIN)/pip install --quiet -c constraints.txt -e '.[test]'
	touch $@

demo: $(READY)
	$(BIN)/python -m data_tools.synthetic_pairs --split demo -o demo_output/pair
	$(BIN)/scenediff-classic detect demo_output/pair/demo_0000/before demo_output/pair/demo_0000/after \
	  -o demo_output/result --overwrite

test: $(READY)
	$(BIN)/python -m pytest -m 'not slow' -n 2 --dist loadscope

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports

clean:
	rm -rf $(VENV) build dist demo_output *.egg-info
