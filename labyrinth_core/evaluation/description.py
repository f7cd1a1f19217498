"""The description of a policy: its name, its author, and the run that made it."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, ClassVar, TypedDict

from labyrinth_core import typed
from labyrinth_core.checks import whole
from labyrinth_core.data import SPLITS, DatasetConfig

LONGEST = 300
"""The largest number of characters of a text."""

ConfigName = Annotated[str, typed.Like(DatasetConfig.NAME.pattern)]
SplitName = Annotated[str, typed.Like("|".join(SPLITS))]

_URL = re.compile(r"https?://\S+")


@cache
def _reserved() -> frozenset[str]:
    """Return the names of the baselines, which no policy may have."""
    from labyrinth_core.evaluation.baselines import WITHOUT_LEARNING

    return frozenset(name.replace("_", " ") for name in WITHOUT_LEARNING)


@dataclass(frozen=True)
class Description:
    """The description of a policy in tables; all but the name may be left out.

    Raises:
        ValueError: The name is empty or a baseline's, the address or the date is not valid, a text
            is too long or has unprintable characters, or a detail is not in `DETAILS` or not a
            count.
    """

    DETAILS: ClassVar[Mapping[str, str]] = {
        "labyrinths": "number of labyrinths that the policy learnt from",
        "steps": "number of steps in environments during training",
        "parameters": "number of parameters of its networks",
    }
    """Detail -> what it counts."""

    name: str
    """What the policy is called."""
    author: str = ""
    """Who made it."""
    url: str = ""
    """Where it is described, as `https://...`."""
    date: str = ""
    """When it was evaluated, as `2026-11-30`."""
    budget: str = ""
    """What it has learnt from, in words."""
    details: Mapping[str, typed.Count] = field(default_factory=dict)
    """Counts, such as of its training labyrinths; the keys are those of `DETAILS`."""

    def __post_init__(self) -> None:
        for what in ("name", "author", "url", "date", "budget"):
            text = getattr(self, what)
            if not isinstance(text, str) or len(text) > LONGEST or not text.isprintable():
                raise ValueError(
                    f"{what}={text!r:.60}: give one line of at most {LONGEST} printable characters"
                )
        if not self.name.strip():
            raise ValueError(f"name={self.name!r}: say what the policy is called")
        if self.as_compared(self.name).replace("_", " ") in _reserved():
            raise ValueError(f"name={self.name}: a baseline has this name; choose another")
        if self.url and not _URL.fullmatch(self.url):
            raise ValueError(f"url={self.url}: give an address such as https://example.org")
        if self.date and not typed.is_day(self.date):
            raise ValueError(f"date={self.date}: give a day such as 2026-11-30")
        for detail, number in self.details.items():
            if detail not in self.DETAILS:
                raise ValueError(f"details: {detail!r:.60}: choose from {', '.join(self.DETAILS)}")
            allowed = "a whole number from 0 on"
            whole(f"details: {detail}", number, 0, 10**15 - 1, allowed=allowed)
        object.__setattr__(self, "details", {name: int(n) for name, n in self.details.items()})

    @staticmethod
    def as_compared(name: str) -> str:
        """Return a name without differences of case, blanks or letter forms."""
        return " ".join(unicodedata.normalize("NFKC", name).casefold().split())


@dataclass(frozen=True, kw_only=True)
class RunName:
    """The choices that distinguish a training run on a dataset, and the run's name."""

    FRESH: ClassVar[str] = "fresh"
    """In place of the number of labyrinths learnt from, if each epoch had new ones."""

    method: typed.Word
    encoder: typed.Word
    """The network that encodes observations; the method's name if it has its own network."""
    protocol: typed.Word
    train_labyrinths: typed.Learnt = None
    """The number of labyrinths learnt from; None for all, `FRESH` for new ones in each epoch."""
    seed: typed.Seed

    @property
    def first_labyrinths(self) -> int | None:
        """The number of the first labyrinths of train, if the run learnt from these alone."""
        return self.train_labyrinths if isinstance(self.train_labyrinths, int) else None

    @property
    def _others(self) -> list[str]:
        """The choices besides method, encoder and seed that are not the defaults."""
        parts = [self.protocol] * (self.protocol != "default")
        if self.train_labyrinths == self.FRESH:
            parts.append(self.FRESH)
        elif self.train_labyrinths is not None:
            parts.append(f"labyrinths{self.train_labyrinths}")
        return parts

    @property
    def setup(self) -> str:
        """All choices but method and seed, such as `cnn` or `resnet18-paper`."""
        return "-".join([self.encoder, *self._others])

    @property
    def of_all_seeds(self) -> str:
        """The name without the seed, such as `bc-cnn` or `iupe-resnet18-paper`."""
        return "-".join([*self._learner, *self._others])

    @property
    def name(self) -> str:
        """The name of the run and of its folder, such as `iupe-resnet18-seed2-paper`."""
        return "-".join([*self._learner, f"seed{self.seed}", *self._others])

    @staticmethod
    def title_of(method: str) -> str:
        """Return a method's name in tables: `bc`, or of `module:Class` the name of the class.

        A class called `Method` is named after its module.
        """
        module, _, name = method.partition(":")
        name = name.rpartition(".")[2]
        return module.rpartition(".")[2] if name in ("", "Method") else name

    @property
    def _learner(self) -> list[str]:
        return [self.method] + [self.encoder] * (self.encoder != self.method)


class Epoch(TypedDict):
    """The number of an epoch, beside its metrics."""

    epoch: typed.Count


class Computed(TypedDict):
    """What a run was computed on, beside threads and versions of libraries."""

    device: typed.Word


class Training(TypedDict):
    """How a policy was trained."""

    epochs: typed.Count
    seconds: Annotated[float, typed.Within(0)]
    selected: Epoch
    """The epoch whose weights are kept."""
    computed: Computed


class Played(TypedDict):
    """What the policy of a run was evaluated on."""

    device: typed.Word
    versions: Mapping[str, str]
    """Library -> version."""
    weights: typed.Sha256 | None
    """The SHA-256 of the weights; None in results of an earlier version."""


@dataclass(frozen=True, kw_only=True)
class TrainedRun(RunName):
    """The training run that made a policy, as stored in its results."""

    settings: Mapping[typed.Word, Any]
    """The settings of the method."""
    config: ConfigName
    """The config of the dataset it learnt from, such as `5x5`."""
    dataset: str
    revision: str | None = None
    fingerprint: typed.Sha256
    """The fingerprint of that dataset."""
    training: Training
    evaluated: Played
    references_know: typed.Sha256 | None = None
    """The fingerprint of the dataset whose train the references know; None if it is the dataset
    on which the policy is judged."""
    as_tried: Mapping[SplitName, Mapping[typed.Word, float]] | None = None
    """Figures by split under the protocol's own rules, if any."""


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Where a policy was opened and what its files are, so that anyone can play it again."""

    source: typed.Address
    """A folder, a file, or an id on the Hub."""
    commit: typed.Commit | None
    """The commit on the Hub; None for a folder or a file."""
    files: Mapping[typed.Word, typed.Sha256]
    """Name -> SHA-256 of each file, the weights first."""


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """What the judge of a season signs: the policy, its files, and the versions of libraries."""

    season: typed.Word
    secret_sha256: typed.Sha256
    """The season's commitment to its secret."""
    submission: typed.Address
    """The policy as submitted: an id on the Hub with a revision, or a folder."""
    commit: typed.Commit | None
    """The commit on the Hub; None for a folder."""
    files: Mapping[typed.Word, typed.Sha256]
    """Name -> SHA-256 of each file of the policy, including its weights."""
    versions: Mapping[typed.Word, typed.Version]
    """Library -> version that the judge used."""
