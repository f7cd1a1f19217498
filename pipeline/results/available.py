"""The datasets that results are checked against."""

from __future__ import annotations

from labyrinth_core.data import Dataset, Manifest
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation.known import KnownDataset
from labyrinth_core.evaluation.results import Results
from pipeline.config.errors import check
from pipeline.config.stage import Job
from pipeline.results.options import ResultsOptions


class Available:
    """The configs of the dataset that a run names, each read when it is first needed.

    Raises:
        ConfigError: A folder is given with a revision.
    """

    def __init__(self, job: Job[ResultsOptions]) -> None:
        revision = job.options.revision
        check(
            revision is None or not Dataset.is_folder(job.source),
            f"revision={revision}: {job.source} is a folder, which has no revisions",
        )
        self._job = job
        self._found: dict[str, KnownDataset | None] = {}
        self.missing: dict[str, str] = {}
        """Config -> why it is not available."""

    def __call__(self, config: str) -> KnownDataset | None:
        """Return a config such as `5x5`, or None if it is not available."""
        if config not in self._found:
            job = self._job
            try:
                if (
                    job.options.dataset is None
                    and not (job.data_dir / config / Manifest.FILE).is_file()
                ):
                    raise DatasetError(f"{job.data_dir / config} holds no dataset")  # Ask no Hub.
                self._found[config] = KnownDataset.read(job.source, config, job.options.revision)
            except DatasetError as error:
                self._found[config] = None
                self.missing[config] = str(error)
        return self._found[config]

    def has(self, results: Results) -> bool:
        """Return whether the dataset of some results is available, so that they can be checked."""
        known = self(results.config)
        return known is not None and known.fingerprint == results.fingerprint
