# Verbs of this project. `make` lists them.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
UV     := $(BIN)/uv
STAMP  := $(VENV)/.deps
SO     := ccdiff_env/_native.abi3.so
RUST   := $(shell find rust -name '*.rs' -o -name 'Cargo.toml' 2>/dev/null) Cargo.toml Cargo.lock

export OMP_WAIT_POLICY ?= PASSIVE

.PHONY: help setup demo test test-rust test-py lint bench clean

help:  ## list the verbs
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(SO)  ## virtual environment, dependencies, release build of the extension

$(STAMP): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	test -x $(UV) || $(BIN)/python -m pip install -q uv
	$(UV) pip install -q --python $(BIN)/python -r pyproject.toml --extra dev --extra rl --extra viz
	ln -sfn "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("platlib"))')/torch" .libtorch
	touch $(STAMP)

$(SO): $(STAMP) $(RUST)
	VIRTUAL_ENV=$(CURDIR)/$(VENV) PATH=$(CURDIR)/$(BIN):$$PATH maturin develop --release --locked --uv
	touch $(SO)

clean:  ## remove what the other verbs made
	rm -rf $(VENV) .libtorch target dist runs $(SO)
