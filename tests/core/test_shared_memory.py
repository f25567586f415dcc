"""Shared memory: no two arrays that are in use overlap, whatever is dropped in between, and place is used again."""

import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core.processes import SharedMemory

SIZES = st.integers(0, 40_000)


@settings(deadline=None, max_examples=60)
@given(steps=st.lists(st.one_of(SIZES, st.tuples(SIZES)), max_size=40))
def test_arrays_keep_their_content_until_they_are_dropped(steps):
    """A size takes so many bytes; a size in a tuple drops one of those that are held."""
    memory, held = SharedMemory(), []
    for number, step in enumerate(steps):
        if isinstance(step, tuple):
            if held:
                held.pop(step[0] % len(held))
            continue
        part = memory.allocate(step)
        part.data[:] = number % 251
        # A view of a view: the part itself is gone.
        held.append((part.data[:].reshape(-1)[: step // 2], number % 251))
    for data, value in held:
        assert (data == value).all()


def test_place_is_used_again():
    memory = SharedMemory()
    for _ in range(100):
        part = memory.allocate(1 << 20)
        part.data[:] = 1
        del part
    assert memory.size == 1 << 22


def test_trimming_takes_nothing_from_anyone():
    memory = SharedMemory()
    held = memory.allocate(4)
    held.data[:] = 7
    memory.trim()
    assert held.data.tolist() == [7] * 4
    del held
    memory.trim()
    assert memory.size == 0
    again = memory.allocate(5)
    again.data[:] = 8
    assert again.data.tolist() == [8] * 5


def test_a_map_that_no_memory_is_left_for_leaves_the_one_that_is_there(monkeypatch):
    memory = SharedMemory()
    held = memory.allocate(1000)

    def refuse(*_):
        raise OSError(12, "Cannot allocate memory")

    with monkeypatch.context() as patch:
        patch.setattr("bumpymap.core.processes.mmap.mmap", refuse)
        for _ in range(2):  # as two threads that ask one after the other
            with pytest.raises(OSError, match="Cannot allocate memory"):
                memory.allocate(1 << 30)
    held.data[:] = 7
    assert memory.allocate(1 << 20).data.size == 1 << 20
    assert (held.data == 7).all()
