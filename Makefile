# make demo   denoise the bundled sequence with the runtime alone
# make test   the whole test suite
# make check  lint and type checks
PYTHON ?= python3
RUNTIME := .venv-runtime
FULL := .venv

.PHONY: demo test check benchmark clean

demo: $(RUNTIME)/.ready
	$(RUNTIME)/bin/python -m stillray.demo tests/data/room demo_out

test: $(FULL)/.ready
	@# files side by side, one process a core, so that torch and NumPy need no threads of their own;
	@# a process with torch and Mitsuba takes 1 to 2 GiB; the slowest and what was skipped, and why,
	@# come last
	OMP_NUM_THREADS=1 $(FULL)/bin/python -m pytest -n logical --maxprocesses 4 --dist loadfile --durations 15 -rs

check: $(FULL)/.ready
	$(FULL)/bin/ruff check .
	$(FULL)/bin/ruff format --check .
	$(FULL)/bin/mypy -p stillray -p stillray_training -p stillray_export

benchmark: $(FULL)/.ready
	$(FULL)/bin/python -m stillray_training.benchmark --report docs/performance.md

$(RUNTIME)/.ready: pyproject.toml
	@echo "installing the runtime (numpy, onnxruntime, OpenCV, OpenImageIO; no torch) into $(RUNTIME)"
	$(PYTHON) -m venv $(RUNTIME)
	$(RUNTIME)/bin/python -m pip install -q -e .
	@touch $@

$(FULL)/.ready: pyproject.toml
	@echo "installing everything (torch and Mitsuba too: a few minutes) into $(FULL)"
	$(PYTHON) -m venv $(FULL)
	$(FULL)/bin/python -m pip install -q -e '.[train,farm,compare,dev]'
	@touch $@

clean:
	rm -rf $(RUNTIME) $(FULL) build demo_out
