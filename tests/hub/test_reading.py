"""Reading from a Hub that answers wrongly: the right data, or one line, and never others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from huggingface_hub import HfApi, constants
from support.publishing import REPO

from hub.conftest import CONFIG, put
from hub.faults import UNLIMITED
from hub.local_hub import LocalHub
from labyrinth_core import hub as client
from labyrinth_core import load_transitions, stream_episodes
from labyrinth_core.data import Manifest
from labyrinth_core.data.rows import rows_together
from labyrinth_core.errors import DatasetError
from labyrinth_core.policies import files_of
from labyrinth_core.policies.load import located

MODEL = "user/planner"
SHARD = "train-00000-of-00001.parquet"
ASKING = ("GET", "/revision/main$")


def values(source: str | Path, **options: Any) -> list[int]:
    """Return the observations and actions of a dataset's transitions."""
    options = {"observation": "vector", "cache_dir": False} | options
    found = load_transitions(source, CONFIG, **options)
    return [*found.frames.ravel().tolist(), *found.actions.tolist()]


def refusal(*arguments: Any, **options: Any) -> str:
    """Return why a dataset cannot be loaded, in one line."""
    with pytest.raises(DatasetError) as caught:
        values(*arguments, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("status", [401, 403, 404, 412, 500, 503])
def test_an_older_release_is_read_in_silence_offline_alone(
    faulty: LocalHub, versions: list[Path], monkeypatch: pytest.MonkeyPatch, status: int
) -> None:
    old, new = map(values, versions)
    assert values(REPO) == old
    read = faulty.refs(REPO)["refs/heads/main"]
    put(faulty, versions[1])
    faulty.faults.fail(*ASKING, status=status, times=UNLIMITED)
    told = refusal(REPO)
    assert told.startswith(f"{REPO}: the Hub answers {status}: ")
    assert told.endswith(
        f"; to read {read[:12]}, the newest commit of main that this machine has read, set "
        "HF_HUB_OFFLINE=1"
    )
    assert values(REPO, revision=read) == old
    with monkeypatch.context() as offline:
        offline.setattr(constants, "HF_HUB_OFFLINE", True)
        assert values(REPO) == old
    faulty.faults.clear()
    assert values(REPO) == new


@pytest.mark.parametrize("labyrinths", [None, 2])
def test_a_release_that_arrives_during_a_load_is_not_mixed_with_the_one_before(
    faulty: LocalHub, versions: list[Path], labyrinths: int | None
) -> None:
    def release(_: Any) -> None:
        if faulty.log.find("HEAD", Manifest.FILE):
            faulty.log.on_exchange = None
            put(faulty, versions[1])

    faulty.log.on_exchange = release
    old, new = (values(folder, labyrinths=labyrinths) for folder in versions)
    assert values(REPO, labyrinths=labyrinths) == old
    assert values(REPO, labyrinths=labyrinths) == new


@pytest.mark.parametrize("name", [Manifest.FILE, Manifest.TABLE, SHARD])
def test_a_damaged_download_is_mended_before_anyone_hears_of_it(
    faulty: LocalHub, versions: list[Path], name: str
) -> None:
    right = values(versions[0], labyrinths=2)
    faulty.faults.damage("GET", f"/resolve/.*{name}", times=UNLIMITED)
    assert f"{name} is damaged: " in refusal(REPO, labyrinths=2)
    faulty.faults.clear()
    assert values(REPO, labyrinths=2) == right
    [link] = Path(constants.HF_HUB_CACHE).glob(f"*/snapshots/*/{CONFIG}/{name}")
    content = bytearray(link.read_bytes())
    content[len(content) // 2] ^= 1
    link.resolve().write_bytes(content)
    faulty.faults.fail("GET", f"/resolve/.*{name}", status=500)
    assert values(REPO, labyrinths=2) == right


def test_errors_that_pass_are_got_over_and_others_told_in_one_line(
    faulty: LocalHub, versions: list[Path]
) -> None:
    right = values(versions[0])
    for status, method in ((500, "GET"), (503, "GET"), (429, "HEAD")):
        faulty.faults.fail(method, f"/resolve/.*{SHARD}", status=status)
    faulty.faults.answer(*ASKING, status=200, body=b"<html>")
    faulty.faults.cut("GET", Manifest.FILE)
    assert values(REPO) == right
    for body in (b"<html>Log in", b"{}", b"null", b"[]"):
        faulty.faults.clear()
        for asked in (REPO, "user/other"):
            call = ("GET", f"{asked}/revision/main$")
            faulty.faults.answer(*call, status=200, body=body, times=UNLIMITED)
            assert f"what answers at {faulty.url} is not a Hub: " in refusal(asked)


def test_a_wrong_revision_is_told_even_if_the_hub_does_not_say_which_there_are(
    faulty: LocalHub,
) -> None:
    for body in (b"{}", b"null", b"<html>"):
        faulty.faults.clear()
        faulty.faults.answer("GET", "/refs$", status=200, body=body, times=UNLIMITED)
        assert refusal(REPO, revision="2.0.0") == f"{REPO} has no revision 2.0.0"
    faulty.faults.clear()
    assert refusal(REPO, revision="2.0.0") == f"{REPO} has no revision 2.0.0, it has main"


def test_how_long_an_answer_asks_to_wait_is_waited_unless_it_is_long(
    faulty: LocalHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[float] = []
    monkeypatch.setattr(client.time, "sleep", waited.append)
    faulty.faults.fail(*ASKING, status=429, headers={"Retry-After": "7"})
    assert values(REPO)
    assert waited == [7.0]
    faulty.faults.fail(*ASKING, status=429, headers={"Retry-After": "3600"}, times=UNLIMITED)
    assert "the Hub answers 429" in refusal(REPO)
    assert waited == [7.0]


def test_an_address_of_the_hub_ends_in_one_line_too(faulty: LocalHub) -> None:
    faulty.faults.fail("GET|HEAD|POST", "", times=UNLIMITED)
    assert refusal(f"hf://datasets/{REPO}").startswith(f"hf://datasets/{REPO} cannot be read: ")
    with pytest.raises(DatasetError):
        next(iter(stream_episodes(REPO, CONFIG)))


def test_rows_that_are_lost_in_a_damaged_page_are_missed(versions: list[Path]) -> None:
    manifest = Manifest.read(versions[0] / CONFIG)
    shard = versions[0] / CONFIG / manifest.of("train")[0].path

    class Lossy:
        """A file of which Arrow loses the last row, as if a damaged page had fewer."""

        def __init__(self) -> None:
            self._file = pq.ParquetFile(shard)
            self.metadata = self._file.metadata

        def iter_batches(self, *how: Any) -> Iterator[Any]:
            for batch in self._file.iter_batches(*how):
                yield batch.slice(0, len(batch) - 1)

    rows = manifest.of("train")[0].rows
    told = f"there is damaged: it has {rows - 1} rows where there should be {rows}"
    lossy: Any = Lossy()
    with pytest.raises(DatasetError, match=told):
        list(rows_together(lossy, [0], "there", pictures=True))


@pytest.mark.parametrize("listed", [True, False])
def test_weights_are_those_that_the_hub_and_its_list_name(faulty: LocalHub, listed: bool) -> None:
    faulty.create_repo(MODEL, kind="model")
    files = {"config.json": b"{}", "model.safetensors": b"weights"}
    if listed:
        lines = (f"{client.hashlib.sha256(each).hexdigest()}  {n}\n" for n, each in files.items())
        files["SHA256SUMS"] = "".join(lines).encode()
    for name, content in files.items():
        faulty.commit(MODEL, name, content, kind="model")
    faulty.faults.damage("GET", "/resolve/.*safetensors")
    folder = located(MODEL, None)
    assert (folder / "model.safetensors").read_bytes() == b"weights"
    faulty.commit(MODEL, "model.safetensors", b"heights", kind="model")
    for source in (MODEL, folder):
        if source == folder:
            (folder / "model.safetensors").unlink()
            (folder / "model.safetensors").write_bytes(b"heights")
        if listed:
            with pytest.raises(DatasetError, match=r"damaged: its sha256 is not the one in SHA256"):
                located(source, None)
        else:
            assert (located(source, None) / "model.safetensors").read_bytes() == b"heights"
    faulty.faults.fail("HEAD", "/resolve/.*SHA256SUMS", status=403)
    faulty.commit(MODEL, kind="model")
    with pytest.raises(DatasetError, match="the Hub answers 403"):
        located(MODEL, None)


def test_a_policy_is_never_an_older_release_in_silence(
    faulty: LocalHub, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    faulty.create_repo(MODEL, kind="model")
    with pytest.raises(DatasetError, match=f"{MODEL} holds no policy: give model.safetensors and"):
        files_of(MODEL)
    faulty.commit(MODEL, "model.onnx", b"old", kind="model")
    found = files_of(MODEL)
    assert found.paths["model.onnx"].read_bytes() == b"old"
    assert found.commit == faulty.refs(MODEL, "model")["refs/heads/main"]
    faulty.commit(MODEL, "model.onnx", b"new", kind="model")
    for answer in ({"status": 503}, {"status": 401}, {"status": 200, "body": b"{}"}):
        faulty.faults.answer(*ASKING, times=UNLIMITED, **answer)
        with pytest.raises(DatasetError, match=r"to read \w+, the newest commit of main that this"):
            files_of(MODEL)
        faulty.faults.clear()
    with monkeypatch.context() as offline:
        offline.setattr(constants, "HF_HUB_OFFLINE", True)
        assert files_of(MODEL) == found
        blob = found.paths["model.onnx"].resolve()
        blob.write_bytes(b"odd")
        with pytest.raises(DatasetError, match="is damaged: its content has not the hash that"):
            files_of(MODEL)
        blob.write_bytes(b"old")
    assert files_of(MODEL).paths["model.onnx"].read_bytes() == b"new"
    assert files_of(f"{MODEL}@{found.commit}") == found
    (tmp_path / MODEL).mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert files_of(MODEL, found.commit, on_hub=True) == found


def test_calls_of_others_are_retried_by_the_client_still(faulty: LocalHub) -> None:
    assert values(REPO)
    faulty.faults.fail("GET", "/tree/")
    assert [*HfApi().list_repo_tree(REPO, repo_type="dataset")]
