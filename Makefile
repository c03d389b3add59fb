# `make demo`, `make live` and `make test` do everything on a machine that has Python 3.11+, make and git.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALL = $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt

# Hundreds of processes load the same modules: what Python makes of these is kept, whatever is otherwise wanted.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo live line test test-all release-check coverage lint javascript bench bench-smallest study docs wheel-check clean

demo: $(VENV)/.demo
	@mkdir -p demo
	$(BIN)/kitassist solve domains/kitting/paper.pddl
	@echo
	$(BIN)/kitassist simulate domains/kitting/paper.pddl --humans 3 \
		--policy none --policy reactive --policy attention --episodes 100 --seed 0 \
		--trace demo/trace.jsonl --figure demo/episode.png
	@echo
	@echo "One episode as a picture: demo/episode.png; every action of all of them: demo/trace.jsonl"

# A first look at the live assistant for one person: two others are simulated; the links are printed.
live: $(VENV)/.live
	@$(BIN)/kitassist serve domains/kitting/paper.pddl --humans 3 --simulate 2 --c-suggest 0.2

# A line without hardware: a broker, three stations, a robot and the assistant, until all have finished.
line: $(VENV)/.line
	@$(BIN)/python docs/examples/line.py

test: $(VENV)/.test
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal -m "not slow"

# The same with more examples of each law, and tests that take long: kills, a cluster, longer versions of others.
test-all: $(VENV)/.test
	$(BIN)/python -m pytest --numprocesses auto --dist worksteal --hypothesis-profile=thorough

# Before a release: all tests, and the smallest case of every benchmark (of the paper's study: the figures on record).
release-check:
	$(MAKE) test-all
	$(MAKE) bench-smallest

# Which lines and branches `make test` runs, subprocesses included; it takes longer.
coverage: export COVERAGE_FILE = $(CURDIR)/.coverage/data
coverage: $(VENV)/.test
	@rm -rf .coverage && mkdir .coverage
	$(BIN)/python -m coverage run -m pytest --numprocesses auto --dist worksteal -m "not slow"
	@$(BIN)/python -m coverage combine --quiet && $(BIN)/python -m coverage report --skip-covered

lint: $(VENV)/.test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The scripts of the pages: their types, faults that a linter finds, and tests of what they share. Needs npm.
javascript:
	@if ! command -v npm >/dev/null; then echo "The scripts of the pages are not checked: there is no npm"; \
	elif ! npm --prefix tests/javascript install --silent --no-audit --no-fund --no-package-lock; then \
		echo "The scripts of the pages are not checked: npm cannot install what tests/javascript/package.json names"; \
	else npm --prefix tests/javascript run --silent check; fi

bench: $(VENV)/.test
	$(BIN)/python bench/run.py

bench-smallest: $(VENV)/.test
	$(BIN)/python bench/run.py --smallest --jobs "$$(nproc)"

study: $(VENV)/.test
	$(BIN)/python bench/study.py --check

docs: $(VENV)/.docs
	$(BIN)/sphinx-build -W --keep-going -q -b html docs site
	@echo "The documentation: site/index.html"

# The wheel by itself, in an empty environment and outside the checkout.
wheel-check:
	@.ci/wheel $(PYTHON)

clean:
	rm -rf $(VENV) .coverage demo jupyter_execute site

# Which packages are installed, and from which versions, is fixed by pyproject.toml and constraints.txt.
$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed; name one with: make PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)

# What is only used, not tested, is compiled when it is: most of it never is. (In tests, what compiling warns of is an error.)
$(VENV)/.demo: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) --no-compile -e '.[plots]'
	@touch $@

$(VENV)/.live: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) --no-compile -e '.[web]'
	@touch $@

$(VENV)/.line: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) --no-compile -e '.[web,mqtt]' iotcore
	@touch $@

$(VENV)/.test: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) -e '.[plots,study,web,mqtt,opcua,ros2,test]'
	@touch $@

$(VENV)/.docs: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) -e '.[plots,study,web,mqtt,opcua,ros2,docs]'
	@touch $@

# All of these at once, which takes hardly longer than one.
$(VENV)/.all: $(VENV)/bin/python pyproject.toml constraints.txt
	$(INSTALL) -e '.[plots,study,web,mqtt,opcua,ros2,test,docs]'
	@touch $(VENV)/.demo $(VENV)/.live $(VENV)/.line $(VENV)/.test $(VENV)/.docs $@
