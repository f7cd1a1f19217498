# One word for each maintenance command; `just` lists them.

default:
    @just --list

# Install everything that is needed for development into the current environment
setup:
    pip install -c constraints.txt -e '.[test]'

# Run the fast tests, in under a minute; `pytest` runs all
test *arguments:
    pytest -m 'not slow' {{arguments}}

# Lint, check the format and the types
check:
    ruff check .
    ruff format --check .
    mypy

# Run the benchmarks briefly; without --quick each takes minutes
bench:
    python scripts/benchmark_build.py --quick
    python scripts/benchmark_load.py --quick
    python scripts/benchmark_certify.py --quick

# Run the benchmark beside MiniGrid, which needs an environment of its own
bench-beside:
    python scripts/benchmark_env.py --quick

# Build the site of the documentation in build/site; `pip install -c constraints.txt -e '.[docs]'` first
docs:
    mkdocs build --strict

# Do what the README and all guides say, in bash and in zsh
walk *pages:
    python scripts/run_documentation.py {{pages}}

# Draw the pictures of the documentation again
pictures:
    python scripts/draw_pictures.py

# Write down what pictures and rows are now, after a change that is meant to change them
renew:
    pytest -n0 --renew -k always tests/labyrinth_core/pictures tests/pipeline/generation

# Write the tables of docs/studies and draw its figures again, from docs/results
studies:
    python scripts/studies/report_pages.py --figures docs/pictures

# Check everything that is asked of a change, in a fresh environment
ci:
    .ci/run
