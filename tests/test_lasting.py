"""What lasts longer than a call."""

import pytest
import torch

from torchbrdf.lasting import LastFew, lasting


def test_what_is_made_in_inference_mode_enters_graphs_later():
    with torch.inference_mode():
        made = lasting(lambda: torch.ones(2))()
    weights = torch.ones(2, requires_grad=True)
    (weights * made).sum().backward()
    assert weights.grad.tolist() == [1, 1]


def test_the_last_few_are_kept_and_the_oldest_makes_room():
    made = []
    kept = LastFew(2)
    for key in "abacab":
        assert kept.get_or_make(key, lambda key=key: made.append(key) or key.upper()) == key.upper()
    assert made == ["a", "b", "c", "a", "b"]
    assert list(kept) == ["a", "b"]


def test_what_cannot_be_made_costs_nothing_that_was():
    kept = LastFew(1)
    kept.get_or_make("a", lambda: 1)
    with pytest.raises(ZeroDivisionError):
        kept.get_or_make("b", lambda: 1 / 0)
    assert dict(kept) == {"a": 1}
