"""The end of the process: what other code registered for it still runs, and nothing that was printed is lost."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import atexit, sys
atexit.register(lambda: print("registered", end=""))
from bumpymap.__main__ import run
sys.argv = ["bumpymap", *sys.argv[1:]]
run()
"""


@pytest.mark.parametrize(("words", "code"), [(("--help",), 0), (("map", "--nothing"), 2)])
def test_functions_for_the_end_run_and_output_is_flushed(words, code):
    done = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stdout.endswith("registered")
    assert "Usage:" in done.stdout + done.stderr
    assert "Traceback" not in done.stderr


def test_the_interpreter_is_not_taken_apart():
    program = PROGRAM.replace("run()\n", "") + "class Kept:\n def __del__(self): print('apart')\nkept = Kept()\nrun()\n"
    done = subprocess.run([sys.executable, "-c", program, "--help"], capture_output=True, text=True, check=True)
    assert "apart" not in done.stdout


@pytest.mark.parametrize("given", [None, "26"])
def test_threads_of_linear_algebra_do_not_spin_unless_the_user_says_so(given):
    """Told before numpy is imported, since its library reads the variable once."""
    program = PROGRAM.replace("run()\n", "") + (
        "import bumpymap.cli, os\n"
        "bumpymap.cli.main = lambda: print(os.environ['OPENBLAS_THREAD_TIMEOUT'], 'numpy' in sys.modules)\n"
        "run()\n"
    )
    env = {name: value for name, value in os.environ.items() if name != "OPENBLAS_THREAD_TIMEOUT"}
    env |= {} if given is None else {"OPENBLAS_THREAD_TIMEOUT": given}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, env=env)
    assert done.stdout.split()[:2] == [given or "4", "False"]
