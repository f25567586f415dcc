"""A signal ends a run once, wherever it comes: with one exception, no traceback, and what was begun cleared up."""

import os
import signal
import subprocess
import sys

import pytest

BEGIN = """
import os, signal, sys, weakref
from bumpymap.core.interrupts import interruptible, shielded

def hit(*_):
    os.kill(os.getpid(), signal.{name})
    for _ in range(10): pass  # the handler runs between two steps
"""
LOST = {
    "in a finaliser": "class Dies:\n    __del__ = hit\nDies()",
    "in a callback of a weak reference": "class Dies: pass\none = Dies()\nref = weakref.ref(one, hit)\ndel one",
}


def ended(name, body):
    """Run a body, and give the exit code and what was said."""
    code = BEGIN.format(name=name) + "\ntry:\n    with interruptible():\n"
    code += "".join(f"        {line}\n" for line in body.splitlines())
    code += "except KeyboardInterrupt as end:\n    print(type(end).__name__)\n    sys.exit(9)\n"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    return done.returncode, done.stdout.split(), done.stderr


@pytest.mark.parametrize(("name", "word"), [("SIGTERM", "Terminated"), ("SIGINT", "Interrupted")])
@pytest.mark.parametrize("where", LOST)
def test_a_signal_that_the_interpreter_loses_comes_again(name, word, where):
    assert ended(name, LOST[where] + "\nwhile True: pass") == (9, [word], "")


def test_a_second_signal_does_not_break_the_clearing_up():
    body = "try:\n    hit()\nfinally:\n    hit()\n    print('cleared')"
    assert ended("SIGTERM", body) == (9, ["cleared", "Terminated"], "")


def test_who_insists_is_heard():
    body = "try:\n    hit()\nfinally:\n    hit()\n    hit()\n    print('deaf')\n    hit()\n    print('never')"
    assert ended("SIGTERM", body) == (9, ["deaf", "Terminated"], "")


def test_an_error_that_a_library_makes_of_a_signal_is_the_signal():
    body = "try:\n    hit()\nexcept KeyboardInterrupt:\n    raise ImportError('initialization failed')"
    assert ended("SIGTERM", body) == (9, ["Terminated"], "")


def test_a_shield_lets_a_signal_wait():
    body = "with shielded():\n    with shielded():\n        hit()\n    print('whole')\nprint('never')"
    assert ended("SIGTERM", body) == (9, ["whole", "Terminated"], "")


def test_a_run_that_is_over_leaves_signals_as_they_were():
    body = "class Dies:\n    __del__ = hit\nDies()"  # lost, and over before it comes again
    code, said, error = ended("SIGTERM", body + "\n")
    assert (code, error) in ((0, ""), (9, ""))
    assert said in ([], ["Terminated"])
    code = BEGIN.format(name="SIGTERM") + "with interruptible(): pass\nhit()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")


def test_a_forked_child_ends_as_any_process_does():
    body = "child = os.fork()\nif not child:\n    hit()\nprint(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))"
    assert ended("SIGTERM", body) == (0, [str(-signal.SIGTERM)], "")


def test_the_command_ends_without_a_word_before_it_listens(tmp_path):
    (tmp_path / "click.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\nwhile True: pass")
    paths = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    begin = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    begin += "from bumpymap.__main__ import run; run()"
    command = [sys.executable, "-c", begin, "--help"]
    env = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=env)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")
