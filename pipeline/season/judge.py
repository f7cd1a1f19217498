"""The stage `judge`: evaluate a submission on the season's test, and commit to its results.

The full results stay private until the season is revealed, because they name the labyrinths and
say which were solved. What is published is an entry with the figures to two decimals and the
SHA-256 of the results, which commits the judge to them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from math import log, sqrt
from pathlib import Path
from threading import Event, Timer
from typing import Annotated, Any, NamedTuple, TypedDict

from numpy.typing import NDArray

from labyrinth_core import typed
from labyrinth_core.data import SPLITS, Dataset, DatasetConfig
from labyrinth_core.errors import DatasetError, one_line
from labyrinth_core.evaluation import Description, Evaluation, PolicyError, Results
from labyrinth_core.policies import SECONDS, PolicyNameError, files_of
from labyrinth_core.storage import File
from labyrinth_core.world import Task
from pipeline.config import ConfigError, Job
from pipeline.machinery import held, leave, say, tracked
from pipeline.season.options import SUBMISSION, SeasonStageOptions
from pipeline.season.season import (
    MOST_BYTES,
    Layout,
    Season,
    check_rows,
    dataset,
    private_folder,
    require_regular,
)

_SIGNED = ("submission", "commit", "files", "versions")
_DECIMALS = 2
"""The decimals of published figures: too few to learn about single labyrinths by resubmitting."""

CONTROLS = 200
"""The number of control training sets with which the judge asks whether a policy remembers."""

Row = dict[str, Any]
"""The published entry of a judged submission, with the fields of `_Row`."""


@dataclass(frozen=True)
class _Row:
    submission: typed.Address
    commit: typed.Commit | None
    files: Mapping[typed.Word, typed.Sha256]
    versions: Mapping[typed.Word, typed.Version]
    figures: Mapping[Annotated[str, typed.Like("|".join(SPLITS))], _Figures]
    results_sha256: typed.Sha256


class _Figures(TypedDict):
    spl: typed.Share
    sr: typed.Share


@dataclass(frozen=True)
class _List:
    season: str
    judged: list[Any]


class Judged(NamedTuple):
    """A judged submission."""

    row: Row
    results: Results
    content: bytes
    """The content of the results file."""


def run(job: Job[SeasonStageOptions]) -> None:
    """Judge a submission; if it was judged before, check that the results are the same.

    Raises:
        ConfigError: The submission has a name that is not allowed, such as that of a baseline, or
            nothing can be said about the train of the dataset that it has learnt from.
        DatasetError: The season or the submission does not exist, the season is revealed, or the
            submission was judged before with other results.
        PolicyError: The policy raises an error, or returns anything but actions.
    """
    layout, named = Layout.of(job), job.options.season.submission
    try:
        check_name(named)  # Checked now, before the policy plays for hours.
    except ValueError as error:
        raise ConfigError(f"season.submission: {error}") from error
    season, train = Season.read(layout), _train_named(job.options.season.learnt_from)
    with held(layout.public, layout.judged.name):
        if layout.revealed.exists():  # Asked while no other process can reveal it.
            raise DatasetError(f"{layout.public} is revealed, so nothing more can be judged on it")
        secret = season.find_secret(layout)
        rows = settled(layout, season)
        publish(layout, season, rows)
        with fetched(named) as submission:
            about = {"submission": named, "commit": submission.commit, "files": submission.files}
            before = next((row for row in rows if row | about == row), None)
            config = season.dataset_of(secret)
            with dataset(job.options.workers, config) as data:
                season.other_shards(data.manifest)  # Raises an error if the content differs.
                signed = None if before is None else before["versions"]
                row, results, content = judged(season, submission, data, signed, train)
            if before is None:
                rows.append(row)
            elif before != row:
                raise DatasetError(
                    f"{named} was judged before, with other results or another "
                    f"season.learnt_from: see {layout.judged}"
                )
            number = rows.index(row) + 1
            _keep(layout, number, submission, content, overwrite=job.options.overwrite)
            publish(layout, season, rows)
    again = "" if before is None else " again, with the same bytes"
    say(f"{named} is judged{again}: {shown(row['figures']['test'])}, in {layout.judged}")
    if results.memorised:  # Its copies name labyrinths of the test.
        say(str(replace(results.memorised, copies=())))
    if len(rows) > 1:
        # A share of n labyrinths is sub-Gaussian with variance 1 / 4n. The expected maximum of k of
        # them is at most this (Boucheron, Lugosi and Massart 2013, theorem 2.5).
        chance = sqrt(log(len(rows)) / (2 * season.labyrinths["test"]))
        say(f"As the best of {len(rows)} is chosen, its figures may be {chance:.3f} too high.")


def check_name(named: object) -> None:
    """Raise ValueError if a submission may not have this name, such as that of a baseline."""
    typed.read_as(Annotated[str, typed.Like(SUBMISSION)], named, "the submission")
    for name in (str(named), str(named).partition("@")[0]):
        Description(name)


def shown(figures: Mapping[str, float]) -> str:
    """Return the figures on a split as they are printed."""
    return f"SPL {figures['spl']:.2f}, SR {figures['sr']:.2f}"


def judged(
    season: Season,
    submission: Submission,
    data: Dataset,
    signed: Mapping[str, str] | None = None,
    train: DatasetConfig | None = None,
) -> Judged:
    """Evaluate a submission on the test of a season.

    Args:
        season: The season.
        submission: The submission.
        data: The season's dataset.
        signed: The library versions that the judge recorded; None for this process's versions.
        train: The config of the dataset that the submission has learnt from, to ask whether it
            remembers its train; None to ask nothing.

    Raises:
        DatasetError: The judge recorded no version of a library, or `train` is of another size or
            task than the season, too large, or has too few structures.
        PolicyError: The policy raises an error, returns anything but actions, or does not support
            these labyrinths.
    """
    here = versions(submission.library)
    signed = here if signed is None else signed
    if lacking := [name for name in here if name not in signed]:
        raise DatasetError(f"its entry has no version of {', '.join(lacking)}")
    asked = Evaluation.of(submission.policy, data)
    results = asked.results(
        ["test", *data.manifest.config.shifts],
        advice="a season judges only policies that do not draw at random and remember nothing "
        "between two batches",
        follow=lambda each: tracked(each, "judge", len(each)),
    )
    results = results.signed(
        season=season.name,
        secret_sha256=season.secret_sha256,
        submission=submission.named,
        commit=submission.commit,
        files=submission.files,
        versions=signed,
    )
    if train is not None:
        results = _with_receipt(results, asked, train)
    content = results.to_text(Description(submission.named)).encode()
    return Judged(_row(results, content), results, content)


def _train_named(named: str) -> DatasetConfig | None:
    """Return the config of the dataset that `season.learnt_from` names, if any."""
    if not named:
        return None
    source, _, name = named.rstrip("/").rpartition("/")
    try:
        return Evaluation.train_of(Dataset(source, name))
    except DatasetError:
        raise
    except ValueError as error:
        raise ConfigError(f"season.learnt_from={named}: {error}") from error


def _with_receipt(results: Results, asked: Evaluation, train: DatasetConfig) -> Results:
    """Add to results whether the submission follows the train of a dataset in the season's test.

    The test follows from the secret alone, so it does not depend on that train.
    """
    here = asked.data.manifest.config
    try:
        if train.name != here.name:
            raise ValueError(f"{train.name} is not {here.name}")
        check_rows(replace(train, labyrinths=(1 + CONTROLS) * train.labyrinths))
        return replace(results, memorised=asked.receipt("test", CONTROLS, train=train))
    except (DatasetError, PolicyError):
        raise
    except ValueError as error:
        raise DatasetError(f"season.learnt_from: {error}") from error


def _row(results: Results, content: bytes) -> Row:
    """Return the entry of judged results, which are in a file with this content."""
    row = {name: value for name, value in asdict(results)["judged"].items() if name in _SIGNED}
    row["figures"] = {
        split: {"spl": round(scores.spl, _DECIMALS), "sr": round(scores.sr, _DECIMALS)}
        for split, scores in results.splits.items()
    }
    row["results_sha256"] = hashlib.sha256(content).hexdigest()
    return row


def settled(layout: Layout, season: Season) -> list[Row]:
    """Return all entries, after comparing the public list with the private results.

    The list may lack the last entries: their process was killed before it published them, or an
    older list was put in its place. They follow from the results.

    Raises:
        DatasetError: Results are missing, or others than those in the list.
    """
    rows = read_rows(layout, season)
    numbers = {int(path.stem) for path in layout.private.glob("*.json") if path.stem.isdecimal()}
    for number in range(1, max(numbers | {len(rows)}) + 1):
        kept, row = layout.private / f"{number}.json", None
        results = Results.load(kept) if number in numbers else None
        if results and results.judged and results.judged.secret_sha256 == season.secret_sha256:
            row = _row(results, kept.read_bytes())
        if row is None or rows[number - 1 : number] not in ([], [row]):
            raise DatasetError(f"{kept} does not hold the results that {layout.judged} names")
        if number > len(rows):
            rows.append(row)
    return rows


def _keep(
    layout: Layout, number: int, submission: Submission, content: bytes, *, overwrite: bool
) -> None:
    """Keep the results of a submission private until the reveal.

    Its files come first if they are not on the Hub: a submission with results is complete.
    """
    layout.private.mkdir(mode=0o700, exist_ok=True)
    files = {}
    if submission.commit is None:
        paths = submission.folder.iterdir()
        files = {f"{number}/{path.name}": path.read_bytes() for path in paths}
    leave(layout.private, {**files, f"{number}.json": content}, overwrite=overwrite)


def publish(layout: Layout, season: Season, rows: list[Row]) -> None:
    """Write the list of judged submissions, unless nothing is judged."""
    if rows:
        text = json.dumps({"season": season.name, "judged": rows}, indent=2, ensure_ascii=False)
        # Overwritten, because `rows` has the rows of the file.
        leave(layout.public, {layout.judged.name: f"{text}\n".encode()}, overwrite=True)


def read_list(layout: Layout, season: Season) -> list[Any]:
    """Return the entries of the public list as they are; raise a DatasetError without a list."""
    try:
        require_regular(layout.judged, MOST_BYTES)
        content: _List = typed.read_as(_List, File(layout.judged).read_json())
        if content.season != season.name:
            raise ValueError(f"it.season is {content.season!r:.60}, not {season.name!r}")
    except FileNotFoundError:
        return []
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(
            f"{layout.judged} is not a list of results: {one_line(error):.300}"
        ) from error
    return content.judged


def check_row(row: Any) -> None:
    """Raise ValueError if an entry of the list is not that of a judged submission."""
    typed.read_as(_Row, row)
    if "test" not in row["figures"]:
        raise ValueError("it.figures has no test")
    check_name(row["submission"])


def read_rows(layout: Layout, season: Season) -> list[Row]:
    """Return the judged submissions in order; raise a DatasetError if the list cannot be read."""
    rows = read_list(layout, season)
    for number, row in enumerate(rows, 1):
        try:
            check_row(row)
        except ValueError as error:
            raise DatasetError(
                f"{layout.judged}: entry {number}: {one_line(error):.300}"
            ) from error
    return rows


class Submission(NamedTuple):
    """A policy to judge, and the files that it was loaded from."""

    named: str
    commit: str | None
    """The commit on the Hub; None for a folder or a file."""
    files: dict[str, str]
    """Name -> SHA-256."""
    folder: Path
    """A folder with a copy of these files, and nothing else."""
    policy: Any
    """A policy that `evaluate` accepts; its attributes name its observation."""
    library: str
    """The library that runs it."""


@contextmanager
def fetched(
    named: str, folder: Path | None = None, pinned: Mapping[str, Any] | None = None
) -> Iterator[Submission]:
    """Load a submission, and yield it; its copied files are removed at the end.

    Args:
        named: An id on the Hub, a folder or a file; optionally followed by `@` and a revision or,
            for a folder or a file, the SHA-256 of its weights.
        folder: The folder of its files, if they are not at `named`.
        pinned: The `commit` and `files` that were judged; None if it is judged for the first time.

    Raises:
        DatasetError: The policy does not exist, or differs from the named or pinned revision.
        PolicyError: An ONNX graph has other inputs or outputs than a policy.
    """
    try:
        if folder is not None:
            source = files_of(folder)
        elif pinned:
            source = files_of(named.partition("@")[0], pinned["commit"], on_hub=True)
        else:
            source = files_of(named)
    except PolicyNameError as error:
        raise DatasetError(str(error)) from error
    with private_folder() as own:
        copies = source.copied(own)
        files = dict(sorted(copies.origin().files.items()))
        for name, expected in pinned["files"].items() if pinned else ():
            if files.get(name) != expected:
                raise DatasetError(
                    f"{named}: {name} differs from the named revision: it is "
                    f"{files.get(name) or 'missing':.16}, not {expected:.16}"
                )
        try:
            policy = copies.open(named)
        except DatasetError as error:  # Name the original, not the temporary copy.
            raise DatasetError(str(error).replace(str(own), named)) from error
        if source.is_graph:
            with policy:
                yield Submission(named, source.commit, files, own, policy, "onnxruntime")
        else:
            import torch

            torch.set_num_threads(1)  # With several threads, sums may round differently.
            yield Submission(named, source.commit, files, own, _Limited(policy), "torch")


class _Limited:
    """A loaded policy that is refused if a call takes too long, as a graph is.

    It has `SECONDS` for a batch, or for each labyrinth if it plans for one at a time.
    """

    def __init__(self, policy: Any) -> None:
        self._policy, self._late = policy, Event()
        for module in policy.network.modules():  # So that a long call ends before its end.
            module.register_forward_pre_hook(lambda *_: self._require_time())

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the policy: what it has to be shown, or a method."""
        attribute = getattr(self._policy, name)
        if name != "act":
            return attribute
        return lambda observations: self._in_time(attribute, observations, len(observations))

    def for_labyrinths(self, height: int, width: int, task: Task) -> _Limited:
        """Return the policy for labyrinths of another size."""
        return _Limited(self._policy.for_labyrinths(height, width, task))

    def __call__(self, observations: NDArray[Any]) -> Any:
        """Return the scores of the four actions, shape (B, 4)."""
        return self._in_time(self._policy, observations)

    def _in_time(
        self, call: Callable[[NDArray[Any]], Any], observations: NDArray[Any], parts: int = 1
    ) -> Any:
        self._late = Event()
        timer = Timer(SECONDS * parts, self._late.set)
        timer.start()
        try:
            answer = call(observations)
        finally:
            timer.cancel()
        self._require_time()
        return answer

    def _require_time(self) -> None:
        if self._late.is_set():
            raise PolicyError(f"the policy takes more than {SECONDS:g} seconds")


def versions(library: str) -> dict[str, str]:
    """Return the versions of the libraries that judge a policy."""
    return {name: version(name) for name in ("labyrinth-datasets", "numpy", library)}
