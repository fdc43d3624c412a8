# Train, evaluate and test TS-JEPA; `make help` lists the targets. Needs neither root nor an activated environment.

# The interpreter for a new environment; without one, the first suitable of those named in the setup rule.
PYTHON ?=
VENV ?= .venv
# Added to `pip install`, for example to choose where torch comes from.
PIP_FLAGS ?=

# A folder of small recipes over those of the main job; for example: make train-jepa OVER=recipes/smoke
OVER ?=
# The recipe $(1) and, where OVER has one of that name, the one over it.
layers = --config recipes/$(1).yaml $(if $(wildcard $(OVER)/$(1).yaml),--config $(OVER)/$(1).yaml)

# The entry that `make zoo` makes again.
ENTRY ?= tsjepa-cartpole-d16

# Python of the environment that has `tsjepa[bench]`, for the benchmarks beside other libraries; see peers.py.
PEERS_PYTHON ?= $(BIN)/python
BENCHMARKS := camera training_step network fleet collection latency loading memory quality

BIN := $(VENV)/bin
# A file of tests stays in one process, because its tests share what they made; their order is that of tests/conftest.py.
PYTEST = $(BIN)/python -m pytest --numprocesses logical --maxprocesses 8 --dist loadfile --no-loadscope-reorder
# Which tests; all of them without it.
TESTS ?=
STAMP := $(VENV)/.setup-done

.PHONY: help setup zoo train-jepa train-actor train-supervised train-autoencoder data evaluate demo figures figures-check report test test-fast lint types docs wheel faults audit bench

help: ## print this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "%-18s %s\n", $$1, $$2}' Makefile

setup: $(STAMP) ## create the environment in .venv and install everything into it
	@grep -q tsjepa.cli $(BIN)/lightning || $(BIN)/python -m pip install -q --no-deps -e .

$(STAMP): pyproject.toml
	@if ! $(BIN)/python -c 'import pip' 2>/dev/null; then \
	  for python in $(if $(PYTHON),"$(PYTHON)",python3 python3.12 python3.11 python3.10); do \
	    "$$python" -c 'import ensurepip, sys, venv; sys.exit(not (3, 10) <= sys.version_info < (3, 13))' 2>/dev/null \
	      && break || python=; \
	  done; \
	  if [ -z "$$python" ]; then \
	    echo "setup needs Python 3.10, 3.11 or 3.12 with its venv module (Debian/Ubuntu: apt install python3-venv)," \
	      "and $(if $(PYTHON),$(PYTHON) is not one,found none); name one with make PYTHON=/path/to/python3.11" >&2; \
	    exit 1; \
	  fi; \
	  "$$python" -m venv $(VENV); \
	fi
	@echo "installing into $(VENV): a few minutes, about 2 GB (more where torch comes with CUDA)"
	$(BIN)/python -m pip install --quiet $(PIP_FLAGS) --upgrade 'pip>=24' # older ones resolve for a quarter of an hour
	$(BIN)/python -m pip install --quiet --no-compile $(PIP_FLAGS) -e '.[test]'
	@$(BIN)/python -m compileall -q -j 0 $(VENV)/lib >/dev/null || true # by all cores, where pip takes one; some files are templates
	@touch $@

train-jepa: setup ## collect the data, train TS-JEPA and the actor, close the loop, print the final table
	$(BIN)/tsjepa fit $(call layers,jepa)
	$(BIN)/tsjepa fit $(call layers,actor)
	$(BIN)/tsjepa evaluate $(call layers,evaluate)

train-actor: setup ## train the semantic actor on the embeddings of a trained TS-JEPA
	$(BIN)/tsjepa fit $(call layers,actor)

train-supervised: setup ## train the supervised baselines, of 2 and of 4 frames, and close the loop with each
	$(BIN)/tsjepa fit --config recipes/supervised.yaml
	$(BIN)/tsjepa evaluate $(call layers,evaluate) --model runs/supervised/model --output runs/supervised/evaluation
	$(BIN)/tsjepa fit --config recipes/supervised.yaml --config recipes/supervised-k4.yaml
	$(BIN)/tsjepa evaluate $(call layers,evaluate) --model runs/supervised-k4/model --output runs/supervised-k4/evaluation

train-autoencoder: setup ## train the generative baseline and close the loop with it
	$(BIN)/tsjepa fit --config recipes/autoencoder.yaml
	$(BIN)/tsjepa evaluate $(call layers,evaluate) --model runs/autoencoder/model --output runs/autoencoder/evaluation

data: setup ## collect the data sets from dm-control pixels
	$(BIN)/tsjepa collect $(call layers,data)

evaluate: setup ## close the loop on held-out starts and print the table
	$(BIN)/tsjepa evaluate $(call layers,evaluate)

zoo: setup ## make an entry of the zoo again, from nothing to its card: make zoo ENTRY=tsjepa-reacher
	$(BIN)/tsjepa zoo train $(ENTRY)

demo: setup ## a pretrained model controls cart-poles over a lossy link: a table, and a film in runs/demo
	$(BIN)/tsjepa simulate --config recipes/demo.yaml

figures: setup ## redraw every figure of the paper from the recorded results
	$(BIN)/tsjepa figures

figures-check: setup ## run a small point of every recorded sweep again and compare
	$(BIN)/tsjepa figures --check true

report: setup ## write docs/results/report.md and report.html: each figure beside the paper's claims
	$(BIN)/tsjepa report

test: setup ## run all tests, on every core, each on one thread
	$(PYTEST) $(TESTS)

test-fast: setup ## run the tests that take no longer than two seconds each
	$(PYTEST) -m 'not slow and not benchmark' $(TESTS)

faults: setup ## kill every command fifty times and record what survives (about ten minutes)
	$(BIN)/python tests/faults/kills.py --kills 50

bench: setup ## measure everything beside its peers and limits, on an otherwise idle machine, and print the table (about three quarters of an hour)
	$(BIN)/python -m pytest -q -m benchmark tests/test_benchmarks.py
	@failed=; for name in $(BENCHMARKS); do $(BIN)/python tests/benchmarks/$$name.py || failed="$$failed $$name"; done; \
	$(PEERS_PYTHON) tests/benchmarks/peers.py || failed="$$failed peers"; \
	$(BIN)/python tests/benchmarks/table.py; \
	if [ -n "$$failed" ]; then echo "failed:$$failed" >&2; exit 1; fi

audit: setup ## look up the installed packages in the database of known vulnerabilities (needs the network)
	$(BIN)/python -m pip install --quiet $(PIP_FLAGS) -e '.[audit]'
	$(BIN)/pip-audit --skip-editable

lint: setup ## check style and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup ## check the types of what users call
	$(BIN)/python -m mypy

docs: setup ## build the documentation site into docs/_build/html; warnings are errors
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

wheel: setup ## build the wheel into dist and check it as the package index does
	$(BIN)/python -m hatchling build -t wheel
	$(BIN)/python -m twine check --strict dist/*.whl
