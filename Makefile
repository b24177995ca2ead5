# From a fresh clone to pictures: `make demo`.  Needs Python 3.11 or newer (with venv) and make.
#
#   make demo      environment, then scan the step block into out/demo
#   make test      lint, types, and the quick tests: less than about ten seconds each
#   make test-all  the slow tests too, and the statistical ones that repeat an analysis many times
#   make bench     timings only (tests/benchmarks)
#   make lint      ruff, mypy, and who may import whom
#   make dist      wheel and source archive into dist/, each tested in a clean environment
#   make docs      the documentation as a website, into out/docs
#   make clean     remove everything that make has made, the environment included
#
# Another interpreter: make PYTHON=/path/to/python3.12 demo

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet -c constraints.txt

# Stamps: the environment is installed again only when what it is made from changes.
RUN_STAMP := $(VENV)/.installed
TEST_STAMP := $(VENV)/.installed-test
DOCS_STAMP := $(VENV)/.installed-docs
INSTALLED_FROM := pyproject.toml constraints.txt

.DELETE_ON_ERROR:
.PHONY: demo test test-all bench lint dist docs clean

demo: $(RUN_STAMP)
	$(BIN)/slbench scan step-block --out out/demo
	@echo "The pictures are in $(CURDIR)/out/demo"

# The tests of a file share what they make: loadfile keeps them in one of the two workers.
test: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow and not statistics" --benchmark-disable

test-all: lint
	$(BIN)/python -m pytest --benchmark-disable

bench: $(TEST_STAMP)
	$(BIN)/python -m pytest tests/benchmarks

lint: $(TEST_STAMP)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

dist: $(TEST_STAMP)
	.ci/dist $(PYTHON)

# Warnings are errors: a broken link, reference or formula fails the build.
docs: $(DOCS_STAMP)
	$(BIN)/python -m sphinx -b html -n -W --keep-going -q -d out/docs-cache docs out/docs
	@echo "Open $(CURDIR)/out/docs/index.html"

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	    echo "make: slbench needs Python 3.11 or newer, and $(PYTHON) is not: make PYTHON=/path/to/python3.11" >&2; \
	    exit 1; }
	$(PYTHON) -m venv $(VENV)

$(RUN_STAMP): $(INSTALLED_FROM) | $(BIN)/python
	$(PIP) -e .
	@touch $@

# The test environment contains the plain one, so both stamps are set.
$(TEST_STAMP): $(INSTALLED_FROM) | $(BIN)/python
	$(PIP) -e '.[test]'
	@touch $(RUN_STAMP) $@

$(DOCS_STAMP): $(INSTALLED_FROM) | $(BIN)/python
	$(PIP) -e '.[docs]'
	@touch $(RUN_STAMP) $@

clean:
	rm -rf $(VENV) out dist build .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find slbench tests -name __pycache__ -type d -prune -exec rm -rf {} +
