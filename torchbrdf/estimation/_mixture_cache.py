"""What a library's classes are made from, on disk: EM from all its starts takes longer than many photographs."""

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import suppress

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from torchbrdf._version import __version__
from torchbrdf.files import cache_folder, writing


def remembered(depends: Sequence[object], make: Callable[[], dict[str, Tensor]]) -> dict[str, Tensor]:
    """Named tensors that are made once for what they depend on, with this version and this PyTorch, and read after.

    A damaged file is made again; where none can be written, the tensors are made every time.
    """
    key = hashlib.sha256(json.dumps([__version__, torch.__version__, *depends]).encode()).hexdigest()
    path = cache_folder() / "classes" / f"{key[:24]}.safetensors"
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
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode() + tensor.numpy().tobytes())
    return digest.hexdigest()
