# Each target sets up what it needs: a virtual environment in .venv from requirements.lock, by pip alone.
PYTHON ?= python3
BIN := .venv/bin
export OMP_NUM_THREADS ?= 1
# Modules are compiled when they are first imported, not by pip, and once: the tests start many processes.
unexport PYTHONDONTWRITEBYTECODE
# Assertions as they stand: to rewrite those of all tests takes each process as long as to import everything.
# What fails runs once more, with what its assertions compare.
PYTEST := $(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder --assert=plain
SHOWN := || { $(BIN)/python -m pytest --last-failed --last-failed-no-failures none; false; }
LAWS := layers words docs kinds links algorithm_pages
QUICK := $(addprefix tests/,units settings adjust geometry formats tasks/test_small_jobs.py) $(LAWS:%=tests/laws/test_%.py)

.PHONY: demo quick test lint docs bench bench-peers bench-quick bench-truth fuzz lock clean

demo: .venv/installed
	rm -rf demo
	$(BIN)/metrocli init demo --sample spindle-camera
	$(BIN)/metrocli run demo
	$(BIN)/metrocli show demo/results/camera.h5
	$(BIN)/metrocli show demo/results/part.h5

# For those who change the program: in a minute, whether the engine, the formats and a job of each kind still work.
quick: .venv/installed
	$(BIN)/ruff check
	$(PYTEST) $(QUICK) $(SHOWN)

# All but the slow tests, which `python -m benchmarks slow_tests` runs. Types are checked meanwhile: that takes one core.
test: .venv/installed
	$(BIN)/ruff check
	@$(BIN)/mypy & types=$$!; $(PYTEST) --durations=10 $(SHOWN); tests=$$?; wait $$types && exit $$tests

lint: .venv/installed
	$(BIN)/ruff check
	$(BIN)/mypy

# The documentation as a site in build/site, with a gallery of all samples.
docs: .venv/installed
	$(BIN)/mkdocs build --strict --config-file docs/site/mkdocs.yml

bench: .venv/installed
	$(BIN)/python -m benchmarks

# Beside other programs, which are installed in build/peers; both write docs/benchmarks.md, the quick one prints only.
bench-peers: .venv/installed
	$(BIN)/python -m benchmarks peers

bench-quick: .venv/installed
	$(BIN)/python -m benchmarks peers quick

bench-truth: .venv/installed
	$(BIN)/python -m benchmarks truth

fuzz: .venv/installed
	$(BIN)/python -m benchmarks fuzz 600

.venv/installed: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "metrocli needs Python 3.11 or newer: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@# the pip of older Pythons takes twice as long to choose the files; without a network it does as well
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile pip==26.3
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-compile -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# For those who change the dependencies: needs uv.
lock:
	uv pip compile --universal --generate-hashes --python-version 3.11 --extra dev --no-header -o requirements.lock pyproject.toml

clean:
	rm -rf .venv demo build dist
