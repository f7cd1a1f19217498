"""The real clients against the Hub on loopback, in each way of uploading."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from urllib.error import HTTPError

import pytest

from hub.client import CARD, REPO, killing, open_url, release, run
from hub.local_hub import SETTINGS, LocalHub
from hub.repositories import git_oid
from hub.state import MODES

pytestmark = pytest.mark.slow

each_mode = pytest.mark.parametrize("local_hub", MODES, indirect=True)


@each_mode
def test_what_is_released_comes_back_by_every_way_of_loading(local_hub: LocalHub) -> None:
    released = release(local_hub)
    local_hub.restart()
    loaded = run(
        local_hub,
        """
import datasets
revision = sys.argv[1]
file = hf_hub_download(R, "README.md", revision=revision, **D)
results["card"] = Path(file).read_text()
folder = Path(snapshot_download(R, revision=revision, **D))
results["hashes"] = {
    path: hashlib.sha256((folder / path).read_bytes()).hexdigest()
    for path in map(str, json.loads(sys.argv[2]))
}
for split in ("train", "test"):
    plain = datasets.load_dataset(R, "3x3", revision=revision, split=split)
    streamed = datasets.load_dataset(R, revision=revision, split=split, streaming=True)
    results[split] = [len(plain), plain.to_list() == list(streamed)]
""",
        released["oid"],
        json.dumps(list(released["hashes"])),
        token=None,
    )
    assert loaded == {
        "card": CARD,
        "hashes": released["hashes"],
        "train": [4000, True],
        "test": [2000, True],
    }
    downloads = local_hub.log.find("GET", origin="cdn")
    assert downloads
    assert {exchange.token for exchange in downloads} == {"none"}
    assert local_hub.log.find("GET", "xet-read-token") or local_hub.mode != "xet"


@pytest.mark.parametrize("local_hub", ["xet", "lfs-basic"], indirect=True)
def test_the_tree_tells_hashes_that_can_be_checked(local_hub: LocalHub) -> None:
    released = release(local_hub)
    tree = local_hub.tree(REPO, released["oid"])
    assert tree["README.md"].oid == git_oid(CARD.encode())
    assert not tree["README.md"].is_lfs
    assert {path: entry.sha256 for path, entry in tree.items() if entry.is_lfs} == released[
        "hashes"
    ]
    local_hub.faults.set_page_size(2)
    listed = run(
        local_hub,
        """
files = list(api.list_repo_tree(R, recursive=True, expand=True, **D))
results["lfs"] = {file.path: file.lfs.sha256 for file in files if getattr(file, "lfs", None)}
results["xet"] = [file.path for file in files if getattr(file, "xet_hash", None)]
results["changed"] = {file.path: file.last_commit.oid for file in files}
info = api.dataset_info(R, files_metadata=True)
results["siblings"] = {each.rfilename: each.lfs.sha256 for each in info.siblings if each.lfs}
results["split"] = info.card_data.configs[0]["data_files"][0]["split"]
paths = api.get_paths_info(R, ["README.md", "3x3", "missing"], **D)
results["paths"] = [path.path for path in paths]
""",
    )
    assert listed["lfs"] == listed["siblings"] == released["hashes"]
    assert set(listed["xet"]) == (set(released["hashes"]) if local_hub.mode == "xet" else set())
    assert listed["changed"][".gitattributes"] == released["base"]
    assert listed["changed"]["README.md"] == released["oid"]
    assert listed["split"] == "train"
    assert listed["paths"] == ["README.md", "3x3"]
    assert len(local_hub.log.find("GET", "/tree/main")) == 3


@each_mode
def test_only_changed_contents_are_sent_again(local_hub: LocalHub) -> None:
    first = release(local_hub)
    sent, stored = len(local_hub.log), local_hub.stored_bytes()
    again = release(local_hub)
    assert again["oid"] == first["oid"]
    assert not local_hub.log.uploaded(since=sent)
    assert local_hub.stored_bytes() == stored
    sent = len(local_hub.log)
    changed = release(local_hub, (1, 2, 4))
    assert changed["base"] == first["oid"] != changed["oid"]
    size = local_hub.tree(REPO)["3x3/test-00000-of-00001.parquet"].size
    received = sum(exchange.received for exchange in local_hub.log.uploaded(since=sent))
    if local_hub.mode == "xet":
        assert size <= local_hub.stored_bytes() - stored <= 1.1 * size
    else:
        assert received == size
    parts = len(local_hub.log.uploaded(since=sent))
    assert parts == (5 if local_hub.mode == "lfs-multipart" else received > 0)
    titles = [commit.title for commit in local_hub.history(REPO)]
    assert titles == ["Change", "Change", "initial commit"]


def test_branches_tags_and_proposals_are_refs(local_hub: LocalHub) -> None:
    results = run(
        local_hub,
        """
attempt("create", api.create_repo, R, private=True, **D)
attempt("create again", api.create_repo, R, **D)
results["exists"] = str(api.create_repo(R, exist_ok=True, **D))
first = commit(add("a.txt", b"a"), add("folder/b.txt", b"b"), add("folder/c.txt", b"c"))
api.create_tag(R, tag="1.0.0", revision=first, tag_message="The first", **D)
attempt("tag again", api.create_tag, R, tag="1.0.0", **D)
api.create_branch(R, branch="next/one", revision="1.0.0", **D)
attempt("branch again", api.create_branch, R, branch="next/one", **D)
commit(CommitOperationDelete("folder/"), CommitOperationDelete("a.txt"), revision="next/one")
attempt("missing", commit, CommitOperationDelete("missing.txt"))
attempt("revision", api.repo_info, R, revision="missing", **D)
attempt("entry", hf_hub_download, R, "missing.txt", **D)
results["next"] = api.list_repo_files(R, revision="next/one", **D)
proposal = api.create_commit(R, [add("d.txt", b"d")], commit_message="d", create_pr=True, **D)
results["proposal"] = [proposal.pr_revision, proposal.pr_num]
commit(add("e.txt", b"e"), revision="refs/pr/1")
results["proposed"] = api.list_repo_files(R, revision="refs/pr/1", **D)
refs = api.list_repo_refs(R, include_pull_requests=True, **D)
results["refs"] = {
    ref.ref: ref.target_commit for ref in refs.branches + refs.tags + refs.pull_requests
}
results["commits"] = [commit.title for commit in api.list_repo_commits(R, **D)]
results["url"] = str(api.upload_file(path_or_fileobj=b"f", path_in_repo="f.txt", repo_id=R, **D))
results["first"] = first
api.delete_tag(R, tag="1.0.0", **D)
api.delete_branch(R, branch="next/one", **D)
""",
    )
    conflict = ["HfHubHTTPError", 409]
    assert [results[f"{name} again"] for name in ("create", "tag", "branch")] == [conflict] * 3
    assert results["exists"] == f"{local_hub.url}/datasets/{REPO}"
    assert results["missing"] == ["RemoteEntryNotFoundError", 404]
    assert results["revision"] == ["RevisionNotFoundError", 404]
    assert results["entry"] == ["RemoteEntryNotFoundError", 404]
    assert results["next"] == [".gitattributes"]
    assert results["proposal"] == ["refs/pr/1", 1]
    assert {"d.txt", "e.txt", "folder/b.txt"} < set(results["proposed"])
    assert results["refs"]["refs/tags/1.0.0"] == results["first"]
    assert results["refs"].keys() == {
        "refs/heads/main",
        "refs/heads/next/one",
        "refs/tags/1.0.0",
        "refs/pr/1",
    }
    assert results["commits"] == ["Change", "initial commit"]
    assert local_hub.refs(REPO).keys() == {"refs/heads/main", "refs/pr/1"}
    assert local_hub.content(REPO, "f.txt") == b"f"


def test_a_dataset_joins_a_collection_once(local_hub: LocalHub) -> None:
    local_hub.create_repo(REPO)
    script = """
made = api.create_collection("Mazes & labyrinths", description="All", exists_ok=True)
attempt("again", api.create_collection, "Mazes & labyrinths")
api.add_collection_item(made.slug, R, "dataset", note="small", exists_ok=True)
attempt("twice", api.add_collection_item, made.slug, R, "dataset")
attempt("missing", api.add_collection_item, made.slug, "user/missing", "dataset")
found = list(api.list_collections(owner="user", item=f"datasets/{R}"))
results["found"] = [[each.title, each.items[0].item_id, each.items[0].note] for each in found]
results["slug"] = api.get_collection(found[0].slug).slug.rsplit("-", 1)[0]
"""
    for _ in range(2):
        results = run(local_hub, script)
        assert results["found"] == [["Mazes & labyrinths", REPO, "small"]]
        assert results["slug"] == "user/mazes-labyrinths"
        assert results["again"] == results["twice"] == ["HfHubHTTPError", 409]
        assert results["missing"] == ["HfHubHTTPError", 404]
        local_hub.restart()


def test_a_space_has_files_of_the_hub_and_a_card_with_colours(local_hub: LocalHub) -> None:
    results = run(
        local_hub,
        """
S = {"repo_type": "space"}
attempt("create", api.create_repo, R, space_sdk="static", **S)
results["files"] = api.list_repo_files(R, **S)
card = "---\\ntitle: A\\nsdk: static\\ncolorFrom: %s\\n---\\n"
for colour in ("green", "violet"):
    change = [add("README.md", (card % colour).encode()), add("page.html", b"page")]
    attempt(colour, api.create_commit, R, change, commit_message="Change", **S)
results["info"] = [api.space_info(R).sdk]
results["page"] = Path(hf_hub_download(R, "page.html", **S)).read_text()
""",
    )
    assert results["create"] == results["green"] == "done"
    assert results["violet"] == ["ValueError", None]
    assert results["files"] == [".gitattributes", "README.md", "index.html", "style.css"]
    assert results["info"] == ["static"]
    assert results["page"] == "page"


def test_a_card_that_the_hub_cannot_read_is_refused(local_hub: LocalHub) -> None:
    local_hub.create_repo(REPO)
    results = run(
        local_hub,
        """
def upload(metadata):
    card = f"---\\n{metadata}\\n---\\n# Card"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            commit(add("README.md", card.encode()))
        except ValueError as error:
            return str(error).splitlines()[-1]
    return [str(each.message).splitlines()[-1] for each in caught]
for name, card in json.loads(sys.argv[1]).items():
    results[name] = upload(card)
""",
        json.dumps(
            {
                "good": CARD.split("---")[1].strip(),
                "not YAML": "configs: [",
                "two defaults": "configs:\n- {config_name: a, default: true}\n"
                "- {config_name: b, default: true}",
                "split": "configs:\n- config_name: a\n  data_files: [{split: a-b, path: a}]",
                "counts": "dataset_info: {splits: [{name: train, num_examples: many}]}",
                "size": "size_categories: [huge]",
                "empty": "",
            }
        ),
    )
    assert results.pop("good") == []
    assert results.pop("empty") == ["- empty or missing yaml metadata in repo card"]
    for name, words in {
        "not YAML": "YAML Metadata Error",
        "two defaults": '"configs" must have at most one default',
        "split": "must match",
        "counts": "must be an array of objects with a name and counts",
        "size": "must be such as 10K<n<100K",
    }.items():
        assert words in results[name]


def test_ranges_are_answered_as_asked(local_hub: LocalHub) -> None:
    local_hub.create_repo(REPO)
    local_hub.commit(REPO, "digits.txt", b"0123456789")
    url = f"{local_hub.url}/datasets/{REPO}/resolve/main/digits.txt"
    assert open_url(url)[:2] == (200, b"0123456789")
    for wanted, content, span in [
        ("2-4", b"234", "2-4"),
        ("7-", b"789", "7-9"),
        ("-2", b"89", "8-9"),
        ("-20", b"0123456789", "0-9"),
        ("8-20", b"89", "8-9"),
    ]:
        status, body, headers = open_url(url, Range=f"bytes={wanted}")
        assert (status, body) == (206, content)
        assert headers["Content-Range"] == f"bytes {span}/10"
    with pytest.raises(HTTPError, match="416"):
        open_url(url, Range="bytes=10-")


def test_a_person_can_start_a_hub_and_stop_it(tmp_path: Path) -> None:
    script = Path(__file__).parents[2] / "scripts" / "local_hub"
    command = [sys.executable, script, "--folder", tmp_path / "hub", "--user", "ada"]
    with killing(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline() for _ in range(4)]
        exports = dict(line.split()[1].split("=") for line in lines if line.startswith("export"))
        assert exports.keys() == {"HF_ENDPOINT", "HF_TOKEN"}
        client = subprocess.run(
            [sys.executable, "-c", "from huggingface_hub import whoami; print(whoami()['name'])"],
            env={**os.environ, **SETTINGS, **exports, "HF_HOME": str(tmp_path / "home")},
            capture_output=True,
            text=True,
        )
        assert client.stdout == "ada\n", client.stderr
        process.send_signal(signal.SIGINT)
        written, _ = process.communicate(timeout=20)
    assert "200 GET    /api/whoami-v2 (write, 0 bytes)" in written
    assert written.endswith("# stopped\n")
    assert process.returncode == 0
