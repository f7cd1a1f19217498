"""The scripts of studies: the verdicts on the paper's cells."""

from __future__ import annotations

import pytest
import report_authors

from pipeline.results.paper import paper_figures


@pytest.mark.parametrize(
    ("cell", "ours", "theirs", "verdict"),
    [
        (("5x5", "train", "bc"), 0.37, None, "impossible"),
        (("5x5", "test", "bc"), 0.04, None, "reproduced"),
        (("5x5", "test", "bc"), 0.48, 0.06, "explained"),
        (("5x5", "test", "bc"), 0.48, 0.30, "open"),
        (("5x5", "test", "bc"), 0.48, None, "not run"),
    ],
)
def test_a_cell_of_the_paper_has_the_first_verdict_that_holds(
    cell: tuple[str, str, str], ours: float, theirs: float | None, verdict: str
) -> None:
    figure = paper_figures()[cell]
    assert report_authors.judge(figure, ours, theirs) == (figure.sr, theirs, ours, verdict)
