"""A release by the real command line, and what others load from the Hub afterwards."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from hub.local_hub import LocalHub
from support.publishing import (
    REPO,
    ROOT,
    built,
    changes,
    error_of,
    held,
    large,
    publish,
    published,
    run_python,
    run_script,
)

from labyrinth_core.data import SPLITS
from pipeline.release.faults import reasons

pytestmark = pytest.mark.slow

EVERYTHING = """
import json, os, sys
from pathlib import Path
import pyarrow.parquet as pq
from datasets import Image, get_dataset_config_names, get_dataset_split_names, load_dataset
from labyrinth_core import DatasetError, load_transitions, stream_transitions

repo, revision, folder, blocks = *sys.argv[1:3], Path(sys.argv[3]), json.loads(sys.argv[4])
for block in blocks:
    exec(compile(block, "README.md", "exec"), names := {})
results = {"card": [*names["picture"].size, len(names["actions"])], "refused": []}
for load in (load_transitions, stream_transitions):
    try:
        load(repo, "9x9")
    except DatasetError as error:
        results["refused"].append(str(error))
rows, same = {}, {}
for config in get_dataset_config_names(repo, revision=revision):
    ways = [
        load_dataset(repo, config, revision=revision, streaming=streaming)
        for streaming in (False, True)
    ]
    for split in get_dataset_split_names(repo, config, revision=revision):
        paths = sorted((folder / config).glob(f"{split}-*.parquet"))
        if config.endswith("-labyrinths"):
            paths = [folder / config.removesuffix("-labyrinths") / "labyrinths.parquet"]
        here = [row for path in paths for row in pq.read_table(path).to_pylist()]
        name = f"{config} {split}"
        rows[name], same[name] = len(here), []
        for splits in ways:
            loaded = splits[split]
            if "obs" in loaded.column_names:
                loaded = loaded.cast_column("obs", Image(decode=False))
            same[name].append(list(loaded) == here)
    if not config.endswith("-labyrinths"):
        there = load_transitions(repo, config, revision=revision, image_size=8)
        here = load_transitions(folder, config, image_size=8)
        fields = ("observations", "next_observations", "actions", "rewards", "dones")
        same[config] = [
            bool((getattr(there, name) == getattr(here, name)).all())
            for name in (*fields, "labyrinth_ids")
        ]
print(json.dumps(results | {"rows": rows, "same": same}), flush=True)
os._exit(0)
"""
"""Everything that a person can load, compared with the files that were published.

The end is that of `pipeline.release.verify`, for its reason.
"""


def release(hub: LocalHub, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Return what became of `scripts/release`."""
    return run_python(hub, ROOT / "scripts" / "release", *arguments)


def test_the_three_sizes_are_released_by_one_command_and_loaded_as_they_were_built(
    local_hub: LocalHub, tmp_path: Path
) -> None:
    data_dir = tmp_path / "labyrinth"
    options = ("labyrinths=3", "random_steps=5", f"data_dir={data_dir}")
    done = release(local_hub, REPO, "1.0.0", *options)
    assert done.returncode == 0, done.stderr
    assert f'load_dataset("{REPO}", "5x5", revision="1.0.0")' in done.stdout
    assert held(local_hub, "1.0.0") == built(data_dir)
    card = local_hub.content(REPO, "README.md", "1.0.0").decode()
    assert [call.status for call in local_hub.log.find("POST", "/validate-yaml")] == [200]
    blocks = re.findall(r"```python\n(.*?)```", card, re.DOTALL)
    assert len(blocks) == 3

    arguments = (REPO, "1.0.0", data_dir, json.dumps(blocks))
    printed = run_script(local_hub, EVERYTHING, *arguments, USE_TORCH="0").stdout
    results = json.loads(printed.splitlines()[-1])
    configs, rows, same = ["3x3", "4x4", "5x5"], results["rows"], results["same"]
    assert results["refused"] == 2 * [f"config=9x9: {REPO} holds 3x3, 4x4, 5x5"]
    acting = rows["5x5 train"] - 3  # Without the last state of each episode.
    assert results["card"] == [600, 600, acting]
    assert list(rows) == [
        *(f"{config} {split}" for config in configs for split in SPLITS.base),
        *(f"{config}-labyrinths labyrinths" for config in configs),
    ]
    assert min(rows.values()) > 0
    assert same.keys() == {*rows, *configs}
    assert all(all(values) for values in same.values()), same

    # What the card counts is what is loaded.
    described = yaml.safe_load(card.split("---\n")[1])["dataset_info"]
    assert rows == {
        f"{info['config_name']} {split['name']}": split["num_examples"]
        for info in described
        for split in info["splits"]
    }
    total = sum(count for name, count in rows.items() if not name.endswith(" labyrinths"))
    assert f"**{total:,} rows** in 3 configs" in card


def test_the_command_that_releases_ends_at_the_first_failure(
    local_hub: LocalHub, tmp_path: Path
) -> None:
    for arguments, message in (
        ((REPO, "1.0"), "publish.version=1.0: give three numbers, such as 1.0.0"),
        ((REPO, "1.0.0", "labyrinths=0"), "labyrinths=0: give 1 or more"),
    ):
        done = release(local_hub, *arguments, f"data_dir={tmp_path / 'labyrinth'}")
        assert error_of(done) == message
    assert not (tmp_path / "labyrinth").exists()
    assert len(local_hub.log) == 0


def test_a_release_that_adds_a_config_sends_it_alone_and_leaves_the_first_as_it_was(
    released_hub: LocalHub, released: Path, with_one_more: Path
) -> None:
    released_hub.faults.set_page_size(3)
    first, known, asked = held(released_hub, "1.0.0"), large(released_hub), len(released_hub.log)
    assert first == built(released)
    shutil.copytree(with_one_more / "3x3-icy_floor", released / "3x3-icy_floor")
    published(released_hub, released, "1.1.0")
    assert held(released_hub) == held(released_hub, "1.1.0") == built(released)
    sent = released_hub.log.uploaded(asked)
    paths = [path for path, digest in held(released_hub).items() if digest in sent]
    assert sorted(sent) == sorted(large(released_hub) - known)
    assert {Path(path).parent.name for path in paths} == {"3x3-icy_floor", "pictures"}

    assert held(released_hub, "1.0.0") == first
    changelog = released_hub.content(REPO, "CHANGELOG.md").decode()
    assert re.findall(r"^## (.*)$", changelog, re.MULTILINE) == ["1.1.0", "1.0.0"]


def test_a_version_is_published_once(
    released_hub: LocalHub, released: Path, other_shard: Path
) -> None:
    refs, asked = released_hub.refs(REPO), len(released_hub.log)
    assert published(released_hub, released).splitlines()[0] == (
        f"1.0.0 is published already, at {refs['refs/tags/1.0.0'][:12]}."
    )
    readme = released / "README.md"
    readme.write_text(readme.read_text(encoding="utf-8") + "\nMine.\n", encoding="utf-8")
    printed = published(released_hub, released)
    assert printed.splitlines()[0].endswith(", with a different card.")

    shutil.rmtree(released / "2x3")
    shutil.copytree(other_shard / "2x3", released / "2x3")
    before = built(released)
    for option in ("publish.dry_run=true", "publish.dry_run=false"):
        error = error_of(publish(released_hub, released, "1.0.0", option))
        assert error == (
            f"the tag 1.0.0 of {REPO} is at {refs['refs/tags/1.0.0'][:12]}, with other data "
            "(2x3/labyrinths.parquet): choose another publish.version"
        )
    assert released_hub.refs(REPO) == refs
    assert changes(released_hub, asked) == []
    assert built(released) == before


def stamps(folder: Path) -> dict[str, tuple[int, bytes]]:
    """Return what a dry run must not change: of every file the time and the bytes."""
    return {
        path.relative_to(folder).as_posix(): (
            path.stat().st_mtime_ns,
            path.read_bytes() if path.is_file() else b"",
        )
        for path in [folder, *folder.rglob("*")]
    }


@pytest.mark.parametrize(
    ("token", "more", "why"),
    [
        (None, {}, "there is no token"),
        ("write", {"HF_HUB_OFFLINE": "1"}, "offline mode is enabled"),
        ("write", {"HF_ENDPOINT": "http://127.0.0.1:9"}, "Connection refused"),
    ],
)
def test_a_dry_run_without_token_or_network_lists_what_a_new_repository_would_get(
    local_hub: LocalHub, releasable: Path, token: str | None, more: dict[str, str], why: str
) -> None:
    options = ("publish.dry_run=true", "publish.private=true", "size=2x3", "publish.env=user/env")
    done = publish(local_hub, releasable, "1.0.0", *options, token=token, **more)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    first = f"cannot query the Hub .*{why}.* scripts/local_hub starts a Hub on this machine"
    assert re.match(first, lines[0])
    assert "  add    2x3/test-00000-of-00001.parquet" in lines
    whole = [line for line in lines if "(to be created, private): " in line]
    assert [line.split()[0] for line in whole] == [REPO, "user/env"]
    assert len(local_hub.log) == 0


def test_a_dry_run_tells_what_the_release_does_and_both_leave_what_is_not_theirs(
    local_hub: LocalHub, releasable: Path, released_hub: LocalHub, released: Path, other_shard: Path
) -> None:
    def dry(hub: LocalHub, folder: Path) -> list[str]:
        before, asked = stamps(folder), len(hub.log)
        printed = published(hub, folder, "1.1.0", "publish.dry_run=true")
        assert stamps(folder) == before
        assert changes(hub, asked) == []
        assert list((hub.folder / "temporary").iterdir()) == []
        return printed.splitlines()

    def plan(lines: list[str], word: str) -> list[str]:
        return sorted(line.split()[1] for line in lines if line.startswith(f"  {word:6} "))

    lines = dry(local_hub, releasable)
    assert not local_hub.has(REPO)
    new = f"{REPO} (to be created, public)"
    assert lines[-1].startswith(f"{new}: 16 files to add (0.2")
    assert lines[-1].endswith("; new tag: 1.1.0.")
    assert len(plan(lines, "add")) == 16

    names = ("notes.txt", "3x3/data-00000-of-00009.parquet")
    theirs = [released_hub.commit(REPO, path, b"mine") for path in names]
    old = held(released_hub)
    shutil.rmtree(released / "2x3")
    shutil.copytree(other_shard / "2x3", released / "2x3")
    (released / "CITATION.cff").write_bytes(b"mine")
    lines = dry(released_hub, released)
    published(released_hub, released, "1.1.0")
    assert released_hub.history(REPO)[1] == theirs[1]
    new = held(released_hub)
    assert new.pop(names[0]) == new.pop(names[1]) == old.pop(names[0])
    del old[names[1]]
    here = built(released)
    del here["CITATION.cff"]
    assert new == here
    assert plan(lines, "delete") == ["CITATION.cff"] == sorted(old.keys() - new)
    assert plan(lines, "add") == sorted(path for path in new if old.get(path) != new[path])
    assert plan(lines, "keep") == sorted(p for p in new if old.get(p) == new[p])
    assert "2x3/random-00000-of-00001.parquet" in plan(lines, "add")
    assert "2x3/train-00000-of-00001.parquet" in plan(lines, "keep")
    size = sum((released / path).stat().st_size for path in plan(lines, "add"))
    assert f"{len(plan(lines, 'add'))} files to add ({size / 1e6:.2f} MB)" in lines[-1]
    (line,) = dry(released_hub, released)
    assert line.startswith("1.1.0 is published already, at ")


def test_files_of_a_person_on_the_hub_stop_the_release_that_would_replace_them(
    local_hub: LocalHub, releasable: Path, released_hub: LocalHub
) -> None:
    local_hub.create_repo(REPO)
    local_hub.commit(REPO, "3x3/manifest.json", b"mine")
    for hub, version in ((local_hub, "1.0.0"), (released_hub, "1.1.0")):
        hub.commit(REPO, "README.md", b"mine")
        before = hub.history(REPO)
        error = error_of(publish(hub, releasable, version))
        told = f"{REPO} holds files that no release of this kind wrote, or changed since (README.md"
        assert error.startswith(told)
        assert hub.history(REPO) == before


def test_files_of_a_person_are_not_published_and_are_named(
    local_hub: LocalHub, releasable: Path
) -> None:
    stray = "2x3/train-00001-of-00002.parquet"
    theirs = ["CITATION.cff", "notes.txt", "pictures/my-passport.png", "report/index.html", stray]
    for name in theirs:
        (releasable / name).parent.mkdir(exist_ok=True)
        (releasable / name).write_bytes(b"mine")
    printed = published(local_hub, releasable)
    there = {name: digest for name, digest in built(releasable).items() if name not in theirs}
    assert held(local_hub) == there
    named = f"{stray}, CITATION.cff, notes.txt, pictures/my-passport.png, report/"
    assert f"not part of the release, and not published: {named}." in printed
    assert all((releasable / name).read_bytes() == b"mine" for name in theirs)


def test_main_does_not_go_back_to_an_earlier_version(
    released_hub: LocalHub, released: Path
) -> None:
    released_hub.tag(REPO, "1.10.0")
    asked = len(released_hub.log)
    error = error_of(publish(released_hub, released, "1.9.0"))
    assert f"publish.version=1.9.0: {REPO} has 1.10.0 already: choose a later" in error
    assert not changes(released_hub, since=asked)


def test_what_cannot_be_published_is_told_in_one_line(
    local_hub: LocalHub, releasable: Path, tmp_path: Path
) -> None:
    error = error_of(publish(local_hub, releasable, repo="user/laby--rinth"))
    assert error.startswith("the Hub's client refuses: ")
    error = error_of(publish(local_hub, tmp_path / "nowhere"))
    reason = "holds no finished dataset: labyrinth-datasets makes one"
    assert error == f"{tmp_path / 'nowhere'} {reason}"
    assert changes(local_hub) == []


def test_the_document_quotes_what_the_hub_may_answer_as_it_is_printed() -> None:
    text = (ROOT / "docs" / "release.md").read_text(encoding="utf-8")
    quoted = re.findall(r"^\| (.*?) \|", text.partition("## What the errors mean")[2], re.MULTILINE)
    answers = [line for line in quoted if REPO in line and "..." not in line]
    assert len(answers) == 3
    assert all(any(r.startswith(line) for r in reasons(REPO).values()) for line in answers)
