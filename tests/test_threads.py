"""Operations side by side: in order, with the errors of their own, and the number of threads as it was."""

import threading

import pytest
import torch

from torchbrdf.threads import one_thread, side_by_side


@pytest.fixture(autouse=True)
def two_threads():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(threads)


def test_results_keep_the_order_of_parts():
    assert side_by_side(lambda x: x * x, range(7)) == [0, 1, 4, 9, 16, 25, 36]


def test_as_many_at_once_as_there_are_threads_and_one_thread_for_each():
    together = threading.Barrier(2, timeout=30)

    def alone(_: int) -> tuple[int, int]:
        return together.wait(), torch.get_num_threads()

    found = side_by_side(alone, range(2))
    assert sorted(order for order, _ in found) == [0, 1]
    assert [threads for _, threads in found] == [1, 1]
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("parts", [[], [3]])
def test_nothing_begins_a_thread_for_one_part(parts):
    here = threading.get_ident()
    assert side_by_side(lambda _: threading.get_ident(), parts) == [here] * len(parts)


def test_the_error_of_a_part_is_raised_and_threads_are_as_before():
    def refuse(part: int) -> None:
        raise ValueError(f"part {part}")

    with pytest.raises(ValueError, match="part 0"):
        side_by_side(refuse, range(3))
    assert torch.get_num_threads() == 2


def test_one_thread_ends_with_the_block():
    with one_thread() as threads:
        assert (threads, torch.get_num_threads()) == (2, 1)
    assert torch.get_num_threads() == 2
