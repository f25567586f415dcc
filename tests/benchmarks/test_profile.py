"""What strace and perf write, and what the benchmarks make of it."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def _scripts(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(Path(__file__).parent), *sys.path])


def test_figures_of_a_command_and_of_a_process_that_has_ended():
    from _measure import _tree, run_timed

    work = "sum(range(3_000_000)); open('/dev/zero', 'rb').read({}); open('/dev/null', 'wb').write(bytes(4_000_000))"
    script = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"
    run, more = (run_timed([sys.executable, "-c", script, work.format(size)]) for size in (1_000, 9_001_000))
    assert run.exit_code == 0
    assert 0 < run.children < run.cpu
    assert more.bytes_read - run.bytes_read == pytest.approx(9_000_000, rel=0.01)
    assert run.bytes_written == pytest.approx(4_000_000, rel=0.01)
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        ended.wait()
        assert list(_tree(ended.pid)) == [ended.pid]


def test_bytes_by_file():
    from _file_bytes import FileBytes, bytes_of, parse_traces

    lines = [
        r'read(3</data/a (1).las>, ""..., 4096) = 4096',
        r'pread64(3</data/a (1).las>, ""..., 4096, 8) = 100',
        r"preadv(3</data/a (1).las>, [{iov_base=..., iov_len=9}], 1, 0) = 9",
        r"read(3</data/a (1).las>, 0x7f, 4096) = -1 EINTR (Interrupted system call)",
        r"read(4<socket:[12]>, ..., 4096) = 77",
        r"mmap(NULL, 8192, PROT_READ, MAP_SHARED, 3</data/a (1).las>, 0x1000) = 0x7f3a00000000",
        r"mmap(NULL, 8192, PROT_READ, MAP_PRIVATE|MAP_ANONYMOUS, -1, 0) = 0x7f3a00000000",
        r"mmap(NULL, 8192, PROT_READ, MAP_SHARED, 3</data/a (1).las>, 0) = -1 ENOMEM (Cannot allocate memory)",
        r"pwrite64(5</out/b.tif>, ..., 10, 0) = 10",
        r"sendfile(5</out/b.tif>, 3</data/a (1).las>, NULL, 50) = 50",
        r"copy_file_range(3</data/a (1).las>, NULL, 5</out/b.tif>, NULL, 60, 0) = 60",
        r"+++ exited with 0 +++",
    ]
    survey = FileBytes(read=4096 + 100 + 9 + 50 + 60, mapped=8192)
    assert parse_traces(lines) == {"/data/a (1).las": survey, "/out/b.tif": FileBytes(written=10)}
    assert bytes_of(Path("/data/a (1).las"), parse_traces(lines)) == survey.read + 8192


@pytest.mark.parametrize(
    ("file", "symbol", "part"),
    [
        ("[kernel.kallsyms]", "clear_page_erms", "operating system"),
        ("[ext4.ko]", "ext4_map_blocks", "operating system"),
        ("/run/perf-4711.map", "[unknown]", "compiled kernels"),
        ("[JIT] tid 4711", "[unknown]", "compiled kernels"),
        ("//anon", "[unknown]", "compiled kernels"),
        ("/usr/lib/libpython3.11.so.1.0", "PyDict_GetItem", "Python interpreter"),
        ("/usr/lib/python3.11/lib-dynload/_json.cpython-311-x86_64-linux-gnu.so", "x", "Python interpreter"),
        ("/v/site-packages/numpy/_core/_multiarray_umath.so", "x", "numpy"),
        ("/v/site-packages/numpy.libs/libscipy_openblas64_.so", "dgemm", "numpy"),
        ("/v/site-packages/rasterio.libs/libgdal-c8c9c467.so.36", "x", "rasterio and its GDAL"),
        ("/v/site-packages/lazrs/lazrs.so", "x", "lazrs"),
        ("/usr/lib/libc.so.6", "__memmove_avx512_unaligned_erms", "libc: memory copied, set, compared"),
        ("/usr/lib/libc.so.6", "_int_free", "libc: memory allocated, freed"),
        ("/usr/lib/libc.so.6", "pthread_mutex_lock", "libc: other"),
        ("/usr/lib/libcrypto.so.3", "sha256_block", "hashlib (OpenSSL)"),
        ("/usr/lib/libfoo.so.1", "x", "libfoo.so.1"),
        ("", "", "unknown"),
    ],
)
def test_part_of_a_sample(file, symbol, part):
    from _samples import part_of

    assert part_of(file, symbol) == part


def test_samples_by_part():
    from _samples import samples_in

    heads = [
        " 4711 ffffffff815ee239 clear_page_erms ([kernel.kallsyms])",
        " 4711     7fba3f13fe8c PyDict_GetItem (/usr/lib/libpython3.11.so.1.0)",
        " 4711     7fba3f13ffff [unknown] (/tmp/perf-4711.map)",
        "",
        " 4711 ffffffff81591287 filemap_read ([kernel.kallsyms])",
    ]
    chains = ["clear_page_erms do_fault asm_exc_page_fault vfs_read", "", "", "filemap_read vfs_read ksys_pread64"]
    assert samples_in(heads, chains) == {
        "operating system: page faults": 1,
        "Python interpreter": 1,
        "compiled kernels": 1,
        "operating system: reading files": 1,
    }


def _profile(wall_s, samples, files):
    timed = {"wall_s": wall_s, "cpu_s": 4.0, "user_s": 3.0, "system_s": 1.0, "children_s": 0.5, "peak_bytes": 5e8}
    timed |= {"minor_faults": 12345, "major_faults": 0, "bytes_read": 2e9, "bytes_written": 1e6}
    stages = {"read": 1.5, "write": 0.25}
    return {"rounds": 3, "survey_bytes": 1e9, "timed": timed, "stages": stages, "samples": samples, "files": files}


def test_two_profiles_stand_side_by_side():
    from _profile_page import profile_tables

    files = {"the survey": [1_500_000_000, 500_000_000, 0], "layers": [0, 0, 1_000_000]}
    before = _profile(3.0, {"numpy": 750, "compiled kernels": 249, "libx": 1}, files)
    text = profile_tables({"a survey": {"before": before, "now": _profile(2.5, None, None)}}, 2)
    assert "| wall time [s] | 3.00 | 2.50 |" in text
    assert "| waiting: 2 x wall time, less user and system time [s] | 2.00 | 1.00 |" in text
    assert "| outside of all stages | 1.25 | 0.75 |" in text
    assert "| numpy | 75.0 % (3.00 s) |" in text
    assert "| other libraries | 0.1 % (0.00 s) |" in text
    assert "| the survey | 1,500.0 / 500.0 / 0.0 |" in text
    assert "| read and mapped of the survey, relative to its 1,000.0 MB | 2.00 |" in text
    assert "before: perf may not sample the operating system" in text
    assert "now: perf is not installed" in text
    assert "now: strace is not installed" in text


def _samples(wall_s, user_s=1.0, system_s=0.1, peak_bytes=5e8):
    kept = {"wall_s": wall_s, "user_s": user_s, "system_s": system_s, "cpu_s": user_s + system_s}
    return [{**kept, "peak_bytes": peak_bytes}]


def test_targets():
    from _targets import goals

    las = "20m-las"
    results = {
        "titles": {"real1": "a real one", las: "20 million", "sample": "the sample"},
        "surveys": {las: {"bytes": 1000}},
        "samples": {
            "real1": {"map": _samples(2.0), "read": _samples(1.0), "pdal": _samples(3.2), "pdal_bin": _samples(2.3)},
            las: {"map": _samples(1.0), "map_1gb": _samples(1.0), "pdal": [{**_samples(4.0)[0], "exit_code": 1}]},
            "sample": {"map": _samples(0.6), "before": _samples(1.0)},
        },
        "bytes_read": {las: {"map": {"survey": 1040, "all": 1500}}},
        "same_bits": {f"{las} before": ["another version", True], f"{las} map_1gb": ["other options", False]},
        "patch": {},
    }
    shown = {label: (value, goal, met) for label, value, goal, met in goals(results) if value}
    assert shown["a real one: PDAL, time relative to `map`"] == ("1.6", "at least 1.5", "yes")
    assert shown["a real one: PDAL with `binmode`, time relative to `map`"] == ("1.15", "at least 1.2", "no")
    assert shown["a real one: `map`, time relative to reading alone"] == ("2", "at most 1.5", "no")
    assert shown["the sample: `map`, time relative to the version before"] == ("0.6", "at most 0.7", "yes")
    assert "20 million: PDAL, time relative to `map`" not in shown  # it failed
    assert shown["20 million: `map`, system time relative to user time"] == ("0.1", "at most 0.2", "yes")
    label = "20 million: `map`, bytes read of the survey relative to its size"
    assert shown[label] == ("1.04", "at most 1.05", "yes")
    assert shown["20 million: `map --memory 1GB`, peak memory"] == ("0.5 GB", "at most 0.7 GB", "yes")
    assert shown["layers compared with those of another version"][2] == "yes"
    assert shown["layers compared with those of other options"][0] == "other bits: 20m-las map_1gb"
