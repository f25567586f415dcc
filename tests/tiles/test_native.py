"""Machine code kept between runs: the same numbers as numba's and Python's, and never the code of another source."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from jitted_helpers import jitted

from bumpytiles.native import Kernel

pytestmark = pytest.mark.slow

SOURCE = """
import math
from typing import Annotated, NamedTuple
import numpy as np
from numpy.typing import NDArray
from bumpytiles.native import helper, kernel

Vector = Annotated[NDArray[np.float64], 1]

class Weights(NamedTuple):
    table: Annotated[NDArray[np.float32], 2]
    times: int
    shift: float
    use: Annotated[NDArray[np.bool_], 1]

@helper
def square(x):
    return x * x

@kernel
def weigh(x: Vector, weights: Weights, out: Vector) -> None:
    for i in range(len(x)):
        if weights.use[i]:
            out[i] = weights.shift + weights.times * square(x[i]) + weights.table[i, 1] + math.erfc(x[i])
"""
ALLOCATES = """
@kernel
def allocates(x: Vector, out: Vector) -> None:
    twice = np.empty(len(x))
    for i in range(len(x)):
        twice[i] = 2.0 * x[i]
    for i in range(len(x)):
        out[i] = twice[len(x) - 1 - i]
"""
RUN = """
import sys
import numpy as np
import tiny
out = np.zeros(3)
weights = tiny.Weights(np.ones((3, 2), np.float32), 3, 0.25, np.array([True, False, True]))
tiny.weigh(np.array([0.5, 1.0, 2.0]), weights, out)
print(out.tolist(), "numba" in sys.modules)
"""
NUMBERS = "[2.479500122"


@pytest.fixture
def place(tmp_path):
    """Folder with a kernel module and an empty cache."""
    (tmp_path / "tiny.py").write_text(SOURCE)
    return tmp_path


ALONE = "from bumpytiles import native; native._kernels.clear()\n"  # the package's own kernels stay out of it


def ran(place, code=RUN, here=None):
    paths = os.pathsep.join([str(place), *(str(Path(p)) for p in sys.path if p)])
    env = {**os.environ, "PYTHONPATH": paths, "NUMBA_CACHE_DIR": str(place / "cache")}
    command = [sys.executable, "-c", ALONE + code]
    done = subprocess.run(command, env=env, cwd=here, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def run(*where, **how):
    return ran(*where, **how).stdout.strip()


def kept(place):
    (file,) = (place / "cache").iterdir()
    return file


@pytest.mark.parametrize("damage", [lambda whole: whole[:-1], lambda whole: whole[:-200] + b"\x90" + whole[-199:]])
def test_the_second_run_compiles_nothing_and_makes_a_damaged_file_anew(place, damage):
    """numba reads a file of settings in the current folder, and would compile for another processor or none."""
    (place / "surveys").mkdir()
    (place / "surveys" / ".numba_config.yaml").write_text("disable_jit: [")
    first = run(place, here=place / "surveys")
    assert first.startswith(NUMBERS)
    assert first.endswith("False")  # the compiler ran elsewhere
    whole, made = kept(place).read_bytes(), kept(place).stat().st_mtime_ns
    assert run(place) == first
    assert kept(place).stat().st_mtime_ns == made
    kept(place).write_bytes(damage(whole))
    assert run(place) == first
    assert kept(place).read_bytes()[:64] == whole[:64]


@pytest.mark.later
def test_all_loaded_modules_are_compiled_at_once_with_a_warning(place):
    for name in ("other", "third"):
        (place / f"{name}.py").write_text(SOURCE.replace("weigh(", f"{name}("))
    assert "compiling 1 numerical kernel, once" in ran(place).stderr
    assert "compiling 1 numerical kernel," in ran(place, "import tiny, other\nnative.compile_loaded()").stderr
    assert {file.name.split(".")[1] for file in (place / "cache").iterdir()} == {"weigh", "other"}
    shutil.rmtree(place / "cache")
    assert run(place, "import tiny, third\n" + RUN) == run(place)
    assert {file.name.split(".")[1] for file in (place / "cache").iterdir()} == {"weigh", "third"}
    assert ran(place, "import tiny, third\n" + RUN).stderr == ""


def test_what_a_package_ships_is_run_and_a_changed_source_is_not_taken_for_it(place):
    said = run(place)
    (place / "cache").rename(place / "kernels")
    (place / "kernels").chmod(0o775)  # as in a checkout: whoever writes there can write the sources too
    assert ran(place).stderr == ""
    assert not (place / "cache").exists()
    (place / "tiny.py").write_text(SOURCE.replace("x * x", "0.0"))
    assert run(place) != said
    kept(place)


@pytest.fixture(scope="module")
def forged(tmp_path_factory):
    """Code of another source that says it is that of ``SOURCE``, its name, and what each of the two prints."""
    files, said = [], []
    for source in (SOURCE, SOURCE.replace("x * x", "x * x * 0.0")):
        folder = tmp_path_factory.mktemp("source")
        (folder / "tiny.py").write_text(source)
        said.append(run(folder))
        files.append(kept(folder))
    return files[0].name, files[0].read_bytes()[:32] + files[1].read_bytes()[32:], *said


@pytest.fixture
def planted(place, forged):
    """The forged file in the cache of the true source."""
    name, content, _, _ = forged
    (place / "cache").mkdir(mode=0o700)
    (place / "cache" / name).write_bytes(content)
    return place / "cache" / name


def linked(path):
    path.rename(path.with_name("elsewhere"))
    path.symlink_to("elsewhere")


needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="root alone gives files away, and has those of others")


@pytest.mark.parametrize("of", ["file", "folder"])
@pytest.mark.parametrize(
    "fault",
    [
        lambda path: path.chmod(0o775),
        pytest.param(linked, marks=pytest.mark.later),
        pytest.param(lambda path: os.lchown(path, 4242, -1), marks=[pytest.mark.later, needs_root]),
    ],
)
def test_code_that_another_may_have_planted_does_not_run(place, planted, forged, of, fault):
    fault(planted if of == "file" else planted.parent)
    assert run(place).startswith(NUMBERS)


@needs_root
def test_what_root_installed_is_taken(place, planted, forged):
    assert run(place, "import os; os.geteuid = lambda: 12345\n" + RUN) == forged[3]


WITHOUT_HOME = """
import logging, os, pwd
def nobody(_):
    raise KeyError("uid not found")
pwd.getpwuid = nobody
os.environ.pop("HOME", None)
os.environ.pop("XDG_CACHE_HOME", None)
os.environ.pop("NUMBA_CACHE_DIR")
logging.basicConfig(format="%(message)s")
"""


@pytest.mark.later
def test_a_user_without_a_home_is_told_once_that_nothing_is_kept(place):
    (place / "small.py").write_text(SOURCE.replace("weigh(", "small("))
    (place / "__pycache__").write_text("in the way")
    other = "\nimport small\nsmall.small(np.ones(3), small.Weights(*weights), out)"
    done = ran(place, WITHOUT_HOME + RUN + other, here=place)
    assert done.stdout.startswith(NUMBERS)
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("the numerical kernels are compiled in every run")
    assert "__pycache__ (Not a directory)" in line
    assert "Set NUMBA_CACHE_DIR to a folder of your own" in line


def test_a_kernel_that_allocates_is_refused_by_name(place):
    (place / "tiny.py").write_text(SOURCE + ALLOCATES)
    code = "import numpy as np, tiny\ntry: tiny.allocates(np.arange(3.0), np.zeros(3))\nexcept TypeError as e: print(e)"
    assert "the kernel allocates cannot be kept: it calls NRT_" in run(place, code)


def test_a_change_of_the_source_a_helper_or_a_constant_is_seen_and_takes_the_place(place):
    helper = "from bumpytiles.native import helper\nfrom numbers_of import FACTOR\n\n"
    sources = {
        "tiny.py": SOURCE.replace("@helper\ndef square(x):\n    return x * x\n", "from parts import square\n"),
        "parts.py": f"{helper}@helper\ndef square(x):\n    return FACTOR * x * x\n",
        "numbers_of.py": "FACTOR = 1.0\n",
    }
    for name, source in sources.items():
        (place / name).write_text(source)
    said = run(place)
    assert said.startswith(NUMBERS)
    # Of another size: Python takes a file of the same second and size for the same one.
    changes = {"numbers_of.py": ("1.0", "0.125"), "parts.py": ("x * x", "x"), "tiny.py": ("square(x[i])", "0.0")}
    for name, change in changes.items():
        (place / name).write_text(sources[name].replace(*change))
        before, said = said, run(place)
        assert said != before
        kept(place)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kernels")
    (folder / "tiny_here.py").write_text(SOURCE)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setenv("NUMBA_CACHE_DIR", str(folder / "cache"))
        patch.setattr("bumpytiles.native._kernels", {})  # other modules need not be compiled into this cache
        yield __import__("tiny_here")


def arguments(tiny, n=50):
    rng = np.random.default_rng(0)
    weights = tiny.Weights(np.ones((n, 2), np.float32), 2, 0.5, rng.random(n) < 0.5)
    return [rng.normal(size=n), weights, np.zeros(n)]


def test_machine_code_numba_and_python_agree(tiny):
    """Machine code also from threads that come at once."""
    kernels = [jitted(tiny.weigh.plain), tiny.weigh.plain, *4 * [Kernel(tiny.weigh.plain)]]
    given = [arguments(tiny) for _ in kernels]
    with ThreadPoolExecutor(6) as pool:
        list(pool.map(lambda kernel, each: kernel(*each), kernels, given))
    (_, _, by_numba), (_, _, by_python), *compiled = given
    assert np.count_nonzero(by_numba) > 10
    np.testing.assert_allclose(by_numba, by_python, rtol=1e-14)
    for _, _, out in compiled:
        np.testing.assert_array_equal(out, by_numba)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda given: [given[0].astype(np.float32), *given[1:]], "x of weigh is float32"),
        (
            lambda given: [given[0], given[1]._replace(table=np.zeros((50, 4), "f4")[:, ::2]), given[2]],
            "table .* C-cont",
        ),
        (lambda given: [*given[:2], given[2][:, None]], "out of weigh .* with 2 dimensions"),
        (lambda given: [given[0], (1, 2, 3, 4), given[2]], "takes a Weights, not a tuple"),
        (lambda given: given[:2], "takes 3 arguments, not 2"),
    ],
)
def test_arguments_of_another_kind_are_refused(tiny, change, message):
    with pytest.raises(TypeError, match=message):
        tiny.weigh(*change(arguments(tiny)))
