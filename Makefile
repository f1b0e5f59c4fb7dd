# Everything needs Python 3.11 with venv; the rest is installed into .venv with the versions of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
BENCH_STAMP := .venv/.bench-installed
# Two processes that share a machine's cores do best with one thread each.
export OMP_NUM_THREADS ?= 1

# What is compared by default: every timestep of the 50 episodes. `make score ALL=1` takes every explainer on every
# policy but checkpoints along training. The team plays on the masks of attention alone, for to act on an explanation
# asks for one at every step.
ifdef ALL
OTHERS := attention-rowmax gnn_explainer gnn_explainer-tuned gradient graphmask graphmask-pyg integrated_gradients \
	occlusion shapley
SCORE_OPTIONS ?= --policy finished --explainer all $(OTHERS:%=--no-behaviour %)
else
OTHERS := gnn_explainer graphmask
SCORE_OPTIONS ?= --policy default --explainer attention $(OTHERS:%=--explainer %) $(OTHERS:%=--no-behaviour %)
endif

.DEFAULT_GOAL := help
.PHONY: help venv score test lint type bench wheel-test

help:  ## Show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

venv: $(STAMP)  ## Create .venv and install the project with its pinned versions

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

$(BENCH_STAMP): $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev,bench]'
	touch $@

score: $(STAMP)  ## Score each cell's best policy with three explainers and all controls; ALL=1: every policy and explainer
	$(BIN)/xmarl-bench score --jobs 2 $(SCORE_OPTIONS)

test: lint type  ## Run all checks: lint, types and the whole test suite
	$(BIN)/python -m pytest --numprocesses 2

lint: $(STAMP)  ## Check style and formatting with ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

type: $(STAMP)  ## Check types of packages and tests with mypy --strict
	$(BIN)/mypy

bench: $(BENCH_STAMP)  ## Measure environments, explainers and trainer beside VMAS, MPE2, PyG and BenchMARL
	$(BIN)/python -m pytest --benchmark-only tests/benchmarks

wheel-test: $(STAMP)  ## Build the wheel and try it in a clean environment outside the repository
	PYTHON=$(BIN)/python bash tests/wheel_test.sh
