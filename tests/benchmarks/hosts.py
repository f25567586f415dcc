"""Run a cluster of two hosts, lose one in the middle of a run, and compare the layers with those of one process.

python tests/benchmarks/hosts.py SURVEY... --data FOLDER [--saved 1] [--map-options "--ground all"]

The hosts are network namespaces of this machine, joined by a link, with mount namespaces in which /tmp is private,
except for two folders that both share, that of the surveys and that of `--out`, and for checkout and environment if
they lie in /tmp. The first host has the scheduler, the client and a worker; the second has two workers. All connections
between them use TLS.

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
_SCHEDULER = f"tls://{FIRST}:8786"
_SHARED, _SURVEYS, _TLS = "/tmp/shared", "/tmp/surveys", "/tmp/tls"  # noqa: S108 (private to the hosts)
_CLIENT = {
    "DASK_DISTRIBUTED__COMM__TLS__CA_FILE": f"{_TLS}/ca.pem",
    "DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT": f"{_TLS}/cert.pem",
    "DASK_DISTRIBUTED__COMM__TLS__CLIENT__KEY": f"{_TLS}/key.pem",
}
"""Dask's own configuration of a client with TLS."""
_LIMITS = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__TCP": "12s", "RAYON_NUM_THREADS": "1"}
"""After 12 s without an answer the scheduler gives up a worker."""
_WAIT_S = 60.0
_MADE_CERTIFICATES = """
openssl req -x509 -newkey rsa:2048 -noenc -days 2 -subj "/CN=test cluster" -keyout ca-key.pem -out ca.pem
openssl req -newkey rsa:2048 -noenc -subj "/CN=dask" -keyout key.pem -out request.pem
openssl x509 -req -in request.pem -CA ca.pem -CAkey ca-key.pem -CAcreateserial -days 2 -out cert.pem
"""
_NEW_HOST = """
set -e
mount -t tmpfs tmpfs {stage}
mkdir {stage}/shared {stage}/surveys {stage}/tls
mount --bind {data}/shared {stage}/shared
mount --bind {data}/files {stage}/surveys
{code}
cp {data}/tls/*.pem {stage}/tls
mount --move {stage} /tmp
echo ready
exec sleep infinity
"""


class Host:
    """A network and a mount namespace, and the processes in them."""

    def __init__(self, name: str, data: Path) -> None:
        self.name = name
        stage = data / name
        stage.mkdir()
        roots = {Path(__file__).resolve().parents[2], Path(sys.prefix), Path(sys.base_prefix)}
        shared = [(one, stage / one.relative_to("/tmp")) for one in sorted(roots) if one.is_relative_to("/tmp")]  # noqa: S108
        code = "\n".join(f"mkdir -p {there}; mount --bind {one} {there}" for one, there in shared)
        script = _NEW_HOST.format(stage=stage, data=data, code=code)
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
                env=os.environ | _LIMITS | environment,
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


def run_hosts(surveys: Sequence[Path], data: Path, saved: int, options: Sequence[str]) -> bool:
    """Do what the script does; return whether the layers are the same."""
    bumpymap = str(Path(sys.executable).with_name("bumpymap"))
    for folder in ("shared", "tls", "files", "log"):
        (data / folder).mkdir(parents=True)
    subprocess.run(["sh", "-ec", _MADE_CERTIFICATES], cwd=data / "tls", check=True, capture_output=True)
    for path in surveys:
        shutil.copy(path, data / "files")
    inputs = [f"{_SURVEYS}/{path.name}" for path in surveys]
    log = data / "log"
    with ExitStack() as stack:
        hosts = []
        for name in _network(stack):
            hosts.append(Host(name, data))
            stack.callback(hosts[-1].kill)
        first, second = hosts
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
        one, two = (_digests(data / "shared" / name) for name in ("one", "two"))
        differ = [name for name in one if one[name] != two.get(name)]
        left = [path.name for path in (data / "shared" / "two").glob(".bumpymap-run*")] if not code else []
        print(f"layers: {len(one)} files, {'the same' if not differ else 'other bytes in ' + ', '.join(differ)}")
        if left:
            print(f"left behind: {', '.join(left)}")
        return code == 0 and bool(one) and one.keys() == two.keys() and not differ and not left


def main() -> None:
    """Parse the arguments and run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("surveys", nargs="+", type=Path)
    parser.add_argument(
        "--data", type=Path, required=True, help="folder for what the run makes; a new folder in it is deleted after"
    )
    parser.add_argument("--saved", type=int, default=1, help="results that are saved before the host is lost")
    parser.add_argument("--map-options", default="", help="more options of bumpymap map")
    given = parser.parse_args()
    data = given.data.resolve() / f"hosts-{os.getpid()}"
    try:
        same = run_hosts([path.resolve() for path in given.surveys], data, given.saved, shlex.split(given.map_options))
    except SystemExit:
        for path in sorted((data / "log").iterdir()):
            print(f"--- {path.name}", path.read_text()[-2000:], sep="\n", file=sys.stderr)
        raise
    finally:
        shutil.rmtree(data, ignore_errors=True)
    sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
