# Two commands on a fresh machine: `make scan` and `make test`.  Each sets up .venv first; `make help` lists the others.

PYTHON ?= python3
MESH ?= meshes/egg.stl
OUT ?= out
ARGS ?=
# Tests that run side by side; each keeps to one thread, so that they do not take the cores from each other.
WORKERS ?= 2
# Random inputs, and random scans, of `make trust`.
FUZZ ?= 2000
# Pictures of `make figures`, by name; empty: all.
FIGURES ?=
PYTEST = OMP_NUM_THREADS=1 .venv/bin/python -m pytest -n $(WORKERS) --dist worksteal
PIP = .venv/bin/python -m pip install --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help scan test fast trust lint format check mutants docs figures dev

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-9s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo "ARGS='...' hands options on to pytest or to the mutation tests; WORKERS=$(WORKERS) tests run side by side"

scan: .venv/installed ## scan MESH=meshes/egg.stl into OUT=out
	.venv/bin/scan3d scan $(MESH) --out $(OUT)

test: .venv/test ## run all tests but the long ones of make trust (ten minutes on two cores)
	@echo "All tests, $(WORKERS) at a time: ten minutes on two cores.  make fast takes a minute and a half."
	$(PYTEST) $(ARGS)

fast: .venv/test ## run the tests that are not marked slow (a minute and a half on two cores)
	@echo "The tests that are not marked slow, $(WORKERS) at a time: a minute and a half on two cores."
	$(PYTEST) -m "not slow and not trust" $(ARGS)

lint: .venv/dev ## check style, format, types and imports
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports

format: .venv/dev ## put the code into the project's format
	.venv/bin/ruff check --fix .
	.venv/bin/ruff format .

check: lint fast ## lint and fast: what to run before a commit

trust: .venv/test ## the long tests of what is promised: bounds, crashes, odd files, FUZZ=2000 random inputs (hours)
	FUZZ=$(FUZZ) $(PYTEST) -m trust $(ARGS)
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.bounds --count $(FUZZ)
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.bounds --count $(FUZZ) --model spatial
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.faults
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.faults --group strong --slices 13
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.faults --group rig --slices 8
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.unmeasured_rows
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.calibrations
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.calibrations --reference plane
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.calibrations --mixing 0.01 --count 40
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.calibrations --trial --count 10
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.rig_bounds
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.hidden_contacts
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.probing
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.reach
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.robustness.reach --bead 0.08 --bodies 50

mutants: .venv/dev ## mutation tests: change the code in small ways, print the changes that no test notices
	.venv/bin/python tests/robustness/mutants.py $(ARGS)

docs: .venv/docs ## build the manual in docs/_build/html
	.venv/bin/python -m sphinx --fresh-env --fail-on-warning --keep-going --quiet -b html docs docs/_build/html
	.venv/bin/python docs/check_links.py docs/_build/html

figures: .venv/installed ## remake the pictures of README and manual (half an hour), or FIGURES='NAME ...'
	.venv/bin/python docs/make_pictures.py $(FIGURES)

dev: .venv/dev .venv/docs ## set up .venv with the linters, the type checker and Sphinx

.venv/dev: .venv/test
	$(PIP) --editable '.[dev]'
	touch $@

.venv/docs: .venv/installed
	$(PIP) --editable '.[docs]'
	touch $@

.venv/installed: pyproject.toml
	@echo "Setting up .venv with what a scan needs (0.96 GB): a minute or more, as the network is."
	$(PYTHON) -m venv .venv
	$(PIP) --editable .
	touch $@

.venv/test: .venv/installed
	@echo "Adding what the tests need (another 0.9 GB)."
	$(PIP) --editable '.[test]'
	touch $@
