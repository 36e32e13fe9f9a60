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
MODELS ?= block-reach-2d panda-block-reach
SCENES ?= 12800
STEPS ?= 12000
DEMONSTRATIONS ?= 4
DEMONSTRATED ?= 3200
POLICY_STEPS ?= 8000
SEED ?= 0
WORKERS ?= 2
RUNS ?= runs
EVALUATION_SEED ?= 1
RESULTS ?= results
PYTEST_ARGS ?=

# Of each model: its dimension and what is evaluated.
DIM_block-reach-2d := 2
DIM_panda-block-reach := 3
GOALS_block-reach-2d := 2..6
GOALS_panda-block-reach := 2..4
CLOSED_LOOP_block-reach-2d := --scenes 200
CLOSED_LOOP_panda-block-reach := --scenes 100 --levels 11 --samples 2
EXECUTION_block-reach-2d := --scenes 200 --rollouts 5000
EXECUTION_panda-block-reach := --scenes 50 --rollouts 500

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# pyright: do not ask the network for a newer version.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.DEFAULT_GOAL := help
.PHONY: help venv install demo test lint format weights evaluate clean distclean \
	$(MODELS:%=weights-%) $(MODELS:%=evaluate-%) $(MODELS:%=more-%)

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

venv: $(BIN)/python ## make $(VENV) if it is missing (PYTHON=python3.12 chooses the interpreter)

install: $(STAMP) ## install the package and its tested dependencies into $(VENV)

demo: $(STAMP) ## plan and execute a scene on the shipped weights (ARM=1: the Panda instead)
ifdef ARM
	$(LEGIBILITY) execute examples/panda.yaml --target 0 --legibility -1:1:5 \
		--spectrum out/arm.png --video out/arm.gif --json out/arm.json
else
	$(LEGIBILITY) plan examples/paper.yaml --target 0 --legibility -1:1:9 \
		--figure out/plan.png --json out/plan.json
	$(LEGIBILITY) execute examples/paper.yaml --target 0 --legibility -1:1:9 \
		--figure out/demo.png --video out/demo.gif --json out/demo.json
endif

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

weights: $(MODELS:%=weights-%) ## make the shipped weights from nothing, then measure them
	$(MAKE) evaluate

$(MODELS:%=weights-%): weights-%: $(STAMP)
	$(LEGIBILITY) data --dim $(DIM_$*) --scenes $(SCENES) --seed $(SEED) --workers $(WORKERS) \
		--demonstrations $(DEMONSTRATIONS) --demonstrated $(DEMONSTRATED) --out $(RUNS)/$*/data
	$(LEGIBILITY) train path --data $(RUNS)/$*/data --out $(RUNS)/$*/path --steps $(STEPS) \
		--seed $(SEED) --workers $(WORKERS) --weights src/legibility/weights/$*
	$(LEGIBILITY) train policy --data $(RUNS)/$*/data --out $(RUNS)/$*/policy \
		--steps $(POLICY_STEPS) --seed $(SEED) --validation $(RUNS)/$*/path/validation \
		--weights src/legibility/weights/$*

evaluate: $(MODELS:%=evaluate-%) ## measure the shipped weights on scenes never seen; tables, pictures
	$(LEGIBILITY) report $(RESULTS) --readme README.md --weights src/legibility/weights

$(MODELS:%=evaluate-%): evaluate-%: $(STAMP)
	$(LEGIBILITY) evaluate dial --model $* --scenes 200 --goals $(GOALS_$*) \
		--seed $(EVALUATION_SEED) --json $(RESULTS)/dial-$*.json
	$(LEGIBILITY) evaluate dial --model $* $(CLOSED_LOOP_$*) --goals $(GOALS_$*) \
		--seed $(EVALUATION_SEED) --closed-loop --json $(RESULTS)/closed-loop-$*.json
	$(LEGIBILITY) evaluate execution --model $* $(EXECUTION_$*) --goals $(GOALS_$*) \
		--seed $(EVALUATION_SEED) --json $(RESULTS)/execution-$*.json
	$(MAKE) more-$*

more-block-reach-2d: $(STAMP)
	$(LEGIBILITY) plan examples/paper.yaml --target 0 --legibility -1:1:9 \
		--figure $(RESULTS)/paper-scene.png --json $(RESULTS)/paper-scene.json
	$(LEGIBILITY) execute examples/paper.yaml --target 0 --legibility -1:1:5 \
		--figure $(RESULTS)/execution.png --video $(RESULTS)/execution.gif \
		--json $(RESULTS)/paper-scene-executed.json

# The second simulator is one that the arm was not trained in; it needs Python 3.11.
more-panda-block-reach: $(STAMP)
	$(LEGIBILITY) evaluate execution --model panda-block-reach $(EXECUTION_panda-block-reach) \
		--goals $(GOALS_panda-block-reach) --seed $(EVALUATION_SEED) --env pandagym \
		--json $(RESULTS)/transfer-panda-block-reach.json
	$(LEGIBILITY) execute examples/panda.yaml --target 0 --legibility -1:1:5 \
		--spectrum $(RESULTS)/panda-scene.png --video $(RESULTS)/panda-scene.gif \
		--json $(RESULTS)/panda-scene.json

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
