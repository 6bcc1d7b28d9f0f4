# make bench         environment, install, the smoke suite, table and HTML report
# make test          environment, all checks, all tests
# make test-smoke    runs/smoke.sh: every step of runs/reproduce.sh in tiny sizes (needs PyTorch: make test TORCH=1)
# make docs          the documentation as a site: build/site/index.html
# make test-wheel    the built wheel in a fresh environment of PYTHON=python3.13: smoke suite, fast tests
# make test-sdist    the same from the source archive
# make test-lowest   the same with the lowest allowed version of every dependency (needs uv)
PYTHON ?= python3
RUN := .venv/bin

.PHONY: bench test test-smoke check docs format test-wheel test-sdist test-lowest

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

test-smoke:
	SMOKE=1 $(RUN)/pytest tests/scripts/test_smoke.py

docs:
	@$(PYTHON) scripts/setup.py docs
	$(RUN)/mkdocs build --strict
	@echo "build/site/index.html; with its search: $(RUN)/mkdocs serve"

test-wheel:
	$(PYTHON) scripts/test_wheel.py

test-sdist:
	$(PYTHON) scripts/test_wheel.py --sdist

test-lowest:
	$(PYTHON) scripts/test_wheel.py --lowest

format:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check --fix
	$(RUN)/ruff format
