"""Who may use the workers of ``--workers``, and how ``--scheduler tls://`` is told who may."""

import asyncio
import os
import re
import shutil
import socket
import ssl
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from click.testing import CliRunner

from bumpymap.cli import main

distributed = pytest.importorskip("distributed")
pytest.importorskip("cryptography")

pytestmark = pytest.mark.slow

SURVEY = Path(__file__).resolve().parents[3] / "sample_data" / "quarry_part.ply"
PAGE = Path(__file__).resolve().parents[3] / "docs" / "pages" / "cluster.md"


def run(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


def map_line(tmp_path, *more):
    return ["map", SURVEY, "--local", "--out", tmp_path / "out", *more]


@pytest.fixture(scope="module")
def workers():
    from bumpytiles import local_workers

    with local_workers(1, {}) as found:
        yield found


@pytest.fixture(scope="module")
def addresses(workers):
    """Of everything that listens: the scheduler, a worker, and the process that watches over it."""
    told = workers.client.scheduler_info()
    ((address, worker),) = told["workers"].items()
    return {"scheduler": told["address"], "worker": address, "nanny": worker["nanny"]}


def ask(address, arguments):
    """What comes back to whoever asks with these arguments of a connection."""

    async def identity():
        async with distributed.rpc(address, connection_args=arguments, timeout=3) as far:
            return await far.identity()

    return asyncio.run(identity())


def stranger(kind, address):
    """Address and arguments of a connection of somebody who is not the user."""
    if kind == "plain":
        return address.replace("tls://", "tcp://"), {}
    if kind == "certificate of another CA":
        return address, distributed.Security.temporary().get_connection_args("client")
    anything = ssl.create_default_context()
    anything.check_hostname, anything.verify_mode = False, ssl.CERT_NONE
    return address, {"ssl_context": anything, "require_encryption": True}


@pytest.mark.parametrize("kind", ["plain", "certificate of another CA", "no certificate"])
@pytest.mark.parametrize("place", ["scheduler", "worker", "nanny"])
def test_a_stranger_is_refused(addresses, place, kind):
    with pytest.raises(OSError):
        ask(*stranger(kind, addresses[place]))


@pytest.mark.parametrize("place", ["scheduler", "worker", "nanny"])
def test_the_user_is_not(workers, addresses, place):
    answer = ask(addresses[place], workers.client.security.get_connection_args("client"))
    assert place in answer["type"].lower()


def test_a_stranger_cannot_have_code_run(addresses):
    plain = addresses["scheduler"].replace("tls://", "tcp://")
    for address, security in ((plain, None), (addresses["scheduler"], distributed.Security.temporary())):
        with pytest.raises(OSError):
            distributed.Client(address, security=security, timeout=3, set_as_default=False)


def listening():
    """Addresses where this process and its children wait for connections."""
    import psutil

    here = psutil.Process()
    found = [line for one in [here, *here.children(recursive=True)] for line in one.net_connections("tcp")]
    return {tuple(line.laddr) for line in found if line.status == psutil.CONN_LISTEN}


def test_nothing_is_shown_to_a_browser_and_nothing_listens_beyond_this_machine(addresses):
    places = listening()
    assert len(places) >= len(addresses)
    assert {host for host, _ in places} == {"127.0.0.1"}
    for host, port in places:
        for page in ("", "/status", "/info/main/workers.html", "/metrics", "/json/counts.json"):
            with pytest.raises(OSError):
                urllib.request.urlopen(f"http://{host}:{port}{page}", timeout=3)


def test_keys_are_in_no_file_argument_or_variable(workers):
    import psutil

    key = workers.client.security.tls_worker_key
    assert "PRIVATE KEY" in key
    secret = key.splitlines()[1]
    for process in psutil.Process().children(recursive=True):
        assert secret not in " ".join(process.cmdline())
        assert secret not in " ".join(process.environ().values())
    folder = Path(workers.client.run(lambda dask_worker: dask_worker.local_directory).popitem()[1])
    while folder.parent != folder and "bumpytiles-workers-" in str(folder):
        assert folder.stat().st_mode & 0o077 == 0 or "bumpytiles-workers-" not in folder.name
        folder = folder.parent


def write_certificates(folder, security):
    """Files of a client, and the file that names them."""
    folder.mkdir()
    for name, text in (
        ("ca", security.tls_ca_file), ("cert", security.tls_client_cert), ("key", security.tls_client_key)
    ):  # fmt: skip
        (folder / f"{name}.pem").write_text(text)
    (folder / "tls.toml").write_text('ca = "ca.pem"\ncert = "cert.pem"\nkey = "key.pem"\n')
    return folder


@pytest.fixture
def certificates(tmp_path):
    return write_certificates(tmp_path / "certificates", distributed.Security.temporary())


def test_a_scheduler_with_tls_takes_whom_its_authority_signed_and_nobody_else(tmp_path, monkeypatch):
    monkeypatch.setattr("bumpymap.survey.engine.pool.TIMEOUT_S", 5.0)
    security = distributed.Security.temporary()
    ours = write_certificates(tmp_path / "ours", security) / "tls.toml"
    others = write_certificates(tmp_path / "others", distributed.Security.temporary()) / "tls.toml"
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, security=security, dashboard_address=":0", memory_limit=0, silence_logs=50
    ) as cluster:
        address = cluster.scheduler_address
        refused = run(*map_line(tmp_path, "--scheduler", address, "--tls-config", others))
        taken = run(*map_line(tmp_path, "--scheduler", address, "--tls-config", ours))
    assert refused.exit_code == 2
    assert f"no scheduler answers at {address}" in refused.output
    assert "a certificate that the authority in" in refused.output
    assert taken.exit_code == 0, taken.output
    assert "Warning" not in taken.output
    assert (tmp_path / "out" / "class.tif").exists()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda folder: (folder / "tls.toml").unlink(), "cannot read settings from"),
        (lambda folder: (folder / "tls.toml").write_text('ca = "ca.pem"'), "does not name cert, key"),
        (lambda folder: (folder / "tls.toml").write_text("password = 1"), "unknown setting password; there are: ca"),
        (lambda folder: (folder / "tls.toml").write_text("ca = 1"), "ca is 1; it must be a string"),
        (lambda folder: (folder / "key.pem").unlink(), "key.pem cannot be read: No such file"),
        (lambda folder: ((folder / "cert.pem").unlink(), (folder / "cert.pem").mkdir()), "cert.pem cannot be read"),
        (lambda folder: (folder / "ca.pem").write_text("-"), "ca.pem holds no certificate in PEM format"),
        (lambda folder: (folder / "cert.pem").write_text("-"), "do not work together"),
        (lambda folder: (folder / "key.pem").write_text("-"), "do not work together"),
        (
            lambda folder: (folder / "key.pem").write_text(distributed.Security.temporary().tls_client_key),
            "do not work together (key values mismatch)",
        ),
    ],
)  # fmt: skip
def test_certificates_that_cannot_be_used_are_named(tmp_path, certificates, spoil, message):
    spoil(certificates)
    line = map_line(tmp_path, "--scheduler", "tls://127.0.0.1:9", "--tls-config", certificates / "tls.toml")
    result = run(*line)
    assert result.exit_code == 2, result.output
    assert message in result.output
    assert f"\n{result.output}".count("\nError: ") == 1
    assert not (tmp_path / "out").exists()


def test_a_key_with_a_passphrase_is_refused_without_a_question(tmp_path, certificates):
    from cryptography.hazmat.primitives import serialization

    key = serialization.load_pem_private_key((certificates / "key.pem").read_bytes(), None)
    (certificates / "key.pem").write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.BestAvailableEncryption(b"word"),
        )
    )
    line = map_line(tmp_path, "--scheduler", "tls://127.0.0.1:9", "--tls-config", certificates / "tls.toml")
    result = run(*line)
    assert result.exit_code == 2
    assert "the key without a passphrase" in result.output


@pytest.mark.parametrize(
    ("address", "warned"),
    [
        ("tcp://192.0.2.1:8786", True),
        ("192.0.2.1:8786", True),
        ("ws://cluster.example:80", True),
        ("tcp://[2001:db8::1]:8786", True),
        ("tcp://127.0.0.1:8786", False),
        ("127.0.0.1:8786", False),
        ("tcp://localhost:8786", False),
        ("tcp://[::1]:8786", False),
    ],
)
def test_a_scheduler_elsewhere_without_tls_is_warned_about(tmp_path, monkeypatch, address, warned):
    from bumpytiles import ClusterError

    def nobody(*_):
        raise ClusterError("nobody")

    monkeypatch.setattr("bumpytiles.workers_at", nobody)
    result = run(*map_line(tmp_path, "--scheduler", address))
    assert result.exit_code == 2
    assert ("Warning: " in result.output) is warned
    assert ("can run programs as the user" in result.output) is warned


def test_without_cryptography_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography", None)
    result = run(*map_line(tmp_path, "--workers", 1))
    assert result.exit_code == 2
    assert "pip install 'bumpymap[dask]'" in result.output


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


def test_the_commands_of_the_page_work(tmp_path):
    """As a user follows them, in one folder and with addresses of this machine."""
    if shutil.which("openssl") is None:
        pytest.skip("needs the program openssl")
    making, starting, mapping = re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (settings,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "tls.toml").write_text(settings)
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
    assert (tmp_path / line.partition("--out ")[2].split()[0] / "class.tif").exists()
