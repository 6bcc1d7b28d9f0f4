# make bench           environment, install, the smoke suite, table and HTML report; without make: scripts/bench.py
# make test            environment, all checks, all tests
# make docs            the documentation as a site: build/site/index.html
# make gate            .ci/run, which every commit of the main branch has passed, from a clean clone of HEAD
# make release-check   the rest, from a clean clone of HEAD: slow tests, reproduction in small, other Pythons and versions, image, ARM64 in qemu;
#                      STEPS="slow lowest" takes the steps with one of these words alone
# make test-hard       whether the tests depend on anything but the code: three times, on a busy machine, in random order,
#                      after a kill; two hours or so. PARTS="tests/files tests/labels" takes these tests alone, "--only busy" these runs
# make lock            constraints.txt from pyproject.toml; UPGRADE=1 takes the newest of everything
#
# make bench-card      OpenVLA on a graphics card, into results/ and the tables of docs/
# make test-card       what only an NVIDIA graphics card can show; all other tests hide it, so that they are the same everywhere
#
# Parts of release-check:
# make test-slow       what takes more than 20 s, or shows what another test shows too; make test leaves it out
# make test-smoke      runs/smoke.sh: every step of runs/reproduce.sh in tiny sizes (needs PyTorch: make test TORCH=1)
# make test-wheel      the built wheel in a fresh environment of PYTHON=python3.13: smoke suite, fast tests
# make test-sdist      the same from the source archive
# make test-lowest     the same with the lowest allowed version of every dependency (needs uv)
# make test-newest     all tests with the newest allowed version of every dependency, where any warning is an error
PYTHON ?= python3
RUN := .venv/bin

.PHONY: bench test tests check docs format gate lock release-check test-hard bench-card test-card test-slow test-smoke test-wheel test-sdist test-lowest test-newest

bench:
	@$(PYTHON) scripts/bench.py

check:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check
	$(RUN)/ruff format --check
	@if $(RUN)/python -c 'import torch' 2> /dev/null; then echo $(RUN)/mypy; $(RUN)/mypy; \
	else echo "mypy is left out: the types of PyTorch are not here"; fi
	$(RUN)/lint-imports

tests: # a third process flies while another waits for a vehicle's clock
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/pytest -n 3 --dist worksteal --durations 400 --durations-min 1.5

test: check tests

docs:
	@$(PYTHON) scripts/setup.py docs
	$(RUN)/mkdocs build --strict
	@echo "build/site/index.html; with its search: $(RUN)/mkdocs serve"

gate:
	$(PYTHON) scripts/clean_clone.py .ci/run

release-check:
	$(PYTHON) scripts/clean_clone.py $(PYTHON) scripts/release_check.py $(STEPS)

lock:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/python -m pip install --quiet --disable-pip-version-check uv
	echo 'hatchling>=1.25' | $(RUN)/uv pip compile --quiet --universal --python-version 3.11 --extra dev --extra dev-torch \
	  --no-annotate --custom-compile-command "make lock" $(if $(UPGRADE),--upgrade) --output-file constraints.txt pyproject.toml -

test-hard:
	$(PYTHON) scripts/setup.py dev
	$(RUN)/python scripts/test_hard.py $(PARTS)

bench-card:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/python benchmarks/openvla_gpu.py --lora --out results/openvla_gpu.json
	$(RUN)/python scripts/render_tables.py

test-card:
	@$(PYTHON) scripts/setup.py dev
	CARD=1 $(RUN)/pytest -m card --durations 10

test-slow:
	SLOW=1 $(RUN)/pytest -m slow --durations 0

test-smoke:
	SMOKE=1 $(RUN)/pytest tests/scripts/test_smoke.py

test-wheel:
	$(PYTHON) scripts/test_wheel.py

test-sdist:
	$(PYTHON) scripts/test_wheel.py --sdist

test-lowest:
	$(PYTHON) scripts/test_wheel.py --lowest

test-newest:
	$(PYTHON) scripts/test_wheel.py --newest

format:
	@$(PYTHON) scripts/setup.py dev
	$(RUN)/ruff check --fix
	$(RUN)/ruff format
