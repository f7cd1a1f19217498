"""Releasing to a Hub that answers wrongly: the old release or the new one, whole, or one line."""

from __future__ import annotations

import json
import re
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path

import pytest
from huggingface_hub import HfApi
from support.publishing import REPO

from hub.faults import UNLIMITED
from hub.local_hub import LocalHub
from labyrinth_core import hub as client
from labyrinth_core.data import Manifest
from labyrinth_core.errors import DatasetError
from pipeline.machinery import Sums
from pipeline.release import publish
from pipeline.release.card import write_card
from pipeline.release.faults import explained
from pipeline.release.options import PublishOptions
from pipeline.release.repository import Repository, listed
from pipeline.release.texts import Release

pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=<...>':DeprecationWarning")
"""The client's own uploads deserve it."""

COMMITTING = ("POST", "/commit/main$")
SHARD = "2x3/train-00000-of-00001.parquet"


@pytest.fixture(scope="module")
def carded(versions: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished dataset with its card; not to be changed."""
    folder = Path(shutil.copytree(versions[1], tmp_path_factory.mktemp("carded") / "labyrinth"))
    write_card(folder, Release(REPO, "1.0.0"))
    return folder


@pytest.fixture
def folder(carded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, to be changed; samples of its releases are not loaded."""
    monkeypatch.setattr(publish, "loaded", lambda *_: "")
    return Path(shutil.copytree(carded, tmp_path / "labyrinth"))


@pytest.fixture
def empty(faulty: LocalHub) -> LocalHub:
    """A Hub whose one repository has nothing but its first commit."""
    faulty.create_repo(REPO)
    return faulty


def release(folder: Path, version: str = "1.0.0") -> None:
    with explained(REPO):
        repository = Repository(HfApi(), REPO, "dataset")
        options = PublishOptions(repo_id=REPO, version=version)
        publish.release(options, repository, listed(folder), folder)


def refusal(folder: Path, version: str = "1.0.0") -> str:
    """Return why a folder is not released, in one line."""
    with pytest.raises(DatasetError) as caught:
        release(folder, version)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def hashes(folder: Path) -> dict[str, str]:
    return {name: file.sha256 for name, file in listed(folder).items()}


def held(hub: LocalHub, revision: str = "main") -> dict[str, str]:
    """Return the files on the Hub but those that it made, or another user."""
    tree = hub.tree(REPO, revision)
    return {p: e.sha256 for p, e in tree.items() if p not in (".gitattributes", "NEWS.md")}


def test_a_commit_whose_reply_is_lost_is_tagged_and_not_the_one_of_somebody_after_it(
    empty: LocalHub, folder: Path
) -> None:
    empty.faults.intrude(*COMMITTING, after=True)
    empty.faults.lose_response(*COMMITTING)
    empty.faults.stale("GET", "/commits/main$")
    release(folder)
    theirs, ours, _ = empty.history(REPO)
    assert (theirs.title, ours.title) == ("Change NEWS.md", "Release 1.0.0")
    assert empty.refs(REPO)["refs/tags/1.0.0"] == ours.oid
    assert held(empty, "1.0.0") == hashes(folder)


def test_a_release_that_was_killed_before_its_tag_is_tagged_though_somebody_committed(
    empty: LocalHub, folder: Path
) -> None:
    empty.faults.fail("POST", "/tag/", status=400)
    refusal(folder)
    empty.commit(REPO)
    release(folder)
    assert empty.refs(REPO)["refs/tags/1.0.0"] == empty.history(REPO)[1].oid


@pytest.mark.parametrize("body", [b"{}", b"null", b"<html>", b""])
def test_a_commit_whose_reply_cannot_be_read_is_found(
    empty: LocalHub, folder: Path, body: bytes
) -> None:
    empty.faults.answer(*COMMITTING, status=200, body=body, after=True)
    release(folder)
    assert len(empty.history(REPO)) == 2
    assert held(empty, "1.0.0") == hashes(folder)


def test_a_commit_that_the_hub_contradicts_itself_about_is_not_called_unchanged(
    empty: LocalHub, folder: Path
) -> None:
    empty.faults.lose_response(*COMMITTING)
    empty.faults.stale("GET", "/commits/main$", times=UNLIMITED)
    told = f"{REPO}: the Hub does not say whether the release was committed: publish again"
    assert refusal(folder).startswith(told)
    empty.faults.clear()
    release(folder)
    assert len(empty.history(REPO)) == 2


@pytest.mark.parametrize(
    ("readme", "is_refused"),
    [
        ("---\nlicense: mit\n---\n", False),
        ("# Mine\n", True),
        ("---\nlicense: mit\n---\nMine", True),
    ],
)
def test_files_of_the_first_commit_are_somebodys_but_for_the_licence_of_the_hubs_page(
    empty: LocalHub, folder: Path, readme: str, is_refused: bool
) -> None:
    repository = empty.repositories["dataset", REPO]
    tree = dict(empty.tree(REPO)) | {"README.md": empty.regular_entry(readme.encode())}
    repository.refs.clear()
    repository.commit("refs/heads/main", tree, "initial commit")
    if is_refused:
        assert "holds files that no release of this kind wrote, or changed since (README.md" in (
            refusal(folder)
        )
        assert len(empty.history(REPO)) == 1
    else:
        release(folder)
        assert held(empty, "1.0.0") == hashes(folder)


@pytest.mark.parametrize("fault", ["[]", "page"])
def test_a_list_of_files_that_lacks_some_is_never_believed(
    faulty: LocalHub, folder: Path, fault: str
) -> None:
    readme = faulty.commit(REPO, "README.md", b"mine").tree["README.md"]
    first = {"type": "file", "oid": 40 * "0", "size": 0, "path": ".gitattributes"}
    body = json.dumps([] if fault == "[]" else [first])
    faulty.faults.answer("GET", "/tree/", status=200, body=body.encode(), times=UNLIMITED)
    assert "the Hub lists other files of user/labyrinth than it names" in refusal(folder)
    assert faulty.tree(REPO)["README.md"] == readme
    faulty.faults.clear()
    assert "holds files that no release of this kind wrote" in refusal(folder)


def test_a_list_of_hashes_that_came_wrong_is_fetched_again(
    empty: LocalHub, folder: Path, versions: list[Path], tmp_path: Path
) -> None:
    release(folder)
    newer = Path(shutil.copytree(versions[0], tmp_path / "newer"))
    write_card(newer, Release(REPO, "1.1.0"))
    empty.faults.damage("GET", f"/resolve/.*{Sums.FILE}", times=UNLIMITED)
    assert (
        refusal(newer, "1.1.0") == f"{REPO}: the Hub lists {Sums.FILE}, but gives another content"
    )
    assert held(empty) == hashes(folder)
    empty.faults.clear()
    release(newer, "1.1.0")
    assert held(empty, "1.1.0") == hashes(newer)


def test_a_tag_that_is_not_listed_yet_needs_no_other_version(empty: LocalHub, folder: Path) -> None:
    main = empty.refs(REPO)["refs/heads/main"]
    refs = {"tags": [], "converts": [], "branches": [_ref("main", main)]}
    body = json.dumps(refs).encode()
    empty.faults.answer("GET", "/refs$", status=200, body=body, times=UNLIMITED)
    told = f"{REPO}: the Hub does not list the tag 1.0.0 yet: publish again"
    assert refusal(folder).startswith(told)
    empty.faults.clear()
    release(folder)
    assert held(empty, "1.0.0") == hashes(folder)


def _ref(name: str, commit: str) -> Mapping[str, str]:
    return {"name": name, "ref": f"refs/heads/{name}", "targetCommit": commit}


@pytest.mark.parametrize("call", [("GET", "/tree/"), ("PUT", "/lfs/"), ("POST", "/preupload/")])
def test_a_call_that_the_client_retries_itself_is_retried_by_one_of_both(
    empty: LocalHub, folder: Path, call: tuple[str, str]
) -> None:
    rule = empty.faults.fail(*call, times=UNLIMITED)
    tries = len(client.WAITS) + 1
    told = rf"the Hub answers 503: .* \(tried {tries} times in \d+ s\)"
    assert re.fullmatch(told, refusal(folder))
    assert UNLIMITED - rule.times == tries
    empty.faults.clear()
    dropped = empty.faults.drop(*call, times=UNLIMITED)
    assert f"(tried {tries} times in" in refusal(folder)
    assert UNLIMITED - dropped.times == tries
    empty.faults.clear()
    release(folder)


def test_a_listing_that_never_ends_is_told_in_one_line(empty: LocalHub, folder: Path) -> None:
    release(folder)
    pages = f"{empty.url}/api/datasets/{REPO}/tree/main"
    [*entries] = HfApi().list_repo_tree(REPO, repo_type="dataset")
    files = [{"type": "file", "path": each.path, "oid": "0" * 40, "size": 1} for each in entries]
    body, link = json.dumps(files).encode(), {"Link": f'<{pages}>; rel="next"'}
    empty.faults.answer("GET", "/tree/", status=200, body=body, headers=link, times=UNLIMITED)
    told = refusal(folder, "1.1.0")
    assert told.startswith(f"{REPO}: the Hub lists {files[0]['path']} twice")


@pytest.mark.parametrize("oid", ["main", None, 7, "0" * 39, "0" * 40])
def test_a_commit_under_a_name_that_is_none_is_found_by_its_tree(
    empty: LocalHub, folder: Path, oid: object
) -> None:
    page = f"{empty.url}/datasets/{REPO}/commit/{oid}"
    if oid == "0" * 40:
        page = page.replace("http:", "httq:")  # The client takes it for an error of ours.
    body = json.dumps({"commitOid": oid, "commitUrl": page, "pullRequestUrl": None}).encode()
    empty.faults.answer(*COMMITTING, status=200, body=body, after=True)
    release(folder)
    assert held(empty, "1.0.0") == held(empty) == hashes(folder)


def test_another_commit_than_the_one_in_question_is_not_verified(
    empty: LocalHub, folder: Path
) -> None:
    first = empty.refs(REPO)["refs/heads/main"]
    info = {"id": REPO, "sha": first, "siblings": []}
    call = ("GET", "/revision/[0-9a-f]{40}$")
    empty.faults.answer(*call, status=200, body=json.dumps(info).encode(), times=UNLIMITED)
    assert "failed, so it is not tagged: user/labyrinth: the Hub does not describe" in refusal(
        folder
    )
    empty.faults.clear()
    refs = {"tags": [_ref("1.0.0", "main")], "converts": [], "branches": [_ref("main", first)]}
    body = json.dumps(refs).encode()
    empty.faults.answer("GET", "/refs$", status=200, body=body, times=UNLIMITED)
    assert refusal(folder).startswith(f"{REPO}: the Hub calls a commit 'main'")
    empty.faults.clear()
    release(folder)
    assert held(empty, "1.0.0") == hashes(folder)


MOMENTS: dict[str, tuple[str, str]] = {
    "before it is listed to be sent": ("GET", "/refs$"),
    "before the uploads": ("GET", "/revision/main$"),
    "before its own upload": ("POST", "/preupload/"),
    "while it is uploaded": ("PUT", "/lfs/"),
    "before the commit": COMMITTING,
    "before the verification": ("GET", "/revision/[0-9a-f]{40}$"),
    "before the tag": ("POST", "/tag/"),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_shard_that_changes_at_any_moment_is_released_as_listed_or_not_at_all(
    empty: LocalHub, folder: Path, moment: str
) -> None:
    right, shard = hashes(folder), folder / SHARD
    rule = empty.faults.hold(*MOMENTS[moment])
    content = bytearray(shard.read_bytes())
    content[len(content) // 2] ^= 1

    def change() -> None:
        rule.reached.wait(20)
        shard.write_bytes(content)
        rule.released.set()

    thread = threading.Thread(target=change)
    thread.start()
    error = ""
    try:
        release(folder)
    except DatasetError as refused:
        error = str(refused)
    finally:
        thread.join()
    told = f"{shard} has changed since it was checked: its sha256 is not the one in {Sums.FILE}"
    assert error.startswith(told) or not error
    assert held(empty) == ({} if error else right)
    assert ("refs/tags/1.0.0" in empty.refs(REPO)) == (not error)


def test_two_publishers_at_once_leave_one_release_and_a_line(
    empty: LocalHub, folder: Path, versions: list[Path], tmp_path: Path
) -> None:
    other = Path(shutil.copytree(versions[0], tmp_path / "other"))
    write_card(other, Release(REPO, "1.0.0"))
    rule = empty.faults.hold(*COMMITTING)
    told: list[str] = []
    thread = threading.Thread(target=lambda: told.append(refusal(folder)))
    thread.start()
    assert rule.reached.wait(20)
    release(other)
    rule.released.set()
    thread.join()
    assert told[0].startswith(f"{REPO} got another commit meanwhile, and nothing was changed")
    assert held(empty) == held(empty, "1.0.0") == hashes(other)


def test_a_manifest_that_was_edited_is_not_published(folder: Path) -> None:
    path = folder / "2x3" / Manifest.FILE
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace('"seed": 1', '"seed": 7'), encoding="utf-8")
    told = f"{path} has changed, though its shards have not: build the dataset again"
    with pytest.raises(DatasetError) as caught:
        write_card(folder, Release(REPO, "1.0.0"))
    assert str(caught.value).startswith(told)
    right = Manifest.read(folder / "2x3").fingerprint
    path.write_text(text.replace(right, "0" * 64), encoding="utf-8")
    with pytest.raises(DatasetError, match="its fingerprint is not that of its shards"):
        write_card(folder)
