# Every target makes what it needs. `make demo` and `make test` are all that a newcomer has to know.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
BENCHMARKS := engine_overhead engine_memory engine_first_run temporal_speed relight_speed

.PHONY: demo test test-slurm test-images test-long chaos mutation lint bench blender train clean help

help:  ## list the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

demo: $(READY)  ## relight the embedded shot with two local workers, into demo/
	$(BIN)/yesnt demo demo

test: $(READY)  ## all tests of a default run (under 12 minutes on 2 cores)
	$(BIN)/python -m pytest -n 2 --dist loadfile

test-slurm: $(READY)  ## runs through a real Slurm that the tests start (root; apt-get install slurm-wlm munge)
	$(BIN)/python -m pytest -m slurm tests/slurm

test-images: $(READY)  ## the container images' steps in a clean Debian root, up to the demo (root, debootstrap)
	$(BIN)/python -m pytest -m images tests/docker

test-long: $(READY)  ## the long suites too
	$(BIN)/python -m pytest -m ''

chaos: $(READY)  ## kills, poison, damage, full disks, two drivers: hundreds of each, into chaos/ (an hour; resumes)
	nice $(BIN)/python -m tests.chaos.run chaos

lint: $(READY)  ## style and types
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	$(BIN)/ruff check . && $(BIN)/ruff format --check . && $(BIN)/mypy

mutation: $(READY)  ## how many small changes of the code the tests notice (hours; resumes)
	nice $(BIN)/python -m tests.mutation.run

bench: $(READY)  ## ratios that the documentation quotes; writes nothing
	for name in $(BENCHMARKS); do echo "== $$name"; $(BIN)/python tests/benchmarks/$$name.py || exit 1; done

blender: .venv-blender/ready .venv-anny/ready  ## Blender and the parametric human, each in its own environment

train: $(READY) .venv-anny/ready  ## the embedded model's weights anew, into training/ (hours; resumes)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[train]'
	$(BIN)/python -m yesnt.training training

.venv-blender/ready:
	$(PYTHON) -m venv .venv-blender
	.venv-blender/bin/pip install --quiet --disable-pip-version-check 'bpy==5.0.1' 'numpy<2'
	touch $@

.venv-anny/ready: constraints.txt
	$(PYTHON) -m venv .venv-anny
	.venv-anny/bin/pip install --quiet --disable-pip-version-check -c constraints.txt 'anny==0.6.2' torch
	touch $@

clean:  ## remove what the targets made
	rm -rf $(VENV) .venv-blender .venv-anny demo build *.egg-info
