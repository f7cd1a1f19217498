"""The stage `certify`: leakage in labyrinths from elsewhere, and in anyone's benchmark.

It writes one file for each source, in `data_dir/analysis/`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator

from labyrinth_core.benchmarks import CertifyError, certify
from labyrinth_core.errors import DatasetError
from pipeline.certify.labyrinths import certify_labyrinths
from pipeline.certify.options import CertifyStageOptions
from pipeline.config import Job
from pipeline.machinery import leave, say, within

FOLDER = "analysis"
"""The folder in `data_dir` for the analyses of data from elsewhere."""


def run(job: Job[CertifyStageOptions]) -> None:
    """Certify the source that the options name.

    Raises:
        DatasetError: The source cannot be read, or its environment cannot be certified.
        OSError: The result cannot be written.
    """
    options = job.options.certify
    source = str(options.source)
    if options.is_benchmark:
        given = (options.train, options.test, options.probes, options.steps)
        lines = _certify_benchmark(job, _name_of(source, " ".join(map(str, given))))
    else:
        name = _name_of(source, options.config)
        lines = certify_labyrinths(
            source,
            options.config,
            within(job.data_dir, FOLDER),
            name,
            overwrite=job.options.overwrite,
        )
    for line in lines:
        say(line)


def _certify_benchmark(job: Job[CertifyStageOptions], name: str) -> Iterator[str]:
    """Certify an environment, a file of records or a Minari dataset, and yield lines to print."""
    options = job.options.certify
    try:
        certificate = certify(
            str(options.source).removeprefix("gymnasium:"),
            options.train,
            options.test,
            probes=options.probes,
            steps=options.steps,
            workers=job.options.workers,
        )
    except CertifyError as error:
        raise DatasetError(str(error)) from error
    text = json.dumps(certificate.to_json(), indent=1) + "\n"
    folder = within(job.data_dir, FOLDER)
    leave(folder, {name: text.encode()}, overwrite=job.options.overwrite)
    yield str(certificate)
    yield certificate.sentence
    yield f"{folder / name} has the full results."


def _name_of(source: str, config: str | None) -> str:
    """Return the path in `FOLDER` of an external dataset's analysis, unique to source and config.

    A source with a named config gets a folder, with a file for the config.
    """
    names = []
    for part in (source,) if config is None else (source, config):
        legible = re.sub(r"[^\w.-]+", "-", part).strip("-.")[:99]
        names.append(f"{legible}-{hashlib.sha256(part.encode()).hexdigest()[:8]}")
    return f"{'/'.join(names)}.json"
