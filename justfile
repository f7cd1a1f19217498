# One word a chore; `just` lists them.

default:
    @just --list

# Install everything that is needed for development into the current environment
setup:
    pip install -c constraints.txt -e '.[test]'

# Run the fast tests, in less than a minute
test *arguments:
    pytest -m "not slow" {{arguments}}

# Run all tests
test-all *arguments:
    pytest {{arguments}}

# Lint, check the format and the types
check:
    ruff check .
    ruff format --check .
    mypy

# Run the benchmarks, quickly; without --quick each takes minutes
bench:
    python scripts/benchmark_build.py --quick
    python scripts/benchmark_parquet.py --quick
    python scripts/benchmark_load.py --quick
    python scripts/benchmark_env.py --quick
    python scripts/benchmark_core.py --quick
    python scripts/benchmark_evaluate.py --quick
    python scripts/benchmark_leakage.py --quick
    python scripts/benchmark_report.py --quick

# Draw the pictures of the documentation again
docs:
    python scripts/draw_pictures.py

# All that continuous integration does, in a fresh environment
ci:
    .ci/run
