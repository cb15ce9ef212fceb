# make demo | test | installed | lint | bench | fuzz | site | packages: each first installs what it needs into .venv with pip.

PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test installed lint bench fuzz site packages picture clean

demo: .venv/base.stamp
	$(BIN)/sitl-mocks demo

test: .venv/dev.stamp
	$(BIN)/pytest -n auto --dist loadfile

# The commands of the docs, from the wheel in an empty environment. This needs a package index.
installed: .venv/dev.stamp
	$(BIN)/python -m tests.installed

lint: .venv/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: .venv/dev.stamp
	$(BIN)/python -m bench

# Nightly: ten million damaged inputs for the parsers of untrusted input, with a new seed each day.
SEED ?= $(shell date +%Y%m%d)
fuzz: .venv/dev.stamp
	nice $(BIN)/python -m tests.fuzz.run --payloads 10000000 --seconds 3600 --seed $(SEED)

# The documentation as a site in build/site; a broken link or anchor is an error.
site: .venv/docs.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "build/site/index.html"

# Installs the wheel and the example projects into an empty environment, and the wheel, the Debian package and the
# container image into empty systems. This needs root, mmdebstrap and other tools. A script that lacks one names it and
# is skipped (exit code 77).
packages: .venv/dev.stamp
	rm -rf build/dist
	$(BIN)/python -m hatchling build -t wheel -d build/dist
	for script in try_plugins try_lowest try_install try_deb try_image; do \
	    tests/packaging/$$script.sh build/dist/*.whl || [ $$? = 77 ] || exit 1; \
	done

picture: .venv/dev.stamp
	$(BIN)/sitl-mocks demo --runs runs/picture
	$(BIN)/ground-tools picture "$$(ls -d runs/picture/* | tail -n 1)" --out docs/demo.png
	$(BIN)/python -m tests.browser.pictures "$$(ls -d runs/picture/* | tail -n 1)" docs

clean:
	rm -rf .venv

.venv/bin/python:
	@echo "creating a Python environment in .venv"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or later is needed; name one with make PYTHON=...")'
	$(PYTHON) -m venv .venv

.venv/base.stamp: pyproject.toml | .venv/bin/python
	@echo "installing dmuca into .venv (once; a minute or two)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

.venv/dev.stamp: pyproject.toml | .venv/bin/python
	@echo "installing dmuca with its test and inspection tools into .venv (once; a few minutes)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev,inspect,train,cluster,fly]'
	@touch .venv/base.stamp $@

.venv/docs.stamp: pyproject.toml | .venv/bin/python
	@echo "installing the tools that build the documentation into .venv (once)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch .venv/base.stamp $@
