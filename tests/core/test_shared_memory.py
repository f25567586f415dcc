"""Shared memory: no two arrays that are in use overlap, whatever is dropped in between, and place is used again."""

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
