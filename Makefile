# make demo: one capture on the mock bench. make test: the tests, but for whole jobs, which
# make test-whole runs, and long ones. All install what is missing.
# make web: the page for the bench, in a browser. make notebook: the tutorial, in Jupyter.
# make test-slow: whole captures with photos of a 450D's size, by three drivers; minutes.
# make test-systemd: the service under a systemd that runs, where there is root and systemd-nspawn.
# make test-docs: README, tutorial and installation in bare Debians, where there is debootstrap, too.
.PHONY: demo web notebook test test-whole test-long test-slow test-systemd test-docs lint bench soak mutants goldens strangers api constraints clean

# Processes start often here; each would compile every module anew.
unexport PYTHONDONTWRITEBYTECODE

demo:
	@.ci/setup
	@.venv/bin/pdcd demo

# Where no daemon runs yet, one that ends with the page. What is started in the background has
# interrupts ignored, so the daemon is told to end.
web:
	@.ci/setup web
	@if ! .venv/bin/pdcd status >/dev/null 2>&1; then \
	    .venv/bin/pdcd serve & daemon=$$!; trap 'kill $$daemon; wait $$daemon' EXIT; trap : INT; \
	fi; .venv/bin/pdcd web

# A copy, which goes when Jupyter ends: what is tried out in it leaves docs/ as it is.
notebook:
	@.ci/setup notebook
	@folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; trap : INT; \
	cp docs/tutorial.ipynb "$$folder"; root=$$([ "$$(id -u)" != 0 ] || echo --allow-root); \
	.venv/bin/jupyter lab $$root --notebook-dir "$$folder" "$$folder/tutorial.ipynb"

# One thread for the linear algebra, here and below: more gain nothing on such small matrices, wait
# for each other, and make times scatter.
# Three workers for two cores: many tests wait for a display, which keeps real time.
test:
	@.ci/setup dev
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -q -n 3 --dist worksteal -m "not long and not whole"

# Whole jobs: calibrations and captures from the first light to the verdict.
test-whole:
	@.ci/setup dev
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -q -n 3 --dist worksteal -m "whole and not long"

# Those that take long each: many seeds, many cases, whole frames. Plain pytest runs all three.
test-long:
	@.ci/setup dev
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -q -n 3 --dist worksteal -m long

test-slow:
	@.ci/setup dev
	PDCD_TEST_SLOW=1 OMP_NUM_THREADS=1 .venv/bin/python -m pytest -q -n 0 -rs \
	    tests/e2e/drivers/test_real_frames.py

test-systemd:
	@.ci/setup systemd
	OMP_NUM_THREADS=1 .venv/bin/python -m pytest -q -n 0 -rs tests/running_systemd

test-docs:
	@.ci/setup docs
	.venv/bin/python -m tests.docs

# The API reference, of docstrings, in the folder api.
api:
	@.ci/setup dev
	.venv/bin/python -m tests.api_pages api

lint:
	@.ci/setup dev
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/lint-imports
	.venv/bin/python -m tests.api_pages api

bench:
	@.ci/setup dev
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.bench

# A real daemon under attack for MINUTES; the table goes into docs/benchmarks.md.
MINUTES ?= 10
soak:
	@.ci/setup dev
	OMP_NUM_THREADS=1 .venv/bin/python -m tests.soak --minutes $(MINUTES) --out docs/benchmarks.md

# Small wrong changes, one at a time: do the tests notice? ROOM is a room, or a folder of drivers.
ROOM ?= all
COUNT ?= 150
SEED ?= 1
JOBS ?= 2
OUT ?= mutants
mutants:
	@.ci/setup dev
	nice -n 10 .venv/bin/python -m tests.mutants --room $(ROOM) --count $(COUNT) --seed $(SEED) --jobs $(JOBS) --out $(OUT)

# Does every result equal that of a commit, byte for byte? WORDS=no lets sentences differ; ONLY is a
# room or a pattern of cases; in KEEP the goldens stay to be looked at.
BASE ?= HEAD
ONLY ?=
WORDS ?= yes
KEEP ?=
goldens:
	@.ci/setup dev
	nice .venv/bin/python -m tests.goldens base $(BASE) --only $(ONLY) $(if $(filter no,$(WORDS)),--no-words) \
	    $(if $(KEEP),--keep $(KEEP))

# Benches of another package, with physics of its own: are photos true, or said not to be? What is
# done is kept in OUT, and not done again.
strangers: COUNT = 20
strangers: SEED = 0
strangers: OUT = strangers
strangers:
	@.ci/setup dev
	OMP_NUM_THREADS=1 nice .venv/bin/python -m tests.strangers --count $(COUNT) --seed $(SEED) --out $(OUT)

# The packages that .venv has now, for who wants just those: a release keeps what it was tested with.
constraints:
	@.ci/setup dev
	@{ sed '/^[^#]/d' constraints.txt; python3 -m pip --python .venv/bin/python freeze --exclude-editable \
	    --disable-pip-version-check; } >constraints.new && mv constraints.new constraints.txt

clean:
	rm -rf .venv api demo mutants .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
