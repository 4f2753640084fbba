# The Python that the environment is made with: 3.10 to 3.14.
PYTHON ?= python3
BIN := .venv/bin

comma := ,
# A sourced ROS 2 brings rclpy, OpenCV and NumPy of its own; elsewhere they come as wheels.
SOURCED_ROS := $(and $(ROS_DISTRO),$(shell $(PYTHON) -c 'import rclpy' 2>/dev/null && echo yes))
VENV_FLAGS := $(if $(SOURCED_ROS),--system-site-packages)
EXTRAS := bags,test,lint,colcon$(if $(SOURCED_ROS),,$(comma)wheels)
CONSTRAINTS := $(if $(SOURCED_ROS),,-c constraints.txt)

.PHONY: venv demo test bench figures soak fuzz lint clean

venv: .venv/complete

.venv/complete: setup.py setup.cfg pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV_FLAGS) .venv
	$(BIN)/python -m pip install --quiet --upgrade 'pip>=24' 'setuptools>=64,<80' wheel
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) --no-build-isolation --editable '.[$(EXTRAS)]'
	touch $@

demo: venv
	$(BIN)/python -m turbseg_ros.cli demo --out out/demo

# Torch is large, and only training and RAFT need it: venv and demo do without.
.venv/learning: .venv/complete
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) --no-build-isolation --editable '.[learning]'
	touch $@

# Side by side: half of the tests' time they wait for processes that they start.
JOBS ?= 2
test: lint .venv/learning
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile

# What a frame takes, in one run with baselines and a yardstick; figures in out/benchmark.json.
bench: venv
	$(BIN)/python -m turbseg_ros.cli benchmark --json out/benchmark.json

# What the README shows under "How well": tables on the terminal, pictures in docs/images.
figures: venv
	$(BIN)/python -m turbseg_ros.cli evaluate bags/* --baselines mog2,knn,paper --report out/report
	$(BIN)/python -m turbseg_ros.cli evaluate bags/normal bags/thermal --baselines mog2,knn,paper \
		--tilt-curve 0,0.5,1,2 --shake-curve 0,2,4 --curves docs/images
	rm -rf out/severe
	$(BIN)/python -m turbseg_ros.cli replay bags/severe -o out/severe --overlay docs/images/severe.jpg
	$(BIN)/python -m turbseg_ros.cli stages bags/normal -o docs/images/stages.jpg

# What takes minutes: floods, long runs, thousands of random messages.
soak: venv
	FASTRTPS_DEFAULT_PROFILES_FILE=config/fastdds_large_images.xml \
		$(BIN)/python -m pytest -m soak --timeout 3600

# Coverage-guided fuzzing, so many minutes for each harness; a finding ends it and is kept.
FUZZ_MINUTES ?= 5
FUZZ_LIMITS = -max_total_time=$$((60 * $(FUZZ_MINUTES))) -rss_limit_mb=2048 -timeout=30
fuzz: venv
	$(BIN)/python -m pip install --quiet $(CONSTRAINTS) --no-build-isolation --editable '.[fuzz]'
	for harness in bag_reader images; do \
	    found=out/fuzz/$$harness; mkdir -p $$found/findings && \
	    $(BIN)/python test/fuzz/$$harness.py $(FUZZ_LIMITS) -artifact_prefix=$$found/findings/ \
	        $$found test/fuzz/corpus/$$harness || exit 1; \
	done

lint: venv
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:
	rm -rf .venv out build install log
