# make demo   denoise the bundled sequence with the runtime alone
# make test   the whole test suite
# make check  lint and type checks
# make programs   what the tests in Blender and Node need (700 MB to fetch); without, they are skipped
PYTHON ?= python3
RUNTIME := .venv-runtime
FULL := .venv
BLENDER := .venv-blender
WEB := plugins/web/node_modules
# tests/blender runs where this names a Python
export STILLRAY_BLENDER_PYTHON ?= $(if $(wildcard $(BLENDER)/.ready),$(CURDIR)/$(BLENDER)/bin/python)

.PHONY: demo test check programs benchmark clean

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

programs:
	@$(MAKE) --no-print-directory $(BLENDER)/.ready || \
		echo "no Blender from PyPI here (bpy 5.0.1, Python 3.11): tests/blender is skipped"
	@$(MAKE) --no-print-directory $(WEB)/.ready || \
		echo "no packages from npm here: tests in Node and of the web page are skipped"

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
	@# of torch's and Mitsuba's thousands of modules few are imported: compiled then, not all here
	$(FULL)/bin/python -m pip install -q --no-compile -e '.[train,farm,compare,dev]'
	@touch $@

# a Python of its own: Blender's modules want NumPy below 2; what else bpy asks for, tests need not
$(BLENDER)/.ready:
	@echo "installing Blender as a Python module into $(BLENDER)"
	@$(PYTHON) -m venv $(BLENDER)
	@$(BLENDER)/bin/python -m pip install -q --no-deps 'bpy==5.0.1' 'numpy<2'
	@touch $@

# without scripts, which would fetch libraries for CUDA
$(WEB)/.ready: plugins/web/package.json
	@echo "installing onnxruntime-node and onnxruntime-web into $(WEB)"
	@npm install --loglevel error --ignore-scripts --no-audit --no-fund --no-package-lock --prefix plugins/web
	@touch $@

clean:
	rm -rf $(RUNTIME) $(FULL) $(BLENDER) $(WEB) build demo_out
