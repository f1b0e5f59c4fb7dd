# Everything needs Python 3.11 with venv; the rest is installed into .venv with the versions of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
BENCH_STAMP := .venv/.bench-installed
# Two processes that share a machine's cores do best with one thread each.
export OMP_NUM_THREADS ?= 1

# What is compared by default: every timestep of the 50 episodes. `make score ALL=1` takes every explainer on every
# policy but checkpoints along training. The team does not play on the masks of explainers that optimise: to act on an
# explanation asks for one at every step.
OPTIMISING := gnn_explainer gnn_explainer-tuned graphmask graphmask-pyg integrated_gradients
ifdef ALL
SCORE_OPTIONS ?= --policy finished --explainer all $(OPTIMISING:%=--no-behaviour %)
else
SCORE_OPTIONS ?= --policy default --explainer attention --explainer gnn_explainer --explainer graphmask \
	--no-behaviour gnn_explainer --no-behaviour graphmask
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
