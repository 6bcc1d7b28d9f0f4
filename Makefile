# make bench   environment, install, the smoke suite, table and HTML report
# make test    environment, all checks, all tests
PYTHON ?= python3
RUN := .venv/bin

.PHONY: bench test check format

bench:
	@$(PYTHON) scripts/setup.py
	@$(RUN)/cognitivedrone bench --suite open-v1:smoke --policy small --out results/smoke --overwrite

check:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check
	$(RUN)/ruff format --check
	$(RUN)/mypy
	$(RUN)/lint-imports

test: check
	$(RUN)/pytest -n 2 --dist worksteal

format:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check --fix
	$(RUN)/ruff format
