# `make` lists the targets. The only needs are Python 3.11+, pip and make.

PYTHON ?= $(shell for python in python3 python3.13 python3.12 python3.11 python; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null \
	&& echo $$python && break; done)
VENV ?= .venv
BIN := $(VENV)/bin
LEGIBILITY := $(BIN)/python -m legibility
STAMP := $(VENV)/.installed
WORKERS ?= 2
PYTEST_ARGS ?= -n auto
# Of `make weights`: models, their data and the lengths of their training.
MODELS ?= block-reach-2d panda-block-reach
RUNS ?= runs
SCENES ?= 4096
DEMONSTRATED ?= 3200
STEPS ?= 3500
POLICY_STEPS ?= 8000

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.DEFAULT_GOAL := help
.PHONY: help venv install demo test lint format docs weights results report bench clean distclean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-10s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))

venv: $(BIN)/python ## create $(VENV) if it is missing (PYTHON=python3.12 chooses the interpreter)

install: $(STAMP) ## install the package and its tested dependencies into $(VENV)

demo: $(STAMP) ## plan and execute a scene with the shipped weights (ARM=1: the Panda instead)
ifdef ARM
	$(LEGIBILITY) execute examples/panda.yaml --target 0 --legibility -1:1:5 \
		--spectrum out/arm.png --video out/arm.gif --json out/arm.json
else
	$(LEGIBILITY) plan examples/paper.yaml --target 0 --legibility -1:1:9 --observer paper \
		--figure out/plan.png --json out/plan.json
	$(LEGIBILITY) plan examples/obstacle.yaml --target 0 --legibility -1:1:9 --observer dragan \
		--figure out/obstacle.png --json out/obstacle.json
	$(LEGIBILITY) execute examples/paper.yaml --target 0 --legibility -1:1:9 --observer paper \
		--figure out/demo.png --video out/demo.gif --json out/demo.json
endif

test: lint ## lint, then every test, on all cores with one thread each
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest $(PYTEST_ARGS)

lint: $(STAMP) ## ruff (rules and format) and pyright
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	@if $(BIN)/pyright --version >/dev/null 2>&1; then $(BIN)/pyright --pythonpath $(BIN)/python; \
	else echo "SKIPPED: pyright cannot start here; types are unchecked"; fi

format: $(STAMP) ## apply ruff's fixes and format
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

docs: $(STAMP) ## build the site into build/docs; a warning is an error
	$(BIN)/python -m sphinx -W --keep-going -q -j auto docs build/docs

weights: $(MODELS:%=weights-%) ## make all shipped weights from nothing; interrupted, it resumes

# Every stage of the model, then the baselines, which learn from the same demonstrations.
weights-%: ROBOT = $(if $(findstring panda,$*),panda,2d)
weights-%: DIM = $(if $(findstring panda,$*),3,2)
weights-%: SHOWN = --data $(RUNS)/$*/shown --seed 0 --validation $(RUNS)/$*/policy/validation
weights-%: SHIPPED = src/legibility/weights
weights-%: $(STAMP)
	$(LEGIBILITY) train all --dim $(DIM) --seed 0 --scenes $(SCENES) --demonstrated $(DEMONSTRATED) \
		--steps $(STEPS) --policy-steps $(POLICY_STEPS) --workers $(WORKERS) \
		--out $(RUNS)/$* --weights $(SHIPPED)/$*
	$(LEGIBILITY) train diffusion-policy $(SHOWN) --steps $(POLICY_STEPS) \
		--out $(RUNS)/$*/diffusion-policy --weights $(SHIPPED)/diffusion-policy-$(ROBOT)
	$(LEGIBILITY) train legibility-diffuser $(SHOWN) --steps $(POLICY_STEPS) \
		--out $(RUNS)/$*/legibility-diffuser --weights $(SHIPPED)/legibility-diffuser-$(ROBOT) \
		--json results/tuning-legibility-diffuser-$(ROBOT).json

results: $(STAMP) ## measure what is missing or out of date of experiments.toml (NAMES="…": only these)
	$(BIN)/python tools/experiments.py --workers $(WORKERS) $(NAMES)
	$(MAKE) report

report: $(STAMP) ## render docs/results.md and the model cards
	$(LEGIBILITY) report results --out docs/results.md --pictures results \
		--weights src/legibility/weights

bench: $(STAMP) ## measure the speed of this machine; leave it alone meanwhile
	$(LEGIBILITY) bench --json results/bench-cpu.json

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
