"""What lasts longer than a call."""

import copy
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

from torchbrdf.lasting import LastFew, LastMade, lasting, lasting_graph, on_disk
from torchbrdf.threads import side_by_side


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


def test_several_threads_share_the_last_few():
    """Each may be the one that makes room, and what another asked for may go in between."""
    kept = LastFew(1)

    def ask(thread: int) -> bool:
        keys = [(thread * i) % 5 for i in range(20_000)]
        return all(kept.get_or_make(key, lambda key=key: -key) == -key for key in keys)

    with torch.no_grad():
        threads, before = torch.get_num_threads(), sys.getswitchinterval()
        torch.set_num_threads(4)
        sys.setswitchinterval(1e-6)
        try:
            assert all(side_by_side(ask, [1, 2, 3, 4]))
        finally:
            torch.set_num_threads(threads)
            sys.setswitchinterval(before)


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode, torch.enable_grad])
@pytest.mark.parametrize("wanted", [False, True])
def test_a_graph_lasts_where_it_is_wanted(mode: type, wanted: bool):
    source = torch.ones(2).requires_grad_(wanted)
    with mode(), lasting_graph(source):
        made = 2 * source
    assert made.requires_grad == wanted
    weights = torch.ones(2, requires_grad=True)
    (weights * made).sum().backward()
    assert weights.grad.tolist() == [2, 2]


class TestOnDisk:
    @pytest.fixture
    def cache(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        monkeypatch.setenv("TORCHBRDF_CACHE", str(tmp_path))
        return tmp_path

    def once(self, value: float, depends: object = 1) -> Tensor:
        return on_disk("numbers", [depends], lambda: {"a": torch.full((3,), value).double()})["a"]

    def test_what_was_made_is_read_for_what_it_depends_on(self, cache: Path) -> None:
        assert self.once(1.0).tolist() == [1.0, 1.0, 1.0]
        assert self.once(2.0).tolist() == [1.0, 1.0, 1.0]
        assert self.once(2.0, depends=2).tolist() == [2.0, 2.0, 2.0]
        assert len(list((cache / "numbers").glob("*.safetensors"))) == 2

    @pytest.mark.parametrize(
        "damage", [lambda whole: whole[:-3], lambda whole: whole[:-9] + b"!" + whole[-8:], bytes.upper]
    )
    def test_a_damaged_file_is_made_again(self, cache: Path, damage: object) -> None:
        self.once(1.0)
        (path,) = (cache / "numbers").iterdir()
        path.write_bytes(damage(path.read_bytes()))
        assert self.once(2.0).tolist() == [2.0, 2.0, 2.0]
        assert self.once(3.0).tolist() == [2.0, 2.0, 2.0]

    def test_where_none_can_be_written_it_is_made_every_time(self, cache: Path) -> None:
        (cache / "numbers").write_text("no folder")
        assert self.once(1.0).tolist() == [1.0, 1.0, 1.0]
        assert self.once(2.0).tolist() == [2.0, 2.0, 2.0]


def test_what_was_made_of_tensors_lasts_until_one_changes():
    made, kept = [], LastMade()
    a, b = torch.zeros(2), torch.ones(2)

    def sums(*tensors: torch.Tensor) -> float:
        return kept.get_or_make(tensors, lambda: made.append(1) or float(sum(one.sum() for one in tensors)))

    assert [sums(a, b), sums(a, b), len(made)] == [2, 2, 1]
    assert [sums(b, a), sums(b), sums(b.clone()), len(made)] == [2, 2, 2, 4]
    assert [sums(a, b), len(made)] == [2, 5]
    a += 1
    assert [sums(a, b), sums(a, b), len(made)] == [4, 4, 6]


def test_what_was_made_of_tensors_of_inference_mode_lasts():
    made, kept = [], LastMade()
    with torch.inference_mode():
        a = torch.zeros(2)
    for _ in range(2):
        kept.get_or_make([a], lambda: made.append(1))
    assert made == [1]


def test_a_copy_makes_its_own():
    kept, a = LastMade(), torch.zeros(2)
    kept.get_or_make([a], lambda: "made")
    again, b = copy.deepcopy((kept, a))
    assert again.get_or_make([b], lambda: "anew") == "anew"
    assert kept.get_or_make([a], lambda: "anew") == "made"
