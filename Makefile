# On a fresh machine with make and Python 3.11 or newer:
#   make          reproduces the main study (out/ holds its report)
#   make test     runs the tests
# Every target makes .venv when it is missing and installs into it again only when pyproject.toml has changed.

PYTHON ?= python3
VENV   := .venv
PEERS  := .venv-peers
# Each is optional. Without torch, 800 MB, torchquad works on NumPy.
PEER_PACKAGES := "mitsuba>=3.7" vegas "qmcpy>=2" quadax torchquad
PIP    := -m pip install --quiet --no-input --disable-pip-version-check
# What `clean` removes besides the environments, which `make distclean` removes too.
LITTER := out build dist .pytest_cache .ruff_cache .hypothesis

.PHONY: study test test-all bench peers lint clean distclean
.DEFAULT_GOAL := study
.DELETE_ON_ERROR:

study: $(VENV)/.installed
	$(VENV)/bin/jaxmc study mirror-box

test: $(VENV)/.installed-test
	$(VENV)/bin/python -m pytest -n auto --dist worksteal

test-all: $(VENV)/.installed-test
	$(VENV)/bin/python -m pytest -n auto --dist worksteal -m "slow or not slow"
	JAX_ENABLE_X64=1 $(VENV)/bin/python -m pytest -n auto --dist worksteal -m "slow or not slow"

bench: $(VENV)/.installed
	$(VENV)/bin/python benchmarks/throughput.py

lint: $(VENV)/.installed-lint
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/pyright --pythonpath $(VENV)/bin/python

# Other renderers and integrators, kept apart so that their versions of shared packages never meet ours.
peers: $(PEERS)/.installed
	@echo "Error against time beside all of them: $(VENV)/bin/python benchmarks/time_to_error.py"
	@echo "Mitsuba is ready: $(PEERS)/bin/python benchmarks/mitsuba_cornell.py llvm_ad_rgb"
	@echo "Its LLVM variants need the LLVM library, version 19 or newer: install it (Debian and Ubuntu: libllvm19)"
	@echo "and, if it is in an unusual folder, set DRJIT_LIBLLVM_PATH to the file, for example libLLVM-19.so."

clean:
	rm -rf $(LITTER)
	find . -name __pycache__ -not -path "./.venv*" -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV) $(PEERS)

# One stamp per set of extras: .installed is the package alone, .installed-test has the extra `test`, and so on.
$(VENV)/.installed: pyproject.toml | $(VENV)/bin/python
	$(VENV)/bin/python $(PIP) --editable .
	@touch $@

$(VENV)/.installed-%: pyproject.toml | $(VENV)/bin/python
	$(VENV)/bin/python $(PIP) --editable ".[$*]"
	@touch $@

$(PEERS)/.installed: pyproject.toml | $(PEERS)/bin/python
	$(PEERS)/bin/python $(PIP) numpy scipy
	@for package in $(PEER_PACKAGES); do \
	  $(PEERS)/bin/python $(PIP) "$$package" || echo "$$package cannot be installed here: the others go on without it"; \
	done
	@touch $@

%/bin/python:
	@command -v "$(PYTHON)" >/dev/null || \
	  { echo "jaxmc needs Python 3.11 or newer, and '$(PYTHON)' was not found: make PYTHON=/path/to/python" >&2; exit 1; }
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "jaxmc needs Python 3.11 or newer, and $(PYTHON) is" \
	    "$$("$(PYTHON)" -c 'import platform; print(platform.python_version())'):" \
	    "make PYTHON=/path/to/a/newer/python" >&2; exit 1; }
	"$(PYTHON)" -m venv $* || { rm -rf $*; exit 1; }
