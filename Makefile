# Two commands on a fresh machine: `make scan` and `make test`.  Each sets up .venv first.

PYTHON ?= python3
MESH ?= meshes/egg.stl
OUT ?= out
ARGS ?=

.PHONY: scan test docs

scan: .venv/installed
	.venv/bin/scan3d scan $(MESH) --out $(OUT)

test: .venv/installed
	.venv/bin/python -m pytest $(ARGS)

# The manual, in docs/_build/html.
docs: .venv/docs
	.venv/bin/python -m sphinx --fresh-env --fail-on-warning --keep-going --quiet -b html docs docs/_build/html
	.venv/bin/python docs/check_links.py docs/_build/html

.venv/docs: .venv/installed
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	.venv/bin/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	touch $@
