"""What is made once and lasts longer than the call that needed it first: in memory, or on disk.

And what is made alike every time, whatever torch is told around the call.
"""

import hashlib
import json
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from typing import Any, Generic, ParamSpec, TypeVar

import torch
from torch import Tensor

from torchbrdf._version import __version__
from torchbrdf.files import cache_folder, writing

Key = TypeVar("Key", bound=Hashable)
Made = TypeVar("Made")
Arguments = ParamSpec("Arguments")

_NOTHING: Any = object()
"""Was made yet."""


def without_autocast(make: Callable[Arguments, Made]) -> Callable[Arguments, Made]:
    """Products in bfloat16 or float16 are off by up to a tenth where a difference of large numbers is sought."""

    @wraps(make)
    def exact(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Made:
        with torch.autocast("cpu", enabled=False), torch.autocast("cuda", enabled=False):
            return make(*args, **kwargs)

    return exact


def lasting(make: Callable[Arguments, Made]) -> Callable[Arguments, Made]:
    """What is made once enters graphs later, even where it is first needed in `torch.inference_mode`.

    Nor is it coarser for all that come later where it is first needed in `torch.autocast`.
    """
    return torch.inference_mode(False)(torch.no_grad()(without_autocast(make)))


@contextmanager
def lasting_graph(source: Tensor) -> Iterator[None]:
    """What is made of a tensor here lasts, with its graph where the tensor requires gradients, and is no other where
    it is first needed in `torch.no_grad` or `torch.inference_mode`."""
    with torch.inference_mode(False), torch.set_grad_enabled(source.requires_grad):
        yield


class LastFew(dict[Key, Made]):
    """What was made last, by what it was made of: at most `count` of them, for several threads."""

    def __init__(self, count: int) -> None:
        """Nothing is made yet."""
        super().__init__()
        self.count = count

    def get_or_make(self, key: Key, make: Callable[[], Made]) -> Made:
        """What was made of a key; else it is made now, in the place of the oldest where there are enough."""
        made = self.get(key, _NOTHING)
        if made is _NOTHING:
            made = make()
            for oldest in list(self)[: max(0, len(self) - self.count + 1)]:
                self.pop(oldest, None)  # another thread may have
            self[key] = made
        return made


def on_disk(kind: str, depends: Sequence[object], make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """Named tensors that are made once for what they depend on, with this version and this PyTorch, and read after.

    kind     names a folder of the cache
    depends  numbers, words and lists of them
    A damaged file is made again; where none can be written, the tensors are made every time.
    """
    from safetensors import SafetensorError, safe_open
    from safetensors.torch import save_file

    key = hashlib.sha256(json.dumps([__version__, torch.__version__, *depends]).encode()).hexdigest()
    path = cache_folder() / kind / f"{key[:24]}.safetensors"
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
            known = {name: file.get_tensor(name) for name in sorted(file.keys())}
        if metadata.get("checksum") == _checksum(key, known):
            return known
    except (OSError, SafetensorError):
        pass
    made = {name: tensor.contiguous() for name, tensor in sorted(make().items())}
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with writing(path) as temporary:
            save_file(made, temporary, {"checksum": _checksum(key, made)})
    return made


def _checksum(key: str, tensors: dict[str, Tensor]) -> str:
    digest = hashlib.sha256(key.encode())
    for name, tensor in tensors.items():
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.numpy().data)
    return digest.hexdigest()


class LastMade(Generic[Made]):
    """What was made last of some tensors, until one of them is replaced or written into."""

    def __init__(self) -> None:
        """Nothing is made yet."""
        self._last: tuple[list[tuple[Tensor, int]], Made] | None = None

    def __reduce__(self) -> tuple[type["LastMade[Made]"], tuple[()]]:
        """Copies and pickles hold nothing: their tensors are others."""
        return LastMade, ()

    def get_or_make(self, tensors: Iterable[Tensor], make: Callable[[], Made]) -> Made:
        """What was made of these very tensors, in the state in which they are; else it is made now."""
        states = [(one, 0 if one.is_inference() else one._version) for one in tensors]
        last = self._last  # another thread may replace it
        if last is None or not _are_same(last[0], states):
            last = self._last = states, make()
        return last[1]


def _are_same(before: list[tuple[Tensor, int]], now: list[tuple[Tensor, int]]) -> bool:
    return len(before) == len(now) and all(a is b and v == w for (a, v), (b, w) in zip(before, now, strict=True))
