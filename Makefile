# Three environments from three locks: .venv runs Tutti, .venv-dev also tests and checks it, .venv-thirdparty has
# clients of other people as well. Set-up is skipped while the stamp is newer than the lock and pyproject.toml.
PYTHON ?= python3
PIP = -m pip --disable-pip-version-check --quiet
VECTORS = tests/contract/vectors

.PHONY: demo test test-thirdparty check lock clean

.venv/.stamp: requirements.lock pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Tutti needs Python 3.11 or newer" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv --clear .venv
	.venv/bin/python $(PIP) install --require-hashes -r requirements.lock
	.venv/bin/python $(PIP) install --no-deps --no-build-isolation -e .
	touch $@

.venv-dev/.stamp: requirements-dev.lock pyproject.toml
	$(PYTHON) -m venv --clear .venv-dev
	.venv-dev/bin/python $(PIP) install --require-hashes -r requirements-dev.lock
	.venv-dev/bin/python $(PIP) install --no-deps --no-build-isolation -e .
	touch $@

.venv-thirdparty/.stamp: requirements.lock requirements-thirdparty.lock pyproject.toml
	$(PYTHON) -m venv --clear .venv-thirdparty
	.venv-thirdparty/bin/python $(PIP) install --require-hashes -r requirements.lock
	.venv-thirdparty/bin/python $(PIP) install --require-hashes --no-deps -r requirements-thirdparty.lock
	.venv-thirdparty/bin/python $(PIP) install --no-deps --no-build-isolation -e .
	touch $@

demo: .venv/.stamp
	.venv/bin/tutti demo

# For two cores. Live tests by themselves: their processes have to answer each other in time. They start hundreds of
# interpreters, so that compiled modules are kept even where the environment forbids it.
test: .venv-dev/.stamp
	.venv-dev/bin/pytest -m "not live" -n 2 --dist worksteal
	PYTHONDONTWRITEBYTECODE= .venv-dev/bin/pytest -m live -n 2 --dist loadgroup

# Simulated controllers against drivers from PyPI; a skipped test is a failed one.
test-thirdparty: .venv-thirdparty/.stamp
	TUTTI_THIRDPARTY=1 .venv-thirdparty/bin/pytest tests/thirdparty

check: .venv-dev/.stamp
	.venv-dev/bin/ruff check .
	.venv-dev/bin/ruff format --check .
	.venv-dev/bin/lint-imports
	.venv-dev/bin/basedpyright

# Needs uv; writes the locks anew from pyproject.toml and tests/thirdparty/requirements.in.
lock:
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header -o requirements.lock pyproject.toml
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --extra dev -c requirements.lock -o requirements-dev.lock pyproject.toml
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header --no-emit-index-url -c requirements-dev.lock --overrides tests/thirdparty/overrides.txt -o requirements-thirdparty.lock tests/thirdparty/requirements.in

clean:
	rm -rf .venv .venv-dev .venv-thirdparty build *.egg-info
