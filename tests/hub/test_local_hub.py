"""The Hub on loopback as a person starts it to rehearse a release; releases test the rest."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path
from urllib.error import HTTPError

import pytest
from support.quick_python import python

from hub.local_hub import SETTINGS

pytestmark = pytest.mark.slow


def test_a_person_can_start_a_hub_make_it_fail_stop_it_and_start_it_again(tmp_path: Path) -> None:
    script = Path(__file__).parents[2] / "scripts" / "local_hub"
    command = [sys.executable, script, "--folder", tmp_path / "hub", "--user", "ada"]
    client = """
from huggingface_hub import HfApi
api = HfApi()
print(api.create_repo("ada/mazes", repo_type="dataset", exist_ok=True).repo_id)
print(api.whoami()["name"])
"""
    for time in range(2):
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            try:
                assert process.stdout is not None
                lines = [process.stdout.readline() for _ in range(5)]
                exports = dict(line.split()[1].split("=") for line in lines if "export" in line)
                assert exports.keys() == {"HF_ENDPOINT", "HF_TOKEN", "HF_HUB_DISABLE_XET"}
                control = f"{exports['HF_ENDPOINT']}/__control__"
                fault = b'{"fail": {"method": "GET", "path": "/whoami"}}'
                assert urllib.request.urlopen(control, fault, timeout=10).status == 200
                with pytest.raises(HTTPError, match="400"):
                    urllib.request.urlopen(control, b'{"explode": {}}', timeout=10)
                done = subprocess.run(
                    [python(), "-c", client],
                    env={**os.environ, **SETTINGS, **exports, "HF_HOME": str(tmp_path / "home")},
                    capture_output=True,
                    text=True,
                    check=False,
                )
                assert done.stdout == "ada/mazes\n"
                assert "the Hub answers 503 on demand" in done.stderr
                process.send_signal(signal.SIGINT)
                written, _ = process.communicate(timeout=20)
            finally:
                process.kill()
        assert f"{409 if time else 200} POST   /api/repos/create (write)" in written
        assert "503 GET    /api/whoami-v2 (write)" in written
        assert written.endswith("# stopped\n")
        assert process.returncode == 0
