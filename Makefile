# The Python that the environment is made with: 3.10 to 3.14.
PYTHON ?= python3
BIN := .venv/bin

comma := ,
# A sourced ROS 2 brings rclpy, OpenCV and NumPy of its own; elsewhere they come as wheels.
SOURCED_ROS := $(and $(ROS_DISTRO),$(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes))
VENV_FLAGS := $(if $(SOURCED_ROS),--system-site-packages)
EXTRAS := bags,evaluation,view,cluster,test,docs,lint,colcon$(if $(SOURCED_ROS),,$(comma)wheels)
CONSTRAINTS := $(if $(SOURCED_ROS),,-c constraints.txt)

.DEFAULT_GOAL := help
.PHONY: help venv learning demo test test-learning docs bench figures real soak fuzz lint clean

help: ## what there is
	@echo 'make TARGET, in the folder of this file; all but help and clean make .venv first:'
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  \1: \2/p' $(MAKEFILE_LIST)

venv: .venv/complete ## all that the node, the bag tools and the tests need, into .venv

.venv/complete: setup.py setup.cfg pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV_FLAGS) .venv
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=24' 'setuptools>=64,<80' wheel
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) --no-build-isolation --editable '.[$(EXTRAS)]'
	touch $@

demo: venv ## node and bag player over DDS, scored; a picture in out/demo
	$(BIN)/python -m turbseg_ros.cli demo --out out/demo

learning: .venv/learning ## torch and what else training, RAFT and refine.mode optimise need, into .venv

# The Python registry has torch for x86-64 Linux with CUDA only. An index that has it without is
# named by whoever can reach one: make test-learning TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=
.venv/learning: .venv/complete
	@echo 'Installing torch for $@: $(if $(TORCH_INDEX),from $(TORCH_INDEX) where that has it,with \
	CUDA; 3.0 GB are downloaded and 5.5 GB of disk used)'
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) \
		--no-build-isolation --editable '.[learning]'
	touch $@

# Side by side: half of the tests' time they wait for processes that they start.
JOBS ?= 2
test: lint ## lint, types and all tests but those that need torch (JOBS=2 processes)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile

LEARNING_TESTS := test/learning test/cli/test_train.py
test-learning: .venv/learning ## the tests of networks, with torch (a download of 3.0 GB)
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile $(LEARNING_TESTS)

docs: venv ## the reference of the library, into out/docs/index.html
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs/api out/docs

# What a frame takes, in one run with baselines and a yardstick, and replay beside the method alone;
# how it grows with objects; the node live and at rest. A quarter of an hour, figures in out/.
bench: venv ## time a frame, replay and the live node; figures in out/benchmark.json
	$(BIN)/python -m turbseg_ros.cli benchmark --replay bags/normal --json out/benchmark.json
	$(BIN)/python -m turbseg_ros.cli benchmark --sizes 1920x1080 --objects 0,1,8,25 --baselines '' \
		--json out/benchmark_objects.json
	FASTRTPS_DEFAULT_PROFILES_FILE=config/fastdds_large_images.xml $(BIN)/python -m pytest -q -s \
		-m soak test/nodes/test_live.py -k 'answered_or_counted or at_rest' -W ignore

# What README and docs/accuracy.md show: tables on the terminal, pictures in docs/images.
figures: venv ## the tables and pictures of the documents
	$(BIN)/python -m turbseg_ros.cli evaluate bags/* --baselines mog2,knn,paper --report out/report
	$(BIN)/python -m turbseg_ros.cli evaluate bags/normal bags/thermal --baselines mog2,knn,paper \
		--tilt-curve 0,0.5,1,2 --shake-curve 0,2,4 --curves docs/images
	rm -rf out/severe out/far_target
	$(BIN)/python -m turbseg_ros.cli replay bags/far_target -o out/far_target --overlay docs/images/far_target.jpg
	$(BIN)/python -m turbseg_ros.cli replay bags/severe -o out/severe --overlay docs/images/severe.jpg
	$(BIN)/python -m turbseg_ros.cli stages bags/normal -o docs/images/stages.jpg

# Clips of data sets that are not part of this repository, wherever they lie. Bags that were
# imported once are taken again.
FRAMES ?=
real: venv ## score the data sets in DATA=/path, in halves (FRAMES=N of each clip)
	@test -n "$(DATA)" || { echo 'which data? make real DATA=/path (real --help says what is looked for)'; exit 2; }
	$(BIN)/python -m turbseg_ros.cli real $(DATA) -o out/real $(if $(FRAMES),--frames $(FRAMES))

# What takes minutes: floods, long runs, thousands of random messages.
soak: venv ## tests that take minutes each
	FASTRTPS_DEFAULT_PROFILES_FILE=config/fastdds_large_images.xml \
		$(BIN)/python -m pytest -m soak --timeout 3600

# Coverage-guided fuzzing, so many minutes for each harness; a finding ends it and is kept.
FUZZ_MINUTES ?= 5
FUZZ_HARNESSES := $(sort $(basename $(notdir $(wildcard test/fuzz/*.py))))
FUZZ_LIMITS = -max_total_time=$$((60 * $(FUZZ_MINUTES))) -rss_limit_mb=2048 -timeout=30
fuzz: venv ## coverage-guided fuzzing (FUZZ_MINUTES=5 for each harness)
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) --no-build-isolation --editable '.[fuzz]'
	for harness in $(FUZZ_HARNESSES); do \
	    found=out/fuzz/$$harness; mkdir -p $$found/findings && \
	    $(BIN)/python test/fuzz/$$harness.py $(FUZZ_LIMITS) -artifact_prefix=$$found/findings/ \
	        $$found test/fuzz/corpus/$$harness || exit 1; \
	done

lint: venv ## ruff and mypy
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean: ## remove .venv and all that was built
	rm -rf .venv out build install log
