# Environments from locks: one runs Tutti, one also tests and checks it, two have clients of other projects (of single
# controllers, and of whole fleets), one has a PostgreSQL server, one builds the documentation. Set-up is skipped while the stamp is newer than the lock and pyproject.toml.
# `make test PYTHON=python3.13` uses environments of its own, .venv-dev-python3.13.
PYTHON ?= python3
SUFFIX := $(if $(filter python3,$(PYTHON)),,-$(notdir $(PYTHON)))
RUN := .venv$(SUFFIX)
DEV := .venv-dev$(SUFFIX)
THIRDPARTY := .venv-thirdparty$(SUFFIX)
ECOSYSTEM := .venv-ecosystem$(SUFFIX)
POSTGRES := .venv-postgres$(SUFFIX)
DOCS := .venv-docs$(SUFFIX)
WHEEL := .venv-wheel$(SUFFIX)
PAGE := .venv-page$(SUFFIX)
PIP = -m pip --disable-pip-version-check --quiet
INSTALL = $(PIP) install --no-deps --no-build-isolation -e .
SLOWEST = --durations=10

.PHONY: help demo page page-if-possible test test-fast test-live test-slow test-python test-other-pythons test-decisions test-cost test-browser screenshots test-hosts test-docs test-wheel test-nightly test-thirdparty ecosystem test-ecosystem test-ecosystem-nightly test-postgres test-machines test-postgres-nightly check figures docs lock clean

help:
	@echo "make demo             set up, run a job on a simulated fleet, print its report"
	@echo "make page             build the operators' page, which tutti up serves"
	@echo "make test             set up, run all quick tests (7 minutes on two slow cores, less on quick ones)"
	@echo "make test-fast        only those in virtual time;  make test-live: only those with sockets and processes"
	@echo "make test-slow        the other tests in virtual time, which cost more"
	@echo "make test-browser     the operators' page in a real browser (Debian's chromium)"
	@echo "make screenshots      pictures of the page, in build/screenshots, and those of the documents"
	@echo "make test-hosts       two computers, a network that fails, keys in hostile hands (root, for namespaces)"
	@echo "make test-docs        the commands of tutorials and how-to pages, against a simulated fleet"
	@echo "make test-wheel       the demo, and a user's tests, from an installed wheel in an environment of its own"
	@echo "make test-python PYTHON=python3.13   the tests that another Python could change: a tenth"
	@echo "make test-decisions   the decisions of ten campaign seeds, against the recorded ones"
	@echo "make test-cost        run all tests and write what each costs, tests/COST.md"
	@echo "make test-nightly     the long ones: more campaign seeds and random cases, third-party clients"
	@echo "make test-thirdparty  simulated controllers and fleets against clients from PyPI"
	@echo "make test-postgres    the journal in PostgreSQL, on servers that the tests start"
	@echo "make test-machines    computers with coordinators and databases die as a whole (root, for namespaces)"
	@echo "make test-ecosystem   the demo fleet against clients of Bluesky, EPICS, OPC UA, ROS 2, MQTT, and the types of our side"
	@echo "make check            linters, type checks, import contracts"
	@echo "make figures          figures of the project's order and words"
	@echo "make docs             build the documentation as a site, build/site"
	@echo "PYTHON=python3.13     with any of these: use that interpreter"

$(RUN)/.stamp: requirements/run.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Tutti needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv --clear $(RUN)
	$(RUN)/bin/python $(PIP) install --require-hashes -r requirements/run.lock
	$(RUN)/bin/python $(INSTALL)
	touch $@

$(DEV)/.stamp: requirements/dev.lock pyproject.toml
	$(PYTHON) -m venv --clear $(DEV)
	$(DEV)/bin/python $(PIP) install --require-hashes -r requirements/dev.lock
	$(DEV)/bin/python $(INSTALL)
	touch $@

$(THIRDPARTY)/.stamp: requirements/run.lock requirements/thirdparty.lock pyproject.toml
	$(PYTHON) -m venv --clear $(THIRDPARTY)
	$(THIRDPARTY)/bin/python $(PIP) install --require-hashes -r requirements/run.lock
	$(THIRDPARTY)/bin/python $(PIP) install --require-hashes --no-deps -r requirements/thirdparty.lock
	$(THIRDPARTY)/bin/python $(INSTALL)
	touch $@

$(ECOSYSTEM)/.stamp: requirements/run.lock requirements/ecosystem.lock pyproject.toml
	$(PYTHON) -m venv --clear $(ECOSYSTEM)
	$(ECOSYSTEM)/bin/python $(PIP) install --require-hashes -r requirements/run.lock -r requirements/ecosystem.lock
	$(ECOSYSTEM)/bin/python $(INSTALL)
	touch $@

$(POSTGRES)/.stamp: requirements/run.lock requirements/postgres.lock pyproject.toml
	$(PYTHON) -m venv --clear $(POSTGRES)
	$(POSTGRES)/bin/python $(PIP) install --require-hashes -r requirements/run.lock -r requirements/postgres.lock
	$(POSTGRES)/bin/python $(INSTALL)
	touch $@

$(DOCS)/.stamp: requirements/docs.lock pyproject.toml
	$(PYTHON) -m venv --clear $(DOCS)
	$(DOCS)/bin/python $(PIP) install --require-hashes -r requirements/docs.lock
	$(DOCS)/bin/python $(INSTALL)
	touch $@

$(WHEEL)/.stamp: requirements/run.lock
	$(PYTHON) -m venv --clear $(WHEEL)
	$(WHEEL)/bin/python $(PIP) install --require-hashes -r requirements/run.lock
	touch $@

$(PAGE)/.stamp: requirements/page.lock
	$(PYTHON) -m venv --clear $(PAGE)
	$(PAGE)/bin/python $(PIP) install --require-hashes -r requirements/page.lock
	touch $@

# The operators' page, built again when its sources or the locks have changed.
PAGE_SOURCES := $(shell find orchestrator/gateway/page -name node_modules -prune -o -type f -print)
PAGE_BUILT := orchestrator/gateway/static/index.html
$(PAGE_BUILT): $(PAGE)/.stamp tools/build_page.py $(PAGE_SOURCES)
	$(PAGE)/bin/python tools/build_page.py

page: $(PAGE_BUILT)

# A machine where the page cannot be built still runs everything else.
page-if-possible:
	@$(MAKE) --no-print-directory page || echo "the operators' page is not built; tutti up runs without it. To build it: make page"

demo: $(RUN)/.stamp page-if-possible
	$(RUN)/bin/tutti demo
	@echo "a path over two makes, with its error bound and the truth, as a picture: $(RUN)/bin/tutti demo --path -o eight.png"

test: test-fast test-live

test-fast: $(DEV)/.stamp
	PYTHONDONTWRITEBYTECODE= $(DEV)/bin/pytest -m "not live and not slow and not nightly and not browser and not structure and not postgres" -n 2 --dist worksteal $(SLOWEST)

# The dear ones of virtual time, tests/slow.txt.
test-slow: $(DEV)/.stamp
	PYTHONDONTWRITEBYTECODE= $(DEV)/bin/pytest -m "slow and not nightly and not postgres" -n 2 --dist worksteal $(SLOWEST) tests/unit tests/contract tests/cluster

# Syntax and imports of every module, asyncio, typing, SQLite, JSON, random draws: what a version of Python can change.
test-python: $(DEV)/.stamp
	$(DEV)/bin/pytest -m "python and not live and not slow and not nightly and not postgres" -n 2 --dist worksteal tests/unit tests/contract tests/cluster

# The same, or the target that EACH names, on each other version of Python that this machine has.
EACH = test-python
test-other-pythons:
	here=$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])'); for version in 3.11 3.12 3.13; do \
		if [ "$$version" != "$$here" ] && "python$$version" -c '' 2>/dev/null; then \
			$(MAKE) $(EACH) PYTHON="python$$version" || exit 1; fi; done

# A change that is not meant to decide anything otherwise does not. `--write` records what is meant.
test-decisions: $(DEV)/.stamp
	$(DEV)/bin/python tools/campaign_decisions.py 0 9

test-cost: $(DEV)/.stamp
	$(DEV)/bin/python tools/test_cost.py

# Live tests by themselves: their processes have to answer each other in time. They start hundreds of interpreters, so
# compiled modules are kept even where the environment forbids it. Only the folders that have any are collected. Whichever
# process has none left takes the other's: each has a fleet that all tests share.
# Two at once: three had no time on two slow cores, and took as long.
test-live: $(DEV)/.stamp
	PYTHONDONTWRITEBYTECODE= $(DEV)/bin/pytest -m "live and not nightly and not browser and not alone" -n 2 --dist worksteal $(SLOWEST) tests/live tests/contract

# One after the other: they hold keys and buttons down, and look at what moves meanwhile.
test-browser: $(DEV)/.stamp page
	$(DEV)/bin/pytest -m "browser and not nightly" tests/browser $(SLOWEST)

screenshots: $(DEV)/.stamp page
	$(DEV)/bin/python tools/screenshots.py build/screenshots docs/figures

# Two computers as network namespaces, the commands of the pages about them, hostile messages by every role, the page from
# another computer, and jogs by keys. Much of it needs root, else it is skipped. More faults are in test-nightly.
test-hosts: $(DEV)/.stamp
	$(DEV)/bin/pytest -m "alone and not nightly" tests/live $(SLOWEST)

test-docs: $(DEV)/.stamp
	$(DEV)/bin/python tools/reference_pages.py --check
	$(DEV)/bin/python tools/licences.py --check
	$(DEV)/bin/python tools/integration_matrix.py --check
	$(DEV)/bin/pytest tests/live/test_documents_motion.py tests/live/test_documents_operation.py -n 2 --dist loadfile $(SLOWEST)

# What setuptools has left from another build would come into the wheel.
test-wheel: $(DEV)/.stamp $(WHEEL)/.stamp page
	rm -rf build/lib build/bdist.* build/wheel
	$(DEV)/bin/python $(PIP) wheel . --no-deps --no-build-isolation -w build/wheel
	rm -rf tutti.egg-info # its entry points would hide later ones from what runs in this folder
	$(WHEEL)/bin/python $(PIP) install --no-deps --force-reinstall build/wheel/*.whl
	$(DEV)/bin/python tools/wheel_demo.py $(WHEEL)/bin/tutti
	$(DEV)/bin/python tools/wheel_project.py $(WHEEL)/bin/python

test-nightly: $(DEV)/.stamp page test-thirdparty test-slow test-ecosystem test-ecosystem-nightly test-postgres-nightly
	$(DEV)/bin/python tools/campaign_decisions.py
	-$(DEV)/bin/python tools/mutants.py
	$(DEV)/bin/pytest -m "nightly and not live and not browser and not postgres" -n 2 --dist worksteal --timeout 3600 $(SLOWEST)
	$(DEV)/bin/pytest -m "browser and nightly" tests/browser $(SLOWEST)
	$(DEV)/bin/pytest -m "nightly and live and not postgres" -n 2 --dist loadfile --timeout 3600 $(SLOWEST)
	$(MAKE) test-other-pythons EACH="test-fast test-slow"

# Simulated controllers and fleets against clients from PyPI; a skipped test is a failed one.
test-thirdparty: $(THIRDPARTY)/.stamp
	TUTTI_THIRDPARTY=1 $(THIRDPARTY)/bin/pytest tests/thirdparty

# Set up by itself, beside what leaves time for it.
ecosystem: $(ECOSYSTEM)/.stamp

# Clients that are not ours drive the demo fleet by our integrations. Each needs its library: one environment has them all.
test-ecosystem: $(ECOSYSTEM)/.stamp
	$(ECOSYSTEM)/bin/basedpyright -p tests/ecosystem
	TUTTI_ECOSYSTEM=1 PYTHONDONTWRITEBYTECODE= $(ECOSYSTEM)/bin/pytest -o filterwarnings=default -m "not nightly" tests/ecosystem $(SLOWEST)

test-ecosystem-nightly: $(ECOSYSTEM)/.stamp
	TUTTI_ECOSYSTEM=1 $(ECOSYSTEM)/bin/pytest -o filterwarnings=default -m nightly --timeout 3600 tests/ecosystem $(SLOWEST)
	$(ECOSYSTEM)/bin/python tools/integration_matrix.py

# A skipped test is a failed one here. Three at once, which wait most of the time: each process has a server of its own.
test-postgres: $(POSTGRES)/.stamp
	TUTTI_POSTGRES=1 PYTHONDONTWRITEBYTECODE= $(POSTGRES)/bin/pytest -m "postgres and not nightly" -n 3 --dist loadfile tests/live/test_coordinators.py tests/unit/journal $(SLOWEST)

# Three computers as network namespaces, with a database each: root.
test-machines: $(POSTGRES)/.stamp
	TUTTI_POSTGRES=1 PYTHONDONTWRITEBYTECODE= $(POSTGRES)/bin/pytest -m "postgres and not nightly" tests/live/test_machines.py $(SLOWEST)

test-postgres-nightly: $(POSTGRES)/.stamp
	TUTTI_POSTGRES=1 $(POSTGRES)/bin/pytest -m "postgres and nightly" --timeout 3600 tests/unit/journal tests/live/test_coordinators.py tests/live/test_machines.py $(SLOWEST)

check: $(DEV)/.stamp
	$(DEV)/bin/ruff check .
	$(DEV)/bin/ruff format --check .
	$(DEV)/bin/lint-imports
	$(DEV)/bin/basedpyright
	$(DEV)/bin/pytest -m structure tests/unit/project tests/unit/client

figures: $(DEV)/.stamp
	$(DEV)/bin/python tools/figures.py

docs: $(DOCS)/.stamp
	$(DOCS)/bin/python tools/reference_pages.py
	$(DOCS)/bin/sphinx-build -W --keep-going -q -b html docs build/site
	@echo "open build/site/index.html"

# Needs uv; writes the locks again from pyproject.toml and the requirements.in files.
LOCK = uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url
lock:
	$(LOCK) --extra web --extra record -o requirements/run.lock pyproject.toml
	$(LOCK) --extra dev -c requirements/run.lock -o requirements/dev.lock pyproject.toml
	$(LOCK) --extra record --extra export --extra scanspec --extra web --extra keys --extra postgres -c requirements/dev.lock -o requirements/full.lock pyproject.toml
	$(LOCK) --extra docs -c requirements/dev.lock -o requirements/docs.lock pyproject.toml
	$(LOCK) -c requirements/dev.lock --overrides tests/thirdparty/overrides.txt -o requirements/thirdparty.lock tests/thirdparty/requirements.in
	$(LOCK) -c requirements/dev.lock -o requirements/ecosystem.lock tests/ecosystem/requirements.in
	$(LOCK) -c requirements/dev.lock -o requirements/postgres.lock tests/unit/journal/requirements.in
	$(LOCK) -c requirements/dev.lock -o requirements/page.lock orchestrator/gateway/page/requirements.in

clean:
	rm -rf .venv .venv-* build *.egg-info orchestrator/gateway/static orchestrator/gateway/page/node_modules
