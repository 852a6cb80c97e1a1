# Two commands on a bare Debian machine with python3, git and make:
#   make run    set up .venv, then simulate the demo campaign end to end
#   make test   set up .venv, then every check and test
#   make full-chip  set up .venv, then one whole chip at full depth, from the truth to the report: some minutes
#   make docs   set up .venv, then the documentation site, results/docs/index.html
#   make evidence  run each benchmark whose record is stale (ALL=1: all; MINUTES=30: what fits; LIST=1: say which)
#   make test-thorough  the tests of whole chains and of statistics that take more than some seconds
#   make toys   run every benchmark at the size of seconds
#   make mutants  faults put into the code one by one, a set and forty drawn each day, and those that tests see (an hour)
#   make wheel, wheelhouse, image, apptainer, conda   packages, by the recipes of packaging/ (docs/install.md)
#   make fuzz   set up .venv, then eight minutes of hostile input to every reader, and what came of it
PYTHON ?= python3
DOCKER ?= docker
BIN := .venv/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: run full-chip test checks types style evidence toys first-image docs tutorials executed test-thorough test-slurm test-faults suites mutants fuzz format clean \
	kernels wheel wheelhouse image apptainer conda

run: .venv/ready
	snakemake --profile profiles/default --config campaign=config/campaign.yaml

full-chip: .venv/ready
	snakemake --profile profiles/default --config campaign=config/full_chip.yaml

test: .venv/ready
	$(MAKE) --jobs=2 --output-sync checks
	pytest -n 2 --no-loadscope-reorder

test-thorough: .venv/ready
	pytest -n 2 --no-loadscope-reorder -m "thorough and not slow"

# The longest first
checks: types style docs

# Two minutes the first time; then what changed
types: .venv/ready
	mypy

style: .venv/ready
	ruff check .
	ruff format --check .
	lint-imports
	snakefmt --check Snakefile workflow
	python workflow/lint.py --config campaign=config/campaign.yaml
	python builders/make_docs.py --check
	python builders/make_products.py --check
	python docs/check_prose.py
	python benchmarks/evidence/pages.py --check
	python tests/mutants/run.py --check

evidence: .venv/ready
	python benchmarks/evidence/run.py $(if $(ALL),--all) $(if $(MINUTES),--minutes $(MINUTES)) $(if $(LIST),--list)

toys: .venv/ready
	python tests/support/warm.py python benchmarks/evidence/run.py --toy
	python benchmarks/evidence/pages.py --toy

first-image: .venv/ready
	python benchmarks/first_image.py

# A quarter of a minute. A warning is an error, and so is a link that leads nowhere
docs: .venv/ready
	sphinx-build -W --keep-going -q -b html docs results/docs
	python docs/check_links.py results/docs

# Some minutes: the tutorials executed, as all that pages show, and the site with their results
tutorials: executed
	$(MAKE) docs

# What is written as >>> in pages and docstrings, the commands of pages, and all tutorials
executed: .venv/ready
	pytest --doctest-modules --doctest-glob='*.md' src/csstsim docs
	python tests/support/warm.py python docs/execute_commands.py
	python tests/support/warm.py python docs/execute_tutorials.py

# As root, after: apt-get install slurmctld slurmd slurm-client munge
test-slurm: .venv/slurm
	pytest -m slurm -rs --durations=0 tests/workflow/test_slurm.py

# Suites that wait more than they work, one after the other
suites: .venv/slurm
	$(MAKE) test-slurm
	$(MAKE) test-faults
	$(MAKE) executed

fuzz: .venv/ready
	pytest -m slow tests/fuzz

# What is killed, full, read-only or damaged, and resumed. Some faults need root, one a Slurm (as test-slurm)
test-faults: .venv/ready
	pytest -m faults -rs tests/faults

# An hour the first time on an idle machine; what is known is kept (CSSTSIM_MUTANTS: where)
mutants: .venv/ready
	python tests/mutants/run.py
	python tests/mutants/run.py --drawn 40

format: .venv/ready
	ruff check --fix .
	ruff format .
	snakefmt Snakefile workflow

# A set-up that was cut short is not trusted: pip takes a package without its programs for installed
.venv/ready: requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "csstsim needs Python 3.11 or newer; try: make $(MAKECMDGOALS) PYTHON=python3.11"; exit 1; }
	@test ! -e .venv/unfinished || { echo "The last set-up was cut short; starting again"; rm -rf .venv; }
	@mkdir -p .venv && touch .venv/unfinished
	@test -x $(BIN)/pip || $(PYTHON) -m venv .venv \
		|| { rm -rf .venv; echo "Python has no ensurepip here. Run: apt-get install python3-venv"; exit 1; }
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.lock
	@# grismagic, which a test reads the gratings with, asks for jax and does not need it for that
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --editable . grismagic==0.1.1
	@# numba's compiled code names modules that an update may have moved
	@find src -name '*.nb[ic]' -delete
	@mv .venv/unfinished $@

.venv/slurm: .venv/ready
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint requirements.lock --editable '.[slurm]'
	@touch $@

# Compiled code for the wheel, so that its users compile nothing; three minutes
kernels: .venv/ready
	rm -rf results/kernels
	$(BIN)/python builders/build_kernels.py results/kernels

wheel: kernels
	rm -rf results/dist
	CSSTSIM_KERNELS=results/kernels $(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir results/dist .

# csstsim and all that it needs, for a machine without a network
wheelhouse: kernels
	rm -rf results/wheelhouse
	CSSTSIM_KERNELS=results/kernels $(BIN)/pip wheel --quiet --disable-pip-version-check --constraint requirements.lock --wheel-dir results/wheelhouse '.[slurm]'

image: wheel
	$(DOCKER) build --tag csstsim --file packaging/Dockerfile .

apptainer: wheel
	apptainer build --force results/csstsim.sif packaging/csstsim.def

conda: wheel
	rattler-build build --recipe packaging/conda --channel conda-forge --channel bioconda --output-dir results/conda

clean:
	rm -rf .venv results
