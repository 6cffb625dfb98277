# Small matrices gain nothing from threads in BLAS, and the work is parallel in processes.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1

PYTHON ?= python3
BIN := .venv/bin
# Neighbours go to one worker, so that what the tests of a module share is flown once.
WORKERS := pytest -n 2 --dist worksteal

.DEFAULT_GOAL := help
.PHONY: help venv ablation policies test quick nightly clients lint docs linkcheck wheel clean

help:  ## Show this help
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

venv: .venv/.installed  ## Install the project and its tools into .venv, in the tested versions

.venv/.installed: .venv/.studies
	$(BIN)/pip install -q -c constraints.txt -e '.[dev]'
	touch $@

.venv/.studies: pyproject.toml constraints.txt  # what trainings and studies need, two thirds of all
	$(PYTHON) -m venv .venv
	$(BIN)/pip install -q -c constraints.txt torch
	$(BIN)/pip install -q -c constraints.txt -e '.[train,report]'
	touch $@

ablation: .venv/.studies  ## Train and score agents on every estimator, and write the report to results/ablation
	$(BIN)/python -m scripts.ablate studies/corvette.toml --out results/ablation

POLICIES := PunaUAV-v0 SegorogeniAUV-v0 ItsunusaAUV-v0 SigmaCorvette-v0
.PHONY: $(POLICIES)
RUNS := 1
SigmaCorvette-v0: RUNS := 3  # of which the best on tuning seeds is kept

policies: .venv/.studies  ## Train the policies that come with the package anew, and write their scores into docs/agents.md
	$(MAKE) -j 2 $(POLICIES)
	$(BIN)/python -m studies.tables agents

$(POLICIES):  # curves of the training stay in results
	$(BIN)/python -m scripts.train $@ --runs $(RUNS) --force --out results/policies/$@
	cp results/policies/$@.npz agents/policies/trained/

test: venv  ## Run the tests: of many cases a selection with every value, of environments three, of slow tests one
	$(BIN)/python -m $(WORKERS)

quick: venv  ## Run one case of each test that is not slow, which takes a minute in all
	$(BIN)/python -m $(WORKERS) -m "not slow and not further and not nightly"

nightly: venv  ## Run all cases, and the tests that take minutes (half an hour)
	$(BIN)/pyright --pythonpath $(BIN)/python tests/user_code.py  # which loads itself from npm once
	VESSEL_GYM_OPTIMISE=1 $(BIN)/python -m $(WORKERS) -m "slow or nightly"

clients: venv  ## Train learners of other libraries, each in its own environment, and check what they stored
	$(BIN)/python -m pytest -m "" -rP tests/clients

lint: venv  ## Check style, format, types, spelling and the language of pages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file= --follow-imports=silent tests/user_code.py
	$(BIN)/codespell
	$(BIN)/python .ci/readability.py

docs: .venv/.docs  ## Build the documentation site into docs/_build/html; a warning is an error
	rm -rf docs/api/generated  # pages of names that are gone
	VESSEL_GYM_OPTIMISE=0 $(BIN)/sphinx-build -W --keep-going -n -q docs docs/_build/html

linkcheck: .venv/.docs  ## Look up every link of the site that leads elsewhere (needs the network)
	$(BIN)/sphinx-build -q -b linkcheck docs docs/_build/linkcheck

.venv/.docs: .venv/.installed
	$(BIN)/pip install -q -c constraints.txt -e '.[docs]'
	touch $@

wheel:  ## Build sdist and wheel, and try the wheel in empty environments of every Python of 3.11 to 3.14
	PYTHON=$(PYTHON) .ci/wheel

clean:  ## Remove the environment, caches and build products (results stay)
	rm -rf .venv build dist docs/_build docs/examples docs/api/generated docs/_static/episode.html *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -type d -name __pycache__ -prune -exec rm -rf {} +
