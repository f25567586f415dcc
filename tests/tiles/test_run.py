import pytest

from bumpytiles import run_blocks


def square(x):
    return x * x


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_results_come_in_the_order_of_the_blocks(workers):
    assert list(run_blocks(square, range(50), workers)) == [x * x for x in range(50)]


def test_blocks_are_drawn_lazily():
    drawn = iter(range(100))
    results = run_blocks(square, drawn, 2)
    next(results)
    assert next(drawn) <= 5
    results.close()


def test_a_failure_is_raised_and_ends_the_work():
    def fail_at_three(x):
        started.append(x)
        if x == 3:
            raise RuntimeError("three")

    started = []
    with pytest.raises(RuntimeError, match="three"):
        list(run_blocks(fail_at_three, range(1000), 2))
    assert len(started) < 20
