"""A scheduler with TLS takes the certificates of dask's configuration; one without it is warned about."""

import os
import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from small_surveys import run

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")
pytest.importorskip("cryptography")

pytestmark = pytest.mark.later

SURVEY = Path(__file__).resolve().parents[3] / "sample_data" / "quarry_part.ply"
PAGE = Path(__file__).resolve().parents[3] / "docs" / "pages" / "big-sites.md"


def map_line(tmp_path, *more):
    return ["map", SURVEY, "--local", "--out", tmp_path / "out", *more]


def certificates_of(security):
    """The certificates of a client in dask's own configuration."""
    client = {"key": security.tls_client_key, "cert": security.tls_client_cert}
    return {"distributed.comm.tls.ca-file": security.tls_ca_file, "distributed.comm.tls.client": client}


def test_a_scheduler_with_tls_takes_whom_its_authority_signed_and_nobody_else(tmp_path, monkeypatch):
    """The certificates are those of dask's own configuration."""
    monkeypatch.setattr("bumpymap.survey.engine.cluster._TIMEOUT_S", 5.0)
    security = distributed.Security.temporary()
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, security=security, dashboard_address=":0", memory_limit=0, silence_logs=50
    ) as cluster:
        address = cluster.scheduler_address
        nobody = run(*map_line(tmp_path, "--set", f"scheduler={address}"))
        with dask.config.set(certificates_of(distributed.Security.temporary())):
            stranger = run(*map_line(tmp_path, "--set", f"scheduler={address}"))
        with dask.config.set(certificates_of(security)):
            taken = run(*map_line(tmp_path, "--set", f"scheduler={address}"))
    for refused in (nobody, stranger):
        assert refused.exit_code == 2
        assert f"no scheduler answers at {address}" in refused.output
        assert "distributed.comm.tls" in refused.output
    assert taken.exit_code == 0, taken.output
    assert "Warning" not in taken.output
    assert (tmp_path / "out" / "rasters/class.tif").exists()


@pytest.mark.parametrize(
    ("address", "warned"),
    [
        ("tcp://192.0.2.1:8786", True),
        ("192.0.2.1:8786", True),
        ("tcp://127.0.0.1:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://[::1]:8786", False),
    ],
)
def test_a_scheduler_elsewhere_without_tls_is_warned_about(tmp_path, monkeypatch, address, warned):
    from bumpytiles import ClusterError

    def nobody(*_):
        raise ClusterError("nobody")

    monkeypatch.setattr("bumpytiles.workers_at", nobody)
    result = run(*map_line(tmp_path, "--set", f"scheduler={address}"))
    assert result.exit_code == 2
    assert ("Warning: " in result.output) is warned
    assert ("can run programs as the user" in result.output) is warned


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


def test_the_commands_of_the_page_work(tmp_path):
    """As a user follows them, in one folder and with addresses of this machine."""
    if shutil.which("openssl") is None:
        pytest.skip("needs the program openssl")
    making, starting, mapping = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "flights").mkdir()
    shutil.copy(SURVEY, tmp_path / "flights")
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    how = {"cwd": tmp_path, "env": os.environ | {"PATH": programs}, "shell": True}
    subprocess.run(making, check=True, capture_output=True, **how)
    port = free_port()
    scheduler, worker = starting.replace("10.0.0.1:8786", f"127.0.0.1:{port}").splitlines()
    line = mapping.replace("10.0.0.1:8786", f"127.0.0.1:{port}").strip()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    begun = [
        subprocess.Popen(f"exec python -m distributed.cli.dask_{command}", **how, **quiet)
        for command in (
            f"{scheduler.removeprefix('dask ')} --host 127.0.0.1 --port {port} --no-dashboard",
            f"{worker.removeprefix('dask ')} --no-dashboard",
        )
    ]
    try:
        done = subprocess.run(f"{line} --local", check=False, capture_output=True, text=True, **how)
    finally:
        for process in begun:
            process.terminate()
        for process in begun:
            process.wait()
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert (tmp_path / line.partition("--out ")[2].split()[0] / "rasters/class.tif").exists()
