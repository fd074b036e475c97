# make quickstart     data → training → evaluation → pictures, on a laptop CPU
# make test           most of the test suite, in minutes; two processes at a time
# make test-all       and the rest: trainings, Slurm, notebooks, whole pipelines
# make fuzz           thousands of damaged and hostile files, and what became of them, in data/results/fuzz.csv
# make docs           the documentation as a site: docs/_build/html/docs/index.html
# make check          style, import contracts, types
# Each makes its own virtual environment first. PYTHON=/path/to/python3.11 names another interpreter.
VENV ?= .venv
RUN := $(VENV)/bin/python
PYTEST := $(RUN) -m pytest -n 2 --dist loadfile --durations=50 --durations-min=3
EXPERIMENT := experiment=quickstart
# One folder, so that the same command goes on after an interruption.
TRAINED := data/runs/quickstart/by_make

.PHONY: help quickstart test test-all fuzz docs check install
.DEFAULT_GOAL := help

help:
	@sed -n '1,/^VENV/{/^# /s/^# //p}' $(MAKEFILE_LIST)

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml requirements.lock launch/install.sh
	@PYTHON="$(PYTHON)" sh launch/install.sh $(VENV)
	@touch $@

quickstart: install
	$(RUN) launch/generate.py $(EXPERIMENT)
	$(RUN) launch/train.py $(EXPERIMENT) run_dir=$(TRAINED)
	$(RUN) launch/render.py scene=data/scenes/cornell_box.json checkpoint=$(TRAINED)/checkpoints/best.ckpt \
		cameras=[0] against=radiosity output=data/renders reference=true
	$(RUN) launch/evaluate.py $(EXPERIMENT) checkpoint=$(TRAINED)/checkpoints/best.ckpt
	@echo
	@echo "Pictures        data/renders/cornell_box_0_comparison.png, $(TRAINED)/evaluation/*.png"
	@echo "Metrics         $(TRAINED)/evaluation/summary.csv"
	@echo "Report          $(TRAINED)/evaluation/report.html"
	@echo "Training run    $(RUN) -m mlflow ui --backend-store-uri sqlite:///data/runs/mlflow.db"
	@echo "                and open http://127.0.0.1:5000/#/experiments/1?workflowType=machine_learning"
	@echo "Render more     $(RUN) launch/render.py scene=data/scenes/roughness_spheres.json checkpoint=$(TRAINED)/checkpoints/best.ckpt"

test: install
	$(PYTEST) -m "not slow"

test-all: test
	$(PYTEST) -m slow

fuzz: install
	FUZZ=900 FUZZ_TABLE=data/results/fuzz.csv $(RUN) -m pytest tests/fuzz

docs: install
	$(RUN) -m sphinx -W --keep-going -q -c docs -b html . docs/_build/html

check: install
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/lint-imports
	$(VENV)/bin/mypy
