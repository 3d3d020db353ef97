"""Parts of one computation in threads of their own."""

import threading

import pytest
import torch

from torchbrdf.threads import one_thread, side_by_side


class TestSideBySide:
    """In order, with the errors of their own, and the number of threads as it was."""

    @pytest.fixture(autouse=True)
    def two_threads(self):
        threads = torch.get_num_threads()
        torch.set_num_threads(2)
        yield
        torch.set_num_threads(threads)

    def test_results_keep_the_order_of_parts(self):
        assert side_by_side(lambda x: x * x, range(7)) == [0, 1, 4, 9, 16, 25, 36]

    def test_as_many_at_once_as_there_are_threads_and_one_thread_for_each(self):
        together = threading.Barrier(2, timeout=30)

        def alone(_: int) -> tuple[int, int]:
            return together.wait(), torch.get_num_threads()

        found = side_by_side(alone, range(2))
        assert sorted(order for order, _ in found) == [0, 1]
        assert [threads for _, threads in found] == [1, 1]
        assert torch.get_num_threads() == 2

    def test_this_thread_is_one_of_them(self):
        together = threading.Barrier(2, timeout=30)

        def where(_: int) -> int:
            together.wait()
            return threading.get_ident()

        assert threading.get_ident() in side_by_side(where, range(2))

    @pytest.mark.parametrize("parts", [[], [3]])
    def test_nothing_begins_a_thread_for_one_part(self, parts):
        here = threading.get_ident()
        assert side_by_side(lambda _: threading.get_ident(), parts) == [here] * len(parts)

    def test_the_error_of_a_part_is_raised_and_threads_are_as_before(self):
        def refuse(part: int) -> None:
            raise ValueError(f"part {part}")

        with pytest.raises(ValueError, match="part 0"):
            side_by_side(refuse, range(3))
        assert torch.get_num_threads() == 2

    def test_one_thread_ends_with_the_block(self):
        with one_thread() as threads:
            assert (threads, torch.get_num_threads()) == (2, 1)
        assert torch.get_num_threads() == 2
