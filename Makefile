# Everything needs Python 3.11 with venv; the rest is installed into .venv with the versions of constraints.txt.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
# Two processes that share a machine's cores do best with one thread each.
export OMP_NUM_THREADS ?= 1
# Images of Docker often set it: each process of the tests would then compile every module again, 6 s of a core.
unexport PYTHONDONTWRITEBYTECODE
# For whoever edits a function: no training, browser, cluster or fresh process.
QUICK := not slow and not training and not browser and not cluster and not benchmark

# Where `make score` writes entries, leaderboard.json and index.html. Git ignores results/. Of leaderboard/ it keeps what
# `make rescore` measures, and ignores the page, which `make board` builds.
OUT ?= results

# What is compared by default: every timestep of the 50 episodes. `make score ALL=1` takes every explainer on every
# policy but checkpoints along training. To act on an explanation asks for one at every step, so the team plays on the
# masks of the fastest explainers alone.
ifdef ALL
OTHERS := gnn_explainer gnn_explainer-tuned graphmask graphmask-pyg influence integrated_gradients shapley
OTHERS += $(addsuffix -messages,gnn_explainer gnn_explainer-tuned graphmask integrated_gradients shapley)
SCORE_OPTIONS ?= --submitter xmarl-bench --policy finished --explainer all $(OTHERS:%=--no-behaviour %)
else
OTHERS := gnn_explainer graphmask
SCORE_OPTIONS ?= --policy default --explainer attention $(OTHERS:%=--explainer %) $(OTHERS:%=--no-behaviour %)
endif

.DEFAULT_GOAL := help
.PHONY: help venv score larger quick test suite lint type rescore board docs bench wheel-test \
	test-pythons test-lowest test-newest

help:  ## Show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

venv: $(STAMP)  ## Create .venv and install the project with its pinned versions

# Python compiles a module when it is first imported; to compile everything installed would take a minute more.
$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable '.[dev]'
	touch $@

score: $(STAMP)  ## Score three explainers on each cell's best policy; ALL=1: all on all
	$(BIN)/xmarl-bench score --jobs 2 --out $(OUT) $(SCORE_OPTIONS)

quick: $(STAMP)  ## Run the tests that take half a minute together
	$(BIN)/python -m pytest --numprocesses 2 -m "$(QUICK)"

# Types need one process, which beside the suite costs little time of its own.
test: lint  ## Run all checks: lint, types and the whole test suite
	$(MAKE) --jobs 2 type suite

# Tests wait for processes that they start: three at a time keep two cores busy.
suite: $(STAMP)
	$(BIN)/python -m pytest --numprocesses 3

test-pythons:  ## Test on every Python at hand what needs no torch; WHOLE=1: everything
	$(PYTHON) tests/pythons.py $(if $(WHOLE),--whole)

test-lowest:  ## Test the lowest versions that pyproject.toml allows; WHOLE=1: with torch
	$(PYTHON) tests/pythons.py --lowest $(if $(WHOLE),--whole) 3.11

test-newest:  ## Test the environments with the newest releases of their clients
	$(PYTHON) tests/pythons.py --newest 3.11

lint: $(STAMP)  ## Check style and format with ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

# Mypy meets the parts of a tuple in the order of a set: without a fixed seed it infers one type or another.
type: $(STAMP)  ## Check types of packages and tests with mypy
	PYTHONHASHSEED=0 $(BIN)/mypy

# Policies of five agents in larger teams, at some timesteps of each episode: 2^N rows are tried for each agent.
LARGER_OPTIONS ?= --submitter xmarl-bench --policy finished --explainer all --no-behaviour all --agents 5 --team 8 --team 10 \
	--task blind_navigation_v0 --task blind_discovery_v0 --timesteps 40

larger: $(STAMP)  ## Score policies of five agents in teams of eight and ten
	$(BIN)/xmarl-bench score --jobs 2 --out $(OUT) $(LARGER_OPTIONS)

SIGNED ?= xmarl-bench

rescore: $(STAMP)  ## Score all on all into leaderboard/, verify every entry, then `make board`: hours
	$(MAKE) score ALL=1 OUT=leaderboard
	$(MAKE) larger OUT=leaderboard
	$(BIN)/xmarl-bench board explainers
	$(BIN)/xmarl-bench verify leaderboard --tier full --by $(SIGNED) --resume --jobs 2
	$(MAKE) board

board: $(STAMP)  ## Build the page, its animations and the documents from leaderboard/entries
	$(BIN)/xmarl-bench board build leaderboard --animations
	for each in ranking findings scaling metrics meta; do $(BIN)/python docs/make_$$each.py || exit 1; done
	for family in residual paper; do $(BIN)/xmarl-bench study main --entries leaderboard --policy $$family \
		--no-figures --out study/main-$$family || exit 1; done
	$(BIN)/python -m xmarl_bench.papers.kailas2025.reproduction study/main-residual study/main-paper

docs: $(STAMP)  ## Build the documentation site into site/
	$(BIN)/python -m pip install --quiet --constraint constraints.txt 'mkdocs<2' mkdocs-material
	$(BIN)/python docs/make_site.py

BENCH := .benchmarks/latest.json

bench: $(STAMP)  ## Measure tasks, explainers and trainer beside those of others, for docs/performance.md
	mkdir -p $(dir $(BENCH))
	$(BIN)/python -m pytest --benchmark-only --benchmark-json=$(BENCH) tests/benchmarks; measured=$$?; \
	$(BIN)/python docs/make_performance.py $(BENCH) && exit $$measured

wheel-test: $(STAMP)  ## Build the wheel and try it outside the repository
	PYTHON=$(BIN)/python bash tests/wheel_test.sh
