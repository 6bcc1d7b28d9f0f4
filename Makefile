# make bench         environment, install, the smoke suite, table and HTML report
# make test          environment, all checks, all tests
# make test-wheel    the built wheel in a fresh environment of PYTHON=python3.13: smoke suite, fast tests
# make test-lowest   the same with the lowest allowed version of every dependency (needs uv)
PYTHON ?= python3
RUN := .venv/bin

.PHONY: bench test check format test-wheel test-lowest

bench:
	@$(PYTHON) scripts/setup.py
	@$(RUN)/cognitivedrone bench --suite open-v1:smoke --policy small --out results/smoke --overwrite

check:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check
	$(RUN)/ruff format --check
	@if $(RUN)/python -c 'import torch' 2> /dev/null; then echo $(RUN)/mypy; $(RUN)/mypy; \
	else echo "mypy is left out: the types of PyTorch are not here"; fi
	$(RUN)/lint-imports

test: check
	$(RUN)/pytest -n 2 --dist worksteal

test-wheel:
	$(PYTHON) scripts/test_wheel.py

test-lowest:
	$(PYTHON) scripts/test_wheel.py --lowest

format:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check --fix
	$(RUN)/ruff format
