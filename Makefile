# Set-up, build and run in one command; for everything else there is plain cargo, which works after `make setup`.
.DEFAULT_GOAL := help
.PHONY: help setup build library install uninstall up play test test-all test-part schemas check-schemas chaos soak lint check-deploy doc book examples deny fuzz \
	sanitize bench-peers bench-learner bench-kernels bench-wire bench-view bench-hosts check-determinism \
	python python-aarch64 test-python bench-python bench-env bench-depth bench-transfer bench-curves bench-safety dist
# Cargo uses all cores by itself; targets run one after the other also under -j.
.NOTPARALLEL:

# LIBTORCH given by the user is for set-up alone: cargo takes the folder that set-up made (.cargo/config.toml), and
# torch-sys compiles for two minutes again whenever one of these changes.
unexport LIBTORCH LIBTORCH_LIB LIBTORCH_INCLUDE LIBTORCH_USE_PYTORCH LIBTORCH_STATIC LIBTORCH_CXX11_ABI
unexport LIBTORCH_BYPASS_VERSION_CHECK
# Make's job server is not for cargo.
unexport MAKEFLAGS MFLAGS
# What `--version` says behind the version: nothing where no commit is known. With another one the programs are linked
# again, no library is compiled.
STILLROOM_COMMIT ?= $(shell deploy/commit)
export STILLROOM_COMMIT := $(STILLROOM_COMMIT)

help:
	@echo 'make setup   fetch libtorch into .torch/ (544 MB, once); LIBTORCH=/path uses a torch 2.11 that is there'
	@echo 'make build   set up and compile the programs'
	@echo 'make up      build and start a run: the demonstration, on a GPU the preset recipe; ARGS="..." adds options'
	@echo 'make play    build, and let the policy in models/ play on a page; POLICY=FILE plays another'
	@echo 'make install puts the programs, their libtorch, stillroom_actor.h with its library, manual pages and completions'
	@echo '             under PREFIX (~/.local);'
	@echo '             make uninstall takes them away'
	@echo 'make test    set up, build and run the tests that every change has to pass'
	@echo 'make test-all   and those that a release has to pass: chaos, thousands of schedules, a browser, Slurm, an archive,'
	@echo '             the commands of the book; make test-part PART=3/10 runs a part of what `make test` leaves out'
	@echo 'make schemas compile orchestrator/schemas/ again, after a change there'
	@echo 'make chaos   let 200 faults happen to small runs and compare what they leave with undisturbed ones (up to half an hour);'
	@echo '             ARGS="--seed S --faults N --minutes M" chooses, ARGS="--seed S --case K" does one case again'
	@echo 'make soak    a run of two hours with faults, and how its processes and files grow; ARGS="--minutes M"'
	@echo 'make check-determinism   the simulator, built for other processors and in debug, gives the same bits (minutes)'
	@echo 'make python  build the Python package stillroom without the programs: a wheel in target/wheels/, installed in .venv/'
	@echo 'make python-aarch64   the wheel with the programs for 64-bit ARM Linux, in target/wheels/aarch64/; it fetches 530 MB,'
	@echo '             once, and needs g++-aarch64-linux-gnu; tried under an emulator, not on a real one (docs/release.md)'
	@echo 'make dist    the files of a release in target/dist/: the wheels with the programs for x86-64 (AVX2) and ARM Linux with'
	@echo '             glibc 2.28, an archive of the x86-64 programs, the sources, notes, a bill of materials, checksums;'
	@echo '             STRICT=yes: what keeps them from being one is an error'
	@echo 'make test-python   build it and run its tests; make bench-python measures it beside Gymnasium'
	@echo 'make bench-env   what a run adds to a step of an environment of Python, beside a bare loop and AsyncVectorEnv'
	@echo 'make bench-depth'
	@echo '             stillroom.DepthCamera beside mujoco.Renderer in software, on the models of six packages, which go into'
	@echo '             .venv/; needs libosmesa6 or libegl1; ARGS="--only Franka --picture docs/depth.png" measures fewer'
	@echo 'make bench-transfer   models/fetch.safetensors under rapier and under MuJoCo, the same episodes (docs/transfer.md)'
	@echo 'make bench-curves   learning curves and frames/s of CleanRL, Stable-Baselines3 and Stillroom with the same settings'
	@echo '             (RESULTS.md); torch and the peers go into .venv/; ARGS="--tasks CartPole-v1 --jobs 2" runs less'
	@echo 'make bench-safety   return and cost of a hopper with a speed limit, trained in four ways'
	@echo 'make lint    formatting and clippy, warnings are errors; and check-deploy'
	@echo 'make check-deploy   the image, manifests, service unit and shell scripts; STRICT=yes: what cannot be checked is an error'
	@echo 'make doc     the API documentation, warnings are errors; and the book'
	@echo 'make book    the book of docs/ as a site, target/book/index.html, and all its links checked (seconds)'
	@echo 'make examples'
	@echo '             apply the examples of docs/own-parts.md to a copy of the sources, and compile it'
	@echo 'make deny    licences, duplicates, sources and advisories of the dependencies; STRICT=yes: an advisory is an error'
	@echo 'make fuzz    let libFuzzer loose on all that reads files or payloads of others, ten minutes each;'
	@echo '             SECONDS=60 TARGETS="scene recording" fuzzes less'
	@echo 'make sanitize'
	@echo '             unsafe code under Miri and AddressSanitizer, with a nightly Rust; TOOLS="miri" runs less'
	@echo 'make bench-peers'
	@echo '             the simulator beside MuJoCo, Embree and PyBullet on one core; PYTHON=/path/to/python takes one that'
	@echo '             has them, otherwise they go into .venv/ (once); ARGS="--kitchens 1,2" measures fewer kitchens'
	@echo 'make bench-learner'
	@echo '             the learner beside PyTorch, eager and compiled; PYTHON=/path/to/python must have torch 2.11 (with'
	@echo '             CUDA on a GPU machine), nothing is installed; ARGS="--batches 152 --steps 32" measures less'
	@echo 'make bench-kernels'
	@echo '             the share of memory bandwidth and of the tensor cores that each kernel of a GPU reaches, by Nsight'
	@echo '             Compute; ARGS="--ncu /path/to/ncu --what update" measures less'
	@echo 'make bench-wire'
	@echo '             shared memory beside raw POSIX shared memory, Unix sockets, ZeroMQ and gRPC; needs a C++ compiler'
	@echo 'make bench-view'
	@echo '             what a viewer with an open page costs a run, in pairs (half an hour on an idle machine);'
	@echo '             ARGS="--pairs 4 --page browser" measures otherwise'
	@echo 'make bench-hosts'
	@echo '             two learners on one host and on two, which are network namespaces here: what crosses, and what it costs;'
	@echo '             ARGS="--pairs 5 --set network.encoder=resnet" measures otherwise'

setup:
	@LIBTORCH='$(LIBTORCH)' deploy/setup

# Of the workspace, so that all other commands find the same features compiled; the program `chaos` is not for users.
build: setup
	cargo build --release --locked --workspace --bin orchestrator --bin actor --bin learner
	@ln -sfn orchestrator target/release/stillroom # its name for users

# A shared library for simulators in other languages. Of the workspace, so that nothing is compiled twice.
library: build
	cargo build --release --locked --workspace --lib

PREFIX := $(HOME)/.local
install: library
	@deploy/install '$(PREFIX)'

uninstall:
	@deploy/install -u '$(PREFIX)'

# Ctrl-C is the orchestrator's, which saves and stops; the shell waits for it, and make adds no "Error" of its own.
up: build
	@interrupted=; trap 'interrupted=yes' INT; \
	$(if $(LIBTORCH),LIBTORCH='$(LIBTORCH)') ./target/release/stillroom up $(ARGS) || { code=$$?; [ "$$interrupted" ] || exit $$code; }

# The policy is in the checkout: no run is needed.
play: build
	@interrupted=; trap 'interrupted=yes' INT; \
	./target/release/stillroom play $(if $(POLICY),'$(POLICY)') $(ARGS) || { code=$$?; [ "$$interrupted" ] || exit $$code; }

# .config/nextest.toml says what `make test` leaves out; plain cargo leaves out nothing.
nextest := cargo nextest run --release --locked --workspace --no-fail-fast
test-all: which := --ignore-default-filter
test-all: library check-schemas
test test-all: build
	@if cargo nextest --version >/dev/null 2>&1; then \
		set -x; $(nextest) $(which); \
	else \
		set -x; cargo test --release --locked --workspace --tests; \
	fi
	cargo test --doc --release --locked --workspace

PART := 1/10
# The environment for the wheel is made here, not within the time that a test of it has.
test-part: library
	@BUILT=yes PYTHON='$(PYTHON)' python/setup >/dev/null
	@if cargo nextest --version >/dev/null 2>&1; then \
		set -x; $(nextest) --ignore-default-filter -E 'not default()' --partition hash:$(PART) --no-tests=pass; \
	else \
		echo 'test-part: without cargo-nextest `make test` leaves nothing out'; \
	fi

# The Rust types and descriptors of orchestrator/schemas/, which lie in the checkout; `make test-all` compares them.
check-schemas: arguments := -- --check
schemas check-schemas:
	cargo run --quiet --locked --manifest-path orchestrator/schemas/compiler/Cargo.toml --target-dir target/schemas $(arguments)

chaos: library
	cargo build --release --locked --workspace --bin chaos
	@python=$$(BUILT=yes PYTHON='$(PYTHON)' python/setup) && STILLROOM_TEST_PYTHON="$$python" ./target/release/chaos faults $(ARGS)

soak: build
	cargo build --release --locked --workspace --bin chaos
	@./target/release/chaos soak $(ARGS)

# The golden hashes, which every build must reproduce: debug, release (AVX2 and fused multiply-add at hand, see
# .cargo/config.toml), the plainest x86-64 there is, and the processor that runs here. The first two are the workspace's
# own builds and reuse what is compiled; the others have target folders of their own, not to spoil those.
golden_hashes := --locked --workspace --test behaviour golden_hashes
check-determinism:
	cargo test $(golden_hashes)
	cargo test --release $(golden_hashes)
	@set -e; for cpu in x86-64 native; do \
		set -x; RUSTFLAGS="-C target-cpu=$$cpu" cargo test --release $(golden_hashes) \
			--target-dir target/determinism/$$cpu; { set +x; } 2>/dev/null; \
	done

# Not part of `make build`: it needs no libtorch, and nothing else needs it. PYTHON=... makes .venv/.
python:
	@python=$$(PYTHON='$(PYTHON)' python/setup) && echo "installed; $$python -c 'import stillroom'"

# Nothing runs on this machine: whoever has such a processor tries it there.
python-aarch64:
	@wheel=$$(PYTHON='$(PYTHON)' python/cross) && echo "built; $$wheel"

# After `make build` it links again, compiles the programs for ARM (the longest part), and packs.
dist: build
	@STRICT='$(STRICT)' deploy/dist

# The runs with environments of Python need the programs, too.
test-python: library
	@python=$$(BUILT=yes PYTHON='$(PYTHON)' python/setup) && (cd python && "$$python" -m pytest -q -rs $(ARGS)) && \
		STILLROOM_TEST_PYTHON="$$python" cargo test --release --locked --workspace --test system environments:: -- --ignored

bench-python:
	@python=$$(PYTHON='$(PYTHON)' python/setup) && "$$python" python/bench.py $(ARGS)

bench-env: build
	cargo build --release --locked --workspace --example instant_learner
	@python=$$(PYTHON='$(PYTHON)' python/setup) && "$$python" python/bench_environments.py \
		--orchestrator target/release/orchestrator --learner target/release/examples/instant_learner $(ARGS)

# A policy in both physics engines.
bench-transfer: build
	test target/transfer.onnx -nt models/fetch.safetensors || { rm -f target/transfer.onnx target/transfer.md; \
		target/release/orchestrator export models/fetch.safetensors --out target/transfer.onnx; }
	@python=$$(PYTHON='$(PYTHON)' python/setup) && \
		"$$python" python/bench_transfer.py --policy target/transfer.onnx $(ARGS)

# Whole trainings, for hours: results in target/curves.jsonl are not repeated.
bench-curves: build
	@python=$$(PYTHON='$(PYTHON)' python/setup) && \
		"$$python" -m pip install --quiet --disable-pip-version-check -r python/bench_curves.txt && \
		"$$python" python/bench_curves.py --orchestrator target/release/orchestrator --cleanrl target/cleanrl \
			--out target/curves.jsonl $(ARGS)

bench-safety: build
	@python=$$(PYTHON='$(PYTHON)' python/setup) && \
		"$$python" python/bench_safety.py --orchestrator target/release/orchestrator --out target/safety.jsonl $(ARGS)

bench-depth:
	@python=$$(PYTHON='$(PYTHON)' python/setup) && \
		"$$python" -m pip install --quiet --disable-pip-version-check -r python/bench_depth.txt && rm -f .venv/stillroom-installed && \
		"$$python" python/bench_depth.py $(ARGS)

lint: setup
	cargo fmt --all --check
	rustfmt --edition 2024 --check actor/simulator/src/tasks/*/mod.rs  # a build script lists them
	cargo clippy --release --workspace --all-targets --locked -- -D warnings
	@for part in fuzz fuzz/unsafe bench/wire orchestrator/schemas/compiler; do \
		cargo metadata --locked --format-version 1 --manifest-path $$part/Cargo.toml >/dev/null || exit; \
	done
	@STRICT='$(STRICT)' deploy/check

# The checkers are fetched once (21 MB); it takes ten seconds.
check-deploy:
	@STRICT='$(STRICT)' deploy/check

doc: setup
	RUSTDOCFLAGS='-D warnings' cargo doc --no-deps --release --workspace --locked
	@STRICT='$(STRICT)' deploy/book

# mdBook is fetched if it is not there (5 MB, once).
book:
	@STRICT='$(STRICT)' deploy/book

# Quick after `make lint`, which has checked the dependencies.
examples: setup
	@deploy/examples

# cargo-deny is fetched if it is not there (seconds); without a network everything but advisories is checked.
deny:
	@STRICT='$(STRICT)' deploy/deny

# Stable Rust and the C++ compiler of set-up are enough (fuzz/run says why). Compiles for minutes, once.
SECONDS := 600
fuzz: setup
	@fuzz/run $(SECONDS) $(TARGETS)

# Not part of the tests: it needs a nightly Rust.
sanitize: setup
	@fuzz/sanitize $(TOOLS)

# Of the workspace, not of the package alone: so its dependencies have the same features, and are not compiled again.
bench-peers:
	cargo build --release --locked --workspace --bin actor
	@python=$$(PYTHON='$(PYTHON)' bench/peers/setup) && cd bench && "$$python" -m peers --actor ../target/release/actor $(ARGS)

# torch is taken as it is found: a second one beside that of a GPU machine would be gigabytes.
bench-learner:
	cargo build --release --locked --workspace --bin learner
	@cd bench && "$(or $(PYTHON),python3)" -m peers.learner --learner ../target/release/learner $(ARGS)

bench-kernels: build
	@python3 bench/kernels.py --learner target/release/learner $(ARGS)

# A package of its own with a lock file of its own: its dependencies are none of the product's.
bench-wire:
	cargo build --release --locked --manifest-path bench/wire/Cargo.toml --target-dir target/wire
	@target/wire/release/bench-wire $(ARGS)

# In pairs, one without and one with: nothing else may run meanwhile.
bench-view: build
	@python3 bench/viewer.py --orchestrator target/release/orchestrator $(ARGS)

# Two learners, on one host and on two: hosts are namespaces, for which nobody needs to be root.
bench-hosts: build
	@python3 bench/hosts.py --orchestrator target/release/orchestrator $(ARGS)
