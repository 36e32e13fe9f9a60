# `make` lists the targets. The only needs are Python 3.11+, pip and make.

PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& echo $$python && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
LEGIBILITY := $(BIN)/python -m legibility
STAMP := $(VENV)/.installed

# What `make weights` and `make evaluate` use; each can be set on the command line. Evaluations are
# reported on seed 1: scenes of seed 0 were looked at while the sampler was made.
MODEL ?= block-reach-2d
SCENES ?= 12800
STEPS ?= 12000
DEMONSTRATIONS ?= 4
DEMONSTRATED ?= 3200
POLICY_STEPS ?= 8000
SEED ?= 0
WORKERS ?= 2
DATA ?= runs/$(MODEL)/data
RUN ?= runs/$(MODEL)
EVALUATION_SCENES ?= 200
EVALUATION_GOALS ?= 2..6
EVALUATION_SEED ?= 1
ROLLOUTS ?= 5000
RESULTS ?= results
PYTEST_ARGS ?=

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# pyright: do not ask the network for a newer version.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.DEFAULT_GOAL := help
.PHONY: help venv install demo test lint format weights evaluate clean distclean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

venv: $(BIN)/python ## make $(VENV) if it is missing (PYTHON=python3.12 chooses the interpreter)

install: $(STAMP) ## install the package and its tested dependencies into $(VENV)

demo: $(STAMP) ## plan and execute the paper's 2-D scene at nine levels on the shipped weights
	$(LEGIBILITY) plan examples/paper.yaml --target 0 --legibility -1:1:9 \
		--figure out/plan.png --json out/plan.json
	$(LEGIBILITY) execute examples/paper.yaml --target 0 --legibility -1:1:9 \
		--figure out/demo.png --video out/demo.gif --json out/demo.json

test: lint ## lint, then every test
	$(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(STAMP) ## ruff (rules and format) and pyright
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	@if $(BIN)/pyright --version >/dev/null 2>&1; then \
		echo $(BIN)/pyright; $(BIN)/pyright --pythonpath $(BIN)/python; \
	else \
		echo "SKIPPED: pyright cannot start here ('$(BIN)/pyright --version' fails); types are unchecked"; \
	fi

format: $(STAMP) ## let ruff repair what it can
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

weights: $(STAMP) ## make the shipped weights from nothing: data, then training
	$(LEGIBILITY) data --dim 2 --scenes $(SCENES) --seed $(SEED) --workers $(WORKERS) \
		--demonstrations $(DEMONSTRATIONS) --demonstrated $(DEMONSTRATED) --out $(DATA)
	$(LEGIBILITY) train path --data $(DATA) --out $(RUN)/path --steps $(STEPS) --seed $(SEED) \
		--workers $(WORKERS) --weights src/legibility/weights/$(MODEL)
	$(LEGIBILITY) train policy --data $(DATA) --out $(RUN)/policy --steps $(POLICY_STEPS) \
		--seed $(SEED) --validation $(RUN)/path/validation --weights src/legibility/weights/$(MODEL)
	$(MAKE) evaluate

evaluate: $(STAMP) ## measure the shipped weights on scenes never seen; tables, figures, model card
	$(LEGIBILITY) evaluate dial --model $(MODEL) --scenes $(EVALUATION_SCENES) \
		--goals $(EVALUATION_GOALS) --seed $(EVALUATION_SEED) --json $(RESULTS)/dial-$(MODEL).json
	$(LEGIBILITY) evaluate dial --model $(MODEL) --scenes $(EVALUATION_SCENES) \
		--goals $(EVALUATION_GOALS) --seed $(EVALUATION_SEED) --closed-loop \
		--json $(RESULTS)/closed-loop-$(MODEL).json
	$(LEGIBILITY) evaluate execution --model $(MODEL) --scenes $(EVALUATION_SCENES) \
		--goals $(EVALUATION_GOALS) --seed $(EVALUATION_SEED) --rollouts $(ROLLOUTS) \
		--json $(RESULTS)/execution-$(MODEL).json
	$(LEGIBILITY) plan examples/paper.yaml --model $(MODEL) --target 0 --legibility -1:1:9 \
		--figure $(RESULTS)/paper-scene.png --json $(RESULTS)/paper-scene.json
	$(LEGIBILITY) execute examples/paper.yaml --model $(MODEL) --target 0 --legibility -1:1:5 \
		--figure $(RESULTS)/execution.png --video $(RESULTS)/execution.gif \
		--json $(RESULTS)/paper-scene-executed.json
	$(LEGIBILITY) report $(RESULTS) --readme README.md --weights src/legibility/weights

clean: ## remove caches and build products
	rm -rf build dist .pytest_cache .ruff_cache .hypothesis
	find src tests examples -name __pycache__ -type d -prune -exec rm -rf {} +

distclean: clean ## remove $(VENV) as well
	rm -rf $(VENV)

# A venv that failed half-way must not count as made.
$(BIN)/python:
	$(if $(PYTHON),,$(error Python 3.11 or newer is needed; name it with PYTHON=/path/to/python))
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, this is " + sys.version)'
	$(PYTHON) -m venv $(VENV) || { rm -f $@; exit 1; }

# torch comes first and pinned: left to a range, pip may fetch a newer build, gigabytes large.
$(STAMP): pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install -q -c constraints.txt $(shell grep '^torch==' constraints.txt)
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]'
	@touch $@
