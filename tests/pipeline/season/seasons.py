"""Stages of a season, performed in a folder that holds all that they leave."""

from __future__ import annotations

import hashlib
import io
import json
import tempfile
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace

import pytest
from support.making import RunConfig, perform
from support.policies import RELEASED

from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import PolicyError
from pipeline.season.season import Layout


class Performer:
    """What performs stages in a folder, in which all temporary files are, and keeps the output."""

    def __init__(self, folder, make_run):
        self.folder, self._make_run, self.printed = folder, make_run, ""

    def __call__(
        self,
        stage,
        folder="seasons",
        submission=str(RELEASED),
        date="2026-11-30",
        learnt_from="",
        **options,
    ):
        """Perform a stage; return what it prints, or the error that it raises."""
        of_season = replace(
            RunConfig().season,
            name="2026-a",
            folder=str(self.folder / folder),
            date=date,
            submission=submission,
            learnt_from=learnt_from,
        )
        options = {"size": "3", "labyrinths": 16, "random_steps": 5} | options
        run = self._make_run(self.folder / "data", stages=[stage], season=of_season, **options)
        (self.folder / "temporary").mkdir(exist_ok=True)
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as out:
            patch.setattr(tempfile, "tempdir", str(self.folder / "temporary"))
            with redirect_stderr(out):
                error = ""
                try:
                    perform(stage, run)
                except (DatasetError, PolicyError) as raised:
                    error = str(raised)
        self.printed += out.getvalue() + error
        return error or " ".join(out.getvalue().split())

    @property
    def place(self):
        return Layout(self.folder / "seasons" / "2026-a")


def seed_of(place, secret):
    """Return the seed that follows from a secret and the season's config, as the page says."""
    config = json.loads(place.season.read_text(encoding="utf-8"))["config"]
    text = json.dumps(config, sort_keys=True, separators=(",", ":"))
    hashed = hashlib.sha256(b"labyrinth season, seed, version 1\n" + secret + text.encode())
    return int(hashed.hexdigest()[:16], 16)
