"""Facts about a version of torchbrdf by name, kept with what measures a difference between two of them."""

import hashlib
import importlib.metadata
import json
import platform
import re
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

TEXTS = (".html", ".json", ".mtlx", ".py", ".txt", ".xml")
"""Suffixes of files that are compared as text."""

RAISED = "raised"
PACKAGES = ("torch", "numpy", "scipy", "mitsuba", "OpenEXR", "opencv-python-headless", "kornia", "trimesh")

VERSION = re.compile(r"(?<=torchbrdf )\d+\.\d+\.\d+")
"""Hidden, because it is what shall differ: in what `torchbrdf --version` prints and in the generator of a .glb."""

_EVERY = 101
"""One in so many values of a library's columns, 0.9 GB, is kept to measure a difference by."""

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_SHOWN = 70


@dataclass(frozen=True)
class Fact:
    """One thing that is to be the same.

    digest  sha256 of its bytes, with dtype and shape of an array
    text    itself, where it is text
    values  the file in the folder of values that holds its numbers, where it is none
    """

    digest: str
    text: str | None = None
    values: str | None = None


@dataclass(frozen=True)
class Facts:
    """What one process wrote down."""

    version: str
    location: str
    facts: dict[str, Fact]

    @classmethod
    def read(cls, path: Path) -> "Facts":
        """What `Record.write` wrote."""
        stored = json.loads(path.read_text())
        return cls(stored["version"], stored["location"], {name: Fact(**one) for name, one in stored["facts"].items()})

    def only(self, section: str) -> "Facts":
        """The facts of one section."""
        inside = {name: fact for name, fact in self.facts.items() if name.startswith(f"{section}/")}
        return Facts(self.version, self.location, inside)

    def failures(self) -> dict[str, str]:
        """What sections raised: that is no result, even where both versions do."""
        return {name: fact.text or "" for name, fact in self.facts.items() if name.endswith(f"/{RAISED}")}


class Record:
    """Collects facts; numbers go to a folder, each under the hash of what it holds."""

    def __init__(self, values: Path) -> None:
        """Begin with what surrounds the package."""
        values.mkdir(exist_ok=True)
        self._values, self._facts = values, dict[str, Fact]()
        self.add("environment/python", platform.python_version())
        for package in PACKAGES:
            self.add(f"environment/{package}", importlib.metadata.version(package))

    def run(self, sections: Mapping[str, Callable[["Record"], None]]) -> None:
        """Write down one section after the other; what one raises is written down, too."""
        for name, section in sections.items():
            began = time.monotonic()
            try:
                section(self)
            except Exception as error:
                traceback.print_exc()
                self.add(f"{name}/{RAISED}", f"{type(error).__name__}: {error}")
            print(f"  {name}: {time.monotonic() - began:.1f} s", file=sys.stderr, flush=True)

    def add(self, name: str, value: Any) -> None:
        """Write down a text, numbers, a file, or each of several by name."""
        import torch

        if isinstance(value, Mapping):
            for key, one in value.items():
                self.add(f"{name}/{key}", one)
        elif isinstance(value, list | tuple) and any(isinstance(one, torch.Tensor) for one in value):
            self.add(name, {str(i): one for i, one in enumerate(value)})
        elif isinstance(value, Path):
            self._add_file(name, value)
        elif isinstance(value, torch.Tensor | np.ndarray | float):
            array = value.detach().cpu().contiguous().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
            self._put(name, Fact(_digest(array), values=self._keep(array)))
        else:
            text = value if isinstance(value, str) else repr(value)
            self._put(name, Fact(hashlib.sha256(text.encode()).hexdigest(), text=text))

    def _add_file(self, name: str, path: Path) -> None:
        content = path.read_bytes()
        if path.suffix == ".glb":
            content = VERSION.sub("VERSION", content.decode("latin-1")).encode("latin-1")
        if path.suffix == ".safetensors":  # it writes the metadata in another order in every process
            end = 8 + int.from_bytes(content[:8], "little")
            content = json.dumps(json.loads(content[8:end]), sort_keys=True).encode() + content[end:]
        digest = hashlib.sha256(content).hexdigest()
        if path.suffix in TEXTS:
            self._put(name, Fact(digest, text=content.decode()))
        else:
            self._put(name, Fact(digest, values=self._keep(numbers_in(path))))

    def _put(self, name: str, fact: Fact) -> None:
        if name in self._facts:
            raise KeyError(f"two facts have the name {name}")
        self._facts[name] = fact

    def _keep(self, array: np.ndarray) -> str:
        key = _digest(array)
        if not (self._values / f"{key}.npy").exists():
            np.save(self._values / f"{key}.npy", array)
        return key

    def write(self, path: Path) -> None:
        """Write the facts, with the version and where it is."""
        import torchbrdf

        facts = {name: asdict(fact) for name, fact in self._facts.items()}
        location = str(Path(torchbrdf.__file__).resolve().parent)
        path.write_text(json.dumps({"version": torchbrdf.__version__, "location": location, "facts": facts}))


def _digest(array: np.ndarray) -> str:
    return hashlib.sha256(f"{array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes()).hexdigest()


def numbers_in(path: Path) -> np.ndarray:
    """The numbers of a file, by which a difference is measured: radiance, f_r, tensors; else its bytes."""
    import torch
    from safetensors.torch import load_file

    import torchbrdf

    match path.suffix:
        case ".binary":
            return np.fromfile(path, "<f8", offset=12)
        case ".exr" | ".hdr" | ".png":
            return torchbrdf.read_image(path, allow_ldr=True).numpy()
        case ".safetensors":
            tensors = load_file(path)
            return torch.cat([tensors[key].double().ravel() for key in sorted(tensors)]).numpy()
        case ".f16":
            return np.fromfile(path, np.float16)[::_EVERY]
        case _:
            return np.fromfile(path, np.uint8)


def differences(old: Facts, new: Facts, values: Path) -> dict[str, str]:
    """For every fact in either: how it differs, or an empty text."""
    names = [*old.facts, *(name for name in new.facts if name not in old.facts)]
    return {name: _difference(old.facts.get(name), new.facts.get(name), values) for name in names}


def _difference(old: Fact | None, new: Fact | None, values: Path) -> str:
    if old is None or new is None:
        return "only in the new version" if old is None else "missing in the new version"
    if old.digest == new.digest:
        return ""
    if old.text is not None and new.text is not None:
        return _between_texts(old.text, new.text)
    if old.values is None or new.values is None:
        return "text in one version, numbers in the other"
    return between_numbers(*(np.load(values / f"{fact.values}.npy") for fact in (old, new)))


def _between_texts(old: str, new: str) -> str:
    """The first place that differs; where only numbers differ, how much."""
    at = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), min(len(old), len(new)))
    start = max(0, at - 20)
    place = " -> ".join(repr(text[start : start + _SHOWN]) for text in (old, new))
    if _NUMBER.sub("", old) == _NUMBER.sub("", new):
        numbers = (np.array(_NUMBER.findall(text), dtype=float) for text in (old, new))
        return f"{between_numbers(*numbers)}; first {place}"
    return f"first {place}"


def between_numbers(old: np.ndarray, new: np.ndarray) -> str:
    """How far two arrays are apart."""
    if (old.shape, old.dtype) != (new.shape, new.dtype):
        return f"{old.dtype} {old.shape} -> {new.dtype} {new.shape}"
    a, b = (array.astype(np.float64).ravel() for array in (old, new))
    differ = ~((a == b) | (np.isnan(a) & np.isnan(b)))
    if not differ.any():
        return "other bytes; the numbers that were kept are the same"
    a, b = a[differ], b[differ]
    with np.errstate(all="ignore"):
        distance = np.abs(a - b)
        relative = distance / np.maximum(np.abs(a), np.abs(b))
    return f"{len(a)} of {old.size} numbers, by at most {distance.max():.3g}, relative {relative.max():.3g}"


def table(rows: Mapping[str, str], every: bool) -> str:
    """What | same to the last bit, or how it differs: a line a group of facts, and one for each that differs."""
    groups = dict[str, list[str]]()
    for name in rows:
        groups.setdefault(name.partition("/")[0], []).append(name)
    width = max(map(len, groups)) + 2
    lines = [f"{'what':<{width}}{'facts':>6}  ", "-" * (width + 40)]
    for group, names in groups.items():
        wrong = [name for name in names if rows[name]]
        verdict = f"{len(wrong)} DIFFER" if wrong else "same to the last bit"
        lines.append(f"{group:<{width}}{len(names):>6}  {verdict}")
        shown = names if every else wrong
        lines += [f"    {name.removeprefix(group + '/')}: {rows[name] or 'same to the last bit'}" for name in shown]
    total = sum(map(bool, rows.values()))
    lines += ["-" * (width + 40), f"{'all':<{width}}{len(rows):>6}  "]
    lines[-1] += f"{total} DIFFER" if total else "same to the last bit"
    return "\n".join(lines)
