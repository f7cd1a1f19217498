"""A report in the folder of datasets that have a card and are released."""

from __future__ import annotations

import shutil

import pytest
from support.tampering import content_of

from pipeline.machinery import Sums
from pipeline.release.card import write_card
from pipeline.release.repository import listed
from pipeline.report.report import write_report

pytestmark = pytest.mark.slow


def test_neither_dataset_nor_card_nor_release_is_touched(small_dataset, tmp_path):
    data_dir = shutil.copytree(small_dataset.data_dir, tmp_path / "labyrinth")
    write_card(data_dir)
    before = content_of(data_dir)
    published = {*listed(data_dir)}
    path = write_report(data_dir, tmp_path / "runs")
    after = content_of(data_dir)
    assert {name: after[name] for name in before} == before
    written = {path, path.with_name(Sums.FILE)}
    assert set(after) - set(before) == {str(each.relative_to(data_dir)) for each in written}
    assert {*listed(data_dir)} == published
