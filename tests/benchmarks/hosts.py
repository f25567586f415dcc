"""Run a cluster of two hosts, lose one in the middle of a run, and compare the layers with those of one process.

python tests/benchmarks/hosts.py SURVEY... --data FOLDER [--saved 1] [--moto FOLDER] [--map-options "--ground all"]

The hosts are network namespaces of this machine, joined by a link, with mount namespaces in which /tmp is private,
except for one folder that both share, that of `--out`, and for checkout and environment if they lie in /tmp. The
first host has the scheduler, the client, a worker and an S3 server; the second has two workers. All connections between
them use TLS, those to the S3 server HTTP. The surveys are read from the S3 server; without moto (pip install
"moto[server]", or --moto FOLDER after pip install --target FOLDER), from a folder that both hosts see.

When the second host is at work and --saved results are saved, its link is taken down and its processes are killed.
Needs root, ip, unshare, nsenter and openssl. The exit code is 1 if the run fails or any layer differs. Whatever the
script starts (processes, namespaces, mounts) is gone at its end.
"""

import argparse
import hashlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

FIRST, SECOND = "10.211.7.1", "10.211.7.2"
"""Addresses of the hosts, valid only in their namespaces."""
_SCHEDULER, _S3 = f"tls://{FIRST}:8786", f"http://{FIRST}:5000"
_SHARED, _SURVEYS, _TLS, _MOTO = "/tmp/shared", "/tmp/surveys", "/tmp/tls", "/tmp/moto"  # noqa: S108 (private to the hosts)
_CLIENT = {
    "DASK_DISTRIBUTED__COMM__TLS__CA_FILE": f"{_TLS}/ca.pem",
    "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT": f"{_TLS}/cert.pem",
    "DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY": f"{_TLS}/key.pem",
}
"""Dask's own configuration of a client with TLS."""
_MOST_REQUESTS = 5_000
"""Requests to the S3 server that a run may need."""
_NOTICED_S = 12
"""After so many seconds without an answer the scheduler gives up a worker."""
_WAIT_S = 60.0
_MADE_CERTIFICATES = """
openssl req -x509 -newkey rsa:2048 -noenc -days 2 -subj "/CN=test cluster" -keyout ca-key.pem -out ca.pem
openssl req -newkey rsa:2048 -noenc -subj "/CN=dask" -keyout key.pem -out request.pem
openssl x509 -req -in request.pem -CA ca.pem -CAkey ca-key.pem -CAcreateserial -days 2 -out cert.pem
"""
_NEW_HOST = """
set -e
mount -t tmpfs tmpfs {stage}
mkdir {stage}/shared {stage}/surveys {stage}/tls {stage}/moto
mount --bind {data}/shared {stage}/shared
if [ -n "{surveys}" ]; then mount --bind {surveys} {stage}/surveys; fi
if [ -n "{moto}" ]; then mount --bind {moto} {stage}/moto; fi
{code}
cp {data}/tls/*.pem {stage}/tls
mount --move {stage} /tmp
echo ready
exec sleep infinity
"""


class Host:
    """A network and a mount namespace, and the processes in them."""

    def __init__(self, name: str, data: Path, surveys: Path | None, moto: str) -> None:
        self.name = name
        stage = data / name
        stage.mkdir()
        roots = {Path(__file__).resolve().parents[2], Path(sys.prefix), Path(sys.base_prefix)}
        shared = [(one, stage / one.relative_to("/tmp")) for one in sorted(roots) if one.is_relative_to("/tmp")]  # noqa: S108
        code = "\n".join(f"mkdir -p {there}; mount --bind {one} {there}" for one, there in shared)
        script = _NEW_HOST.format(stage=stage, data=data, surveys=surveys or "", moto=moto, code=code)
        self._holder = subprocess.Popen(
            ["ip", "netns", "exec", name, "unshare", "--mount", "--propagation", "private", "sh", "-c", script],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._holder.stdout is not None
        if self._holder.stdout.readline() != "ready\n":
            raise SystemExit(f"the mounts of {name} failed")

    def command(self, arguments: Sequence[str]) -> list[str]:
        """Return the command that runs another one on this host."""
        return ["nsenter", "--target", str(self._holder.pid), "--mount", "--net", "--wdns=/tmp", *arguments]

    def start(self, arguments: Sequence[str], log: Path, **environment: str) -> "subprocess.Popen[bytes]":
        """Start a process on this host."""
        with log.open("ab") as stream:
            return subprocess.Popen(
                self.command(arguments), stdin=subprocess.DEVNULL, stdout=stream, stderr=stream,
                env=_environment() | environment,
            )  # fmt: skip

    def pids(self) -> list[int]:
        """Return the processes on this host."""
        found = subprocess.run(["ip", "netns", "pids", self.name], capture_output=True, text=True, check=True)
        return [int(pid) for pid in found.stdout.split()]

    def kill(self) -> None:
        """Kill every process on this host, and with the last of them its mounts."""
        for pid in self.pids():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._holder.wait()


def _environment() -> dict[str, str]:
    return os.environ | {
        "AWS_ENDPOINT_URL": _S3,
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_EC2_METADATA_DISABLED": "true",
        "DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": f"{_NOTICED_S}s",
        "RAYON_NUM_THREADS": "1",
    }


def _ip(arguments: str) -> None:
    subprocess.run(["ip", *arguments.split()], check=True)


def _network(stack: ExitStack) -> tuple[str, str]:
    """Make two network namespaces and a link between them."""
    names = (f"bumpy-{os.getpid()}-a", f"bumpy-{os.getpid()}-b")
    for name in names:
        _ip(f"netns add {name}")
        stack.callback(_ip, f"netns del {name}")
    _ip(f"-n {names[0]} link add link0 type veth peer name link0 netns {names[1]}")
    for name, address in zip(names, (FIRST, SECOND), strict=True):
        _ip(f"-n {name} address add {address}/24 dev link0")
        _ip(f"-n {name} link set link0 up")
        _ip(f"-n {name} link set lo up")
    return names


def serve(folder: Path) -> None:
    """Serve the files of a folder as bucket ``surveys`` until this process is killed. Runs on the first host."""
    import boto3  # type: ignore[import-not-found, unused-ignore]
    from moto.server import ThreadedMotoServer  # type: ignore[import-not-found, unused-ignore]

    server = ThreadedMotoServer(ip_address=FIRST, port=5000)
    server.start()
    client = boto3.client("s3")
    client.create_bucket(Bucket="surveys")
    for path in sorted(folder.iterdir()):
        client.upload_file(str(path), "surveys", path.name)
    print("served", flush=True)
    signal.pause()


def _wait(what: str, done: Callable[[], bool], process: "subprocess.Popen[bytes] | None" = None) -> None:
    end = time.monotonic() + _WAIT_S
    while not done():
        if process is not None and process.poll() is not None:
            raise SystemExit(f"{what}: the process ended with exit code {process.returncode}")
        if time.monotonic() > end:
            raise SystemExit(f"{what}: not within {_WAIT_S:g} s")
        time.sleep(0.02)


def _digests(folder: Path) -> dict[str, str]:
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.iterdir())
        if path.is_file() and path.name != "run.json" and not path.name.startswith(".")
    }


def _start_cluster(first: Host, second: Host, log: Path) -> None:
    """Start a scheduler and three workers, and wait until they are connected."""
    module = [sys.executable, "-m"]
    tls = [f"--tls-ca-file={_TLS}/ca.pem", f"--tls-cert={_TLS}/cert.pem", f"--tls-key={_TLS}/key.pem", "--no-dashboard"]
    scheduler = [*module, "distributed.cli.dask_scheduler", "--host", FIRST, "--protocol", "tls", *tls]
    first.start(scheduler, log / "scheduler")
    worker = [*module, "distributed.cli.dask_worker", _SCHEDULER, "--nthreads", "1", "--memory-limit", "0", *tls]
    worker += ["--local-directory", "/tmp"]  # noqa: S108 (private to the host)
    for host, address in ((first, FIRST), (second, SECOND), (second, SECOND)):
        host.start([*worker, "--host", address], log / f"workers-{address}")
    _wait("the workers", lambda: (log / "scheduler").read_bytes().count(b"Register worker") == 3)


def run_hosts(surveys: Sequence[Path], data: Path, moto: str | None, saved: int, options: Sequence[str]) -> bool:
    """Do what the script does; return whether the layers are the same."""
    bumpymap = str(Path(sys.executable).with_name("bumpymap"))
    for folder in ("shared", "tls", "files", "log"):
        (data / folder).mkdir(parents=True)
    subprocess.run(["sh", "-ec", _MADE_CERTIFICATES], cwd=data / "tls", check=True, capture_output=True)
    for path in surveys:
        shutil.copy(path, data / "files")
    place = _SURVEYS if moto is None else "s3://surveys"
    inputs = [f"{place}/{path.name}" for path in surveys]
    log = data / "log"
    with ExitStack() as stack:
        hosts = []
        for number, name in enumerate(_network(stack)):
            hosts.append(Host(name, data, data / "files" if moto is None or number == 0 else None, moto or ""))
            stack.callback(hosts[-1].kill)
        first, second = hosts
        if moto is not None:
            server = first.start([sys.executable, __file__, "--serve", _SURVEYS], log / "s3", PYTHONPATH=_MOTO)
            _wait("the S3 server", lambda: b"served" in (log / "s3").read_bytes(), server)
        alone = first.start([bumpymap, "map", *inputs, "--out", f"{_SHARED}/one", *options], log / "one")
        if alone.wait() != 0:
            raise SystemExit(f"the run of one process failed: {(log / 'one').read_text()}")
        _start_cluster(first, second, log)
        idle = len(second.pids())
        started = time.monotonic()
        command = [bumpymap, "map", *inputs, "--out", f"{_SHARED}/two", "--set", f"scheduler={_SCHEDULER}"]
        client = first.start([*command, *options], log / "two", **_CLIENT)
        records = data / "shared" / "two" / ".bumpymap-run" / "points"
        at_work = lambda: len(list(records.glob("read-*.json"))) >= saved and len(second.pids()) > idle  # noqa: E731
        _wait("the second host to be at work", at_work, client)
        lost = time.monotonic()
        count = len(second.pids()) - 1
        print(f"lost: the second host, {lost - started:.1f} s after the start, {count} processes")
        print(f"      {len(list(records.glob('read-*.json')))} results were saved")
        _ip(f"-n {second.name} link set link0 down")
        second.kill()
        code = client.wait()
        print(f"end:  {time.monotonic() - lost:.1f} s later, exit code {code}")
        print((log / "two").read_text().strip())
        requests = (log / "s3").read_bytes().count(b" HTTP/1.1") if moto is not None else 0
        print(f"S3:   {requests} requests" if moto is not None else "S3:   not used")
        one, two = (_digests(data / "shared" / name) for name in ("one", "two"))
        differ = [name for name in one if one[name] != two.get(name)]
        left = [path.name for path in (data / "shared" / "two").glob(".bumpymap-run*")] if not code else []
        print(f"layers: {len(one)} files, {'the same' if not differ else 'other bytes in ' + ', '.join(differ)}")
        if left:
            print(f"left behind: {', '.join(left)}")
        return (
            code == 0
            and bool(one)
            and one.keys() == two.keys()
            and not differ
            and not left
            and (requests <= _MOST_REQUESTS)
        )


def main() -> None:
    """Parse the arguments and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surveys", nargs="*", type=Path)
    parser.add_argument("--data", type=Path, help="folder for what the run makes; a new folder in it is deleted after")
    parser.add_argument("--saved", type=int, default=1, help="results that are saved before the host is lost")
    parser.add_argument("--moto", help="folder in which moto is installed; without it, this environment's, if any")
    parser.add_argument("--no-s3", action="store_true", help="read from a folder that both hosts see")
    parser.add_argument("--map-options", default="", help="more options of bumpymap map")
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        return serve(given.serve)
    if not given.surveys or given.data is None:
        parser.error("surveys and --data are needed")
    moto = None
    if not given.no_s3:
        moto = str(Path(given.moto).resolve()) if given.moto else os.environ.get("PYTHONPATH", "")
    data = given.data.resolve() / f"hosts-{os.getpid()}"
    try:
        same = run_hosts(
            [path.resolve() for path in given.surveys], data, moto, given.saved, shlex.split(given.map_options)
        )
    except SystemExit:
        for path in sorted((data / "log").iterdir()):
            print(f"--- {path.name}", path.read_text()[-2000:], sep="\n", file=sys.stderr)
        raise
    finally:
        shutil.rmtree(data, ignore_errors=True)
    return sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
