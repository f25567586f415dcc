"""Child processes: whatever becomes of one is one clear error, and no start has effects beside it."""

import os
import signal
import subprocess
import sys
import textwrap

import pytest

from bumpymap.core.processes import Child, ChildDiedError, ChildError, allocate_shared

pytestmark = pytest.mark.skipif(os.name != "posix", reason="no children here")


@pytest.fixture
def child():
    """A child that calls functions of ``os``."""
    made = Child("to test", "os", [])
    yield made
    made.close()


def said_by(code, **options):
    command = [sys.executable, "-c", textwrap.dedent(code)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True, **options).stdout


def test_a_child_is_a_process_of_its_own_that_answers(child):
    assert child.call("getpid") == child.process.pid != os.getpid()
    assert child.call("getppid") == os.getpid()


def test_what_a_function_raises_is_told_and_the_child_goes_on(child):
    with pytest.raises(ChildError, match="No such file"):
        child.call("listdir", "/none")
    with pytest.raises(ChildError, match="no attribute"):
        child.call("none")
    assert child.is_alive


@pytest.mark.parametrize(
    ("question", "message", "name"),
    [(("_exit", 3), r"ended by itself \(code 3\)", ""), (("abort",), "was ended by SIGABRT", "SIGABRT")],
)
def test_a_child_that_dies_is_told(child, question, message, name):
    with pytest.raises(ChildDiedError, match=message) as error:
        child.call(*question)
    assert error.value.signal == name
    assert not child.is_alive
    with pytest.raises(ChildDiedError, match=message):
        child.call("getpid")


def test_a_request_ofends_with_its_processor_time():
    child = Child("to test", "builtins", [])
    with pytest.raises(ChildDiedError) as error:
        child.call("sum", range(10**12), seconds=0.05)
    assert error.value.signal == "SIGPROF"


@pytest.mark.skipif(sys.platform != "linux", reason="limits are those of Linux")
def test_a_request_for_more_memory_than_allowed_fails_alone():
    child = Child("to test", "builtins", [])
    with pytest.raises(ChildError, match="MemoryError"):
        child.call("bytes", 1 << 30, memory=200 << 20)
    assert child.call("len", b"12", memory=200 << 20) == 2
    child.close()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_are_for_the_parent(child, number):
    child.call("getpid")
    child.process.send_signal(number)
    assert child.call("getpid") == child.process.pid


def test_memory_is_seen_by_both(tmp_path):
    (tmp_path / "fill.py").write_text("def fill(value, memory): memory[:] = bytes([value]) * len(memory)\n")
    child = Child("to test", "fill", [str(tmp_path)])
    for size, value in ((5, 7), (10 << 20, 9), (0, 1)):  # the second makes the memory grow
        memory = allocate_shared(size)
        child.call("fill", value, shared=(memory,))
        assert memory.data.size == size
        assert (memory.data == value).all()
    child.close()


def test_a_fork_leaves_the_children_to_the_old_process(child):
    pid = child.call("getpid")
    forked = os.fork()
    if forked == 0:
        left = not child.is_alive
        child.close()
        os._exit(0 if left else 1)
    assert os.waitpid(forked, 0)[1] == 0
    assert child.call("getpid") == pid


def test_a_daemonic_process_may_have_children():
    """As the workers of Dask are."""
    code = """
        import multiprocessing, operator, os
        from bumpymap.lab.simulate.jobs import run_in_processes

        def work():
            os._exit(sum(run_in_processes(operator.neg, [-1, -2], 2)))

        process = multiprocessing.get_context("fork").Process(target=work, daemon=True)
        process.start()
        process.join()
        print(process.exitcode)
    """
    assert said_by(code) == "3\n"
