# What a user and CI run; `make help` lists it. The work is done by CMake, the settings are in CMakePresets.json.

PREFIX ?= /usr/local
JOBS ?= $(shell nproc)
PYTHON ?=
GRAPHS ?= ../shared/data/graphs

packages = g++ cmake ninja-build libeigen3-dev libsuitesparse-dev libscotch-dev libspectra-dev libtbb-dev zlib1g-dev libcli11-dev nlohmann-json3-dev libgtest-dev libopencv-dev libpng-dev
asan_packages = clang libclang-rt-14-dev # twice as fast to compile with as g++'s sanitizers
package_packages = dpkg-dev file gzip
docs_packages = doxygen libjs-katex
python_packages = pybind11-dev python3-dev python3-numpy python3-matplotlib
plot_packages = librsvg2-bin
# Serial: a rank per core. With the BLAS that MUMPS comes with a factor takes two to three times as long.
mpi_packages = libpetsc-real-dev libopenmpi-dev openmpi-bin libopenblas0-serial pkg-config iproute2
bench_packages = libbenchmark-dev libceres-dev
# Where node comes from elsewhere, Debian's npm would conflict with it.
node_packages = $(if $(shell command -v npm),,nodejs npm)
browser_packages = $(if $(shell command -v chromium || command -v chromium-browser || command -v google-chrome),,chromium)
test_packages = $(docs_packages) $(python_packages) $(package_packages) $(plot_packages) $(node_packages) $(browser_packages) \
  python3-pytest python3-venv valgrind mypy man-db bash-completion pkg-config
sources = $(shell find $(wildcard lie core covariance compact frontend examples tests python) -name '*.h' -o -name '*.cpp')

.PHONY: all demo test mpi with-mpi python with-python docs bench bench-docs instructions-update micro-bench consistency-docs compact-docs outliers-docs protocol-docs sparsify-docs report-page \
  readme-picture install package asan fuzz tsan soak format format-check tidy deps clean help
.DEFAULT_GOAL := all

# With the Python package and terse-mpi where they are switched on, which `make install` and `make package` then take along.
all: build/build.ninja ## build the command, build/bin/terse
	@cmake --build build -j $(JOBS) --target bin/terse \
	  $$(grep -qx 'TERSE_BUILD_PYTHON:BOOL=ON' build/CMakeCache.txt && echo terse_python) \
	  $$(grep -qx 'TERSE_BUILD_DISTRIBUTED:BOOL=ON' build/CMakeCache.txt && echo terse_mpi)

demo: all ## build, then run the demonstration
	@examples/demo.sh

test: with-python with-mpi ## build everything and run the tests
	@.ci/packages $(test_packages)
	@cmake -S . -B build >/dev/null # finds what was just installed
	@cmake --build build -j $(JOBS)
	@ctest --test-dir build --output-on-failure -j $(JOBS) --output-junit test-results.xml; status=$$?; \
	  echo "Results: build/test-results.xml, output: build/Testing/Temporary/LastTest.log"; exit $$status

mpi: with-mpi ## build build/bin/terse-mpi, which solves over several processes; installs PETSc and Open MPI
	@grep -qx 'TERSE_BUILD_DISTRIBUTED:BOOL=ON' build/CMakeCache.txt || { echo "MPI or PETSc is missing: see above" >&2; exit 1; }
	@cmake --build build -j $(JOBS) --target terse_mpi
	@echo "To use it: mpirun -n 2 build/bin/terse-mpi solve FILE   (docs/howto/mpi.md)"

# Where there is neither, the tests of it are skipped.
with-mpi: build/build.ninja
	@.ci/packages $(mpi_packages)
	@grep -qx 'TERSE_BUILD_DISTRIBUTED:BOOL=ON' build/CMakeCache.txt || \
	  cmake -S . -B build -D TERSE_BUILD_DISTRIBUTED=ON >/dev/null || \
	  { echo "No MPI or no PETSc: terse-mpi is not built, its tests are skipped"; cmake -S . -B build -D TERSE_BUILD_DISTRIBUTED=OFF >/dev/null; }

python: with-python ## build the Python package, build/python/terse; PYTHON=/path/to/python3 for another interpreter
	@cmake --build build -j $(JOBS) --target terse_python
	@echo "To use it: PYTHONPATH=$(CURDIR)/build/python $(python_used)   (docs/python.md)"

python_used = $$(sed -n 's/^TERSE_PYTHON_USED:INTERNAL=//p' build/CMakeCache.txt)
# Switched on once; after that `make all` and `make install` know of it too.
with-python: export python = $(PYTHON)
with-python: build/build.ninja
	@$(if $(PYTHON),,.ci/packages $(python_packages))
	@if ! grep -qx 'TERSE_BUILD_PYTHON:BOOL=ON' build/CMakeCache.txt || [ "$${python:-$(python_used)}" != "$(python_used)" ]; then \
	  cmake -S . -B build -D TERSE_BUILD_PYTHON=ON $${python:+-D TERSE_PYTHON="$$python"} >/dev/null || \
	  { cmake -S . -B build -D TERSE_BUILD_PYTHON=OFF -U TERSE_PYTHON >/dev/null; exit 1; }; \
	fi

bench: build-bench/build.ninja ## build and run the benchmarks; BENCH_ARGS='--graphs sphere2500 --only batch', --help
	@cmake --build build-bench -j $(JOBS) --target terse_bench
	@build-bench/bin/terse_bench --json build-bench/bench.json $(BENCH_ARGS)

bench-docs: ## run the benchmarks and put their tables into docs/benchmarks.md
	@$(MAKE) --no-print-directory bench BENCH_ARGS="$(BENCH_ARGS) --update docs/benchmarks.md"

instructions-update: build/build.ninja ## count the instructions of the runs of tests/instructions and expect that from now on
	@.ci/packages valgrind
	@cmake --build build -j $(JOBS) --target instruction_runs
	@tests/instructions/check.py build/bin/instruction_runs --update

micro-bench: build-bench/build.ninja ## build and run the benchmarks of single operations
	@cmake --build build-bench -j $(JOBS) --target micro_bench
	@build-bench/bin/micro_bench $(BENCH_ARGS)

consistency-docs: build-bench/build.ninja ## simulate runs and put plot and table into docs/consistency.md
	@cmake --build build-bench -j $(JOBS) --target consistency
	@build-bench/bin/consistency --svg docs/images/consistency.svg --update docs/consistency.md $(BENCH_ARGS)

outliers-docs: build-bench/build.ninja ## run the experiment with wrong loops and put its tables into docs/outliers.md
	@cmake --build build-bench -j $(JOBS) --target outliers
	@build-bench/bin/outliers --update docs/outliers.md $(BENCH_ARGS)

# Many hours; runs that are in build-bench/protocol.jsonl are not made again.
protocol_graphs = intel,manhattan,manhattanOlson3500_isam,city10000,sphere2500,torus3D,parking-garage,kitti00_all_loops
protocol-docs: build-bench/build.ninja ## run the protocol with wrong loops into docs/outliers.md; GRAPHS=folder of the public graphs
	@cmake --build build-bench -j $(JOBS) --target bin/terse
	@build-bench/bin/terse table outliers $(GRAPHS) --graphs $(protocol_graphs) --threads 1 \
	  --runs build-bench/protocol.jsonl --update docs/outliers.md $(BENCH_ARGS)

sparsify_graphs = intel,city10000,sphere2500,ais2klinik,kitti_02,kitti_05,parking-garage
sparsify-docs: build-bench/build.ninja ## run the tables of graphs made small into docs/sparsify.md; GRAPHS=folder of the public graphs
	@cmake --build build-bench -j $(JOBS) --target bin/terse
	@build-bench/bin/terse table sparsify $(GRAPHS) --graphs $(sparsify_graphs) --update docs/sparsify.md $(BENCH_ARGS)

compact-docs: build-bench/build.ninja ## run the tables of compact pose SLAM into docs/compact.md; GRAPHS=folder of the public graphs
	@cmake --build build-bench -j $(JOBS) --target bin/terse
	@build-bench/bin/terse table compact $(GRAPHS) --update docs/compact.md --output build-bench/compact $(BENCH_ARGS)
	@for name in ellipse_norms ellipse-n_laps ellipse-n_growth; do \
	  if [ -f build-bench/compact/$$name.svg ]; then cp build-bench/compact/$$name.svg docs/images/; fi; done

docs: build/build.ninja ## make the pages of docs/ and of the headers, build/docs/html/index.html
	@.ci/packages $(docs_packages)
	@cmake --build build --target docs

report-page: ## bundle examples/report/src into examples/report/report.html, which is committed (needs the npm registry)
	@.ci/packages $(node_packages)
	@cd examples/report && npm ci --loglevel=error && npm run --silent build

# The poses kept are what this picture is about, not how well each place is known: no ellipses.
readme-picture: all ## draw the README's picture from a generated city, all poses and links beside those kept
	@.ci/packages $(plot_packages)
	@rm -rf build/pictures && mkdir -p build/pictures
	@cd build/pictures && ../bin/terse generate manhattan --poses 10000 --output city.g2o --ground-truth city.tum --quiet && \
	  draw() { \
	    ../bin/terse compact city.g2o --strategy $$1 --ground-truth city.tum --output "$$2" && sed -i 1q "$$2/covariances.csv"; \
	  } && draw apal "All poses and links" && draw bounded "Only what carries information" && \
	  ../bin/terse plot "All poses and links" "Only what carries information" --what trajectory --output . --quiet
	@rsvg-convert --width 1000 build/pictures/comparison_trajectory.svg --output docs/images/city.png

install: all ## install the command, the library and its headers to PREFIX (default /usr/local; DESTDIR is obeyed)
	@DESTDIR='$(DESTDIR)' cmake --install build --prefix '$(PREFIX)'

package: all ## make a Debian package, build/terse_VERSION_ARCH.deb
	@.ci/packages $(package_packages)
	@cd build && cpack -G DEB && rm -rf _CPack_Packages

asan: build-asan/build.ninja ## build and test with the address and undefined-behaviour sanitizers
	@cmake --build build-asan -j $(JOBS)
	@ctest --preset asan-ubsan -j $(JOBS)

SECONDS = 60
fuzz: build-asan/build.ninja ## fuzz every reader for SECONDS=60 each; what is found lies in build-asan/fuzz
	@cmake --build build-asan -j $(JOBS) --target fuzzers
	@status=0; for program in build-asan/bin/fuzz_*; do echo "$${program#build-asan/bin/}, $(SECONDS) s"; \
	  tests/fuzz/run.sh $$program $(SECONDS) build-asan/fuzz || status=1; done; exit $$status

tsan: build-tsan/build.ninja ## build what has threads with ThreadSanitizer, and run its tests
	@cmake --build build-tsan -j $(JOBS) --target tsan_tests
	@ctest --preset tsan -j $(JOBS)

soak: build/build.ninja ## stream into `terse online` for so many SECONDS (60): memory and descriptors stay flat
	@cmake --build build -j $(JOBS) --target soak_test
	@TERSE_SOAK_SECONDS=$(SECONDS) build/bin/soak_test

format: ## format all sources
	@.ci/packages clang-format
	@clang-format -i $(sources)

format-check: ## fail if a source is not formatted
	@.ci/packages clang-format
	@printf '%s\n' $(sources) | xargs -n 16 -P $(JOBS) clang-format --dry-run -Werror

TIDY = changed
tidy: build-tidy/build.ninja ## clang-tidy over the library's sources that changed since origin's main; TIDY=all for all of them
	@.ci/packages clang-tidy
	@JOBS=$(JOBS) .ci/tidy build-tidy $(TIDY)

clean: ## remove all that was built
	@rm -rf build build-debug build-asan build-tsan build-tidy build-bench build-pip

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1: /p' $(MAKEFILE_LIST) | awk -F': ' '{printf "make %-17s %s\n", $$1, $$2}'

# Configured once; afterwards Ninja sees for itself when CMake has to run again.
build/build.ninja: CMakePresets.json | deps
	@cmake --preset release >/dev/null && touch $@

build-asan/build.ninja: CMakePresets.json | deps
	@.ci/packages $(asan_packages) $(plot_packages)
	@cmake --preset asan-ubsan >/dev/null && touch $@

build-tsan/build.ninja: CMakePresets.json | deps
	@.ci/packages $(asan_packages)
	@cmake --preset tsan >/dev/null && touch $@

build-tidy/build.ninja: CMakePresets.json | deps
	@.ci/packages clang-tidy $(mpi_packages)
	@cmake --preset tidy -D TERSE_BUILD_DISTRIBUTED=ON >/dev/null || cmake --preset tidy -D TERSE_BUILD_DISTRIBUTED=OFF >/dev/null
	@touch $@

build-bench/build.ninja: CMakePresets.json | deps
	@.ci/packages $(bench_packages)
	@cmake --preset bench >/dev/null && touch $@

deps:
	@.ci/packages $(packages)
