# make demo    sets up, renders the built-in scene `atrium` and says where the picture is
# make test    sets up, then lint, types and tests; these in a process a core, where llvmpipe and BLAS keep to one thread
# make sheet   draws every model under MODELS (../shared/models) in one picture, out/sheet.png
# make failures  runs the failure library: figures, and pictures in one, out/failures.png
# make viewer-pictures  takes the README's pictures of the viewer
# make setup   leaves a ready .venv in the checkout; quick when that is done already
#
# PYTHON=python3.12 chooses the interpreter (>= 3.11).

BIN := .venv/bin
SETUP := .ci/setup.sh
DEMO := out/atrium.png

MODELS ?= ../shared/models

.PHONY: help setup setup-dev demo test sheet failures viewer-pictures study-picture clean

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

setup:
	@sh $(SETUP)

setup-dev:
	@sh $(SETUP) dev

demo: setup
	@mkdir -p $(dir $(DEMO))
	@$(BIN)/glhybrid render atrium -o $(DEMO)
	@echo "The picture: $(abspath $(DEMO))"

# Compiled modules are kept, also where containers say otherwise: tests start many processes.
test: setup-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	PYTHONDONTWRITEBYTECODE= GLHYBRID_REQUIRE_GL=1 LP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --maxprocesses 4 --dist loadfile

sheet: setup
	@mkdir -p out
	$(BIN)/python tests/contact_sheet.py $(MODELS) -o out/sheet.png

failures: setup
	@mkdir -p out
	$(BIN)/python tests/failure_sheet.py -o out/failures.png

viewer-pictures: setup-dev
	$(BIN)/glhybrid view showroom --size 900x620 --mode split --against shadows=pcf,reflections=ssr --aa 2 \
		--pick 330,560 --screenshot scenes/pictures/viewer-split.png
	$(BIN)/glhybrid view showroom --size 900x620 --show reason --reflections ssr --pick 300,250 \
		--screenshot scenes/pictures/viewer-reason.png

study-picture: setup-dev
	$(BIN)/glhybrid study showroom --quick -o out/study
	cp out/study/charts/showroom-picture.svg scenes/pictures/study-showroom.svg

clean:
	rm -rf out build dist .pytest_cache .ruff_cache .mypy_cache
