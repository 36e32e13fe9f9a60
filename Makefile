# `make` lists the targets. The only needs are Python 3.11+, pip and make.

PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& echo $$python && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
LEGIBILITY := $(BIN)/python -m legibility
STAMP := $(VENV)/.installed

# What `make weights` and `make results` use; each can be set on the command line. Results are
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

# Of each model: its dimension, and its robot in the names of the baselines.
DIM_block-reach-2d := 2
DIM_panda-block-reach := 3
ROBOT_block-reach-2d := 2d
ROBOT_panda-block-reach := panda

export PIP_DISABLE_PIP_VERSION_CHECK := 1
# pyright: do not ask the network for a newer version.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.DEFAULT_GOAL := help
.PHONY: help venv install demo test lint format weights data results bench clean distclean \
	$(MODELS:%=weights-%) $(MODELS:%=weights-%-fast) $(MODELS:%=data-%)

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

weights: $(MODELS:%=weights-%-fast) ## make all shipped weights from nothing, then measure them
	$(MAKE) results

data: $(MODELS:%=data-%)

$(MODELS:%=data-%): data-%: $(STAMP)
	$(LEGIBILITY) data --dim $(DIM_$*) --scenes $(SCENES) --seed $(SEED) --workers $(WORKERS) \
		--demonstrations $(DEMONSTRATIONS) --demonstrated $(DEMONSTRATED) --out $(RUNS)/$*/data

$(MODELS:%=weights-%): weights-%: data-%
	$(LEGIBILITY) train path --data $(RUNS)/$*/data --out $(RUNS)/$*/path --steps $(STEPS) \
		--seed $(SEED) --workers $(WORKERS) --weights src/legibility/weights/$*
	$(LEGIBILITY) train policy --data $(RUNS)/$*/data --out $(RUNS)/$*/policy \
		--steps $(POLICY_STEPS) --seed $(SEED) --validation $(RUNS)/$*/path/validation \
		--weights src/legibility/weights/$*
	for baseline in diffusion-policy legibility-diffuser; do \
		$(LEGIBILITY) train $$baseline --data $(RUNS)/$*/data --out $(RUNS)/$*/$$baseline \
			--steps $(POLICY_STEPS) --seed $(SEED) --validation $(RUNS)/$*/path/validation \
			--weights src/legibility/weights/$$baseline-$(ROBOT_$*) || exit 1; \
	done

# The student of each, and its stage 2.
$(MODELS:%=weights-%-fast): weights-%-fast: weights-%
	$(LEGIBILITY) train distill --teacher $* --data $(RUNS)/$*/data --out $(RUNS)/$*/fast \
		--seed $(SEED) --validation $(RUNS)/$*/path/validation --weights src/legibility/weights/$*-fast

# Everything behind the README's tables and figures. What is done is noted in $(DONE), so an
# interrupted run goes on; new weights, or `rm -r $(DONE)`, have it measured anew.
DONE = $(RUNS)/$(RESULTS)-seed-$(EVALUATION_SEED)
ON = --seed $(EVALUATION_SEED) --json $(RESULTS)/$*.json
SHARED = --workers $(WORKERS) $(ON)
PANDA_SCENES := --model panda-block-reach --goals 2..4
PLANE_SCENES := --model block-reach-2d --goals 2..6
FAST_PANDA_SCENES := --model panda-block-reach-fast --goals 2..4
FAST_PLANE_SCENES := --model block-reach-2d-fast --goals 2..6
dial-block-reach-2d = evaluate dial $(PLANE_SCENES) --scenes 200 $(SHARED)
closed-loop-block-reach-2d = evaluate dial $(PLANE_SCENES) --scenes 200 --closed-loop $(SHARED)
execution-block-reach-2d = evaluate execution $(PLANE_SCENES) --scenes 200 --rollouts 5000 $(SHARED)
dial-panda-block-reach = evaluate dial $(PANDA_SCENES) --scenes 200 $(SHARED)
closed-loop-panda-block-reach = evaluate dial $(PANDA_SCENES) --scenes 100 --levels 11 --samples 2 \
	--closed-loop $(SHARED)
execution-panda-block-reach = evaluate execution $(PANDA_SCENES) --scenes 50 --rollouts 500 $(SHARED)
# The second simulator is one that the arm was not trained in; it needs Python 3.11.
transfer-panda-block-reach = evaluate execution $(PANDA_SCENES) --scenes 50 --rollouts 500 --env pandagym \
	$(SHARED)
dial-block-reach-2d-fast = evaluate dial $(FAST_PLANE_SCENES) --scenes 200 $(SHARED)
closed-loop-block-reach-2d-fast = evaluate dial $(FAST_PLANE_SCENES) --scenes 200 --closed-loop $(SHARED)
execution-block-reach-2d-fast = evaluate execution $(FAST_PLANE_SCENES) --scenes 200 --rollouts 5000 \
	$(SHARED)
dial-panda-block-reach-fast = evaluate dial $(FAST_PANDA_SCENES) --scenes 200 $(SHARED)
closed-loop-panda-block-reach-fast = evaluate dial $(FAST_PANDA_SCENES) --scenes 100 --levels 11 \
	--samples 2 --closed-loop $(SHARED)
execution-panda-block-reach-fast = evaluate execution $(FAST_PANDA_SCENES) --scenes 50 --rollouts 500 \
	$(SHARED)
transfer-panda-block-reach-fast = evaluate execution $(FAST_PANDA_SCENES) --scenes 50 --rollouts 500 \
	--env pandagym $(SHARED)
paper-scene = plan examples/paper.yaml --target 0 --legibility -1:1:9 \
	--figure $(RESULTS)/paper-scene.png --json $(RESULTS)/paper-scene.json
paper-scene-executed = execute examples/paper.yaml --target 0 --legibility -1:1:5 \
	--figure $(RESULTS)/execution.png --video $(RESULTS)/execution.gif \
	--json $(RESULTS)/paper-scene-executed.json
panda-scene = execute examples/panda.yaml --target 0 --legibility -1:1:5 \
	--spectrum $(RESULTS)/panda-scene.png --video $(RESULTS)/panda-scene.gif \
	--json $(RESULTS)/panda-scene.json
table1-2d = evaluate table1 --env 2d --rollouts 1000 $(SHARED)
table1-panda = evaluate table1 --env panda --rollouts 1000 $(SHARED)
table1-pandagym = evaluate table1 --env pandagym --rollouts 100 $(SHARED)
unseen-2d = evaluate unseen --env 2d --scenes 100 $(SHARED)
unseen-panda = evaluate unseen --env panda --scenes 100 $(SHARED)
spectrum-2d = evaluate spectrum --env 2d $(ON)
spectrum-panda = evaluate spectrum --env panda $(ON)
ablations-block-reach-2d = evaluate ablations --model block-reach-2d --goals 2..6 \
	--data $(RUNS)/block-reach-2d/data --out $(RUNS)/block-reach-2d/ablations \
	--training-steps 2000 --scene-numbers 400 $(SHARED)
MEASURED := $(foreach model,$(MODELS) $(MODELS:%=%-fast), \
		dial-$(model) closed-loop-$(model) execution-$(model)) \
	transfer-panda-block-reach transfer-panda-block-reach-fast paper-scene paper-scene-executed panda-scene \
	table1-2d table1-panda table1-pandagym unseen-2d unseen-panda spectrum-2d spectrum-panda \
	ablations-block-reach-2d

results: $(MEASURED:%=$(DONE)/%) ## measure all that the README shows; tables, pictures
	$(LEGIBILITY) report $(RESULTS) --readme README.md --weights src/legibility/weights

$(RUNS)/block-reach-2d/data/demonstrations.json: | $(STAMP)
	$(MAKE) data-block-reach-2d

$(DONE)/ablations-block-reach-2d: | $(RUNS)/block-reach-2d/data/demonstrations.json

# panda-gym has no wheels beyond Python 3.11: what needs it is skipped without it.
$(MEASURED:%=$(DONE)/%): $(DONE)/%: $(wildcard src/legibility/weights/*/*.safetensors) | $(STAMP)
	@case "$($*)" in *pandagym*) $(BIN)/python -c 'import panda_gym' 2>/dev/null || { \
		echo "SKIPPED: $* needs panda-gym, which is not installed"; exit 0; };; esac; \
	echo $(LEGIBILITY) $($*); $(LEGIBILITY) $($*) && mkdir -p $(@D) && touch $@

bench: $(STAMP) ## measure the speed of this machine; leave it alone meanwhile
	$(LEGIBILITY) bench --json $(RESULTS)/bench-cpu.json

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
