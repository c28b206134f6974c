# Two commands on a fresh machine: `make scan` and `make test`.  Each sets up .venv first.

PYTHON ?= python3
MESH ?= meshes/egg.stl
OUT ?= out
ARGS ?=

.PHONY: scan test

scan: .venv/installed
	.venv/bin/scan3d scan $(MESH) --out $(OUT)

test: .venv/installed
	.venv/bin/python -m pytest $(ARGS)

.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@
