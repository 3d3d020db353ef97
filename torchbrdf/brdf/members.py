"""The materials of a library that is given as folders, files and results of earlier fits: where each lies, its name."""

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torchbrdf.brdf.merl_directory import RESULT, TABLE_SUFFIXES, table_paths

EMBEDDED = "default"
"""Names the embedded library among files."""


@dataclass(frozen=True)
class Member:
    """One material.

    path  of its table; None where it is of the embedded library
    name  the shortest that tells it from the others: its own, after a slash behind as many folders as that takes
    """

    path: Path | None
    name: str


def library_members(
    sources: Sequence[str | os.PathLike[str]], embedded: Sequence[str] = (), progress: bool = False
) -> list[Member]:
    """The materials of folders, files, folders that `torchbrdf fit` wrote, and "default", in the order given.

    embedded  names of the embedded library, for "default"
    A table that is named twice counts once, with a warning. Raises as `table_paths`; FileNotFoundError where nothing
    is there, ValueError where a file is no table by its suffix or two in one folder are of one name.
    """
    labels: list[tuple[Path | None, tuple[str, ...]]] = []
    seen: dict[Path, str] = {}
    if not sources:
        raise ValueError('a library needs files, got none; name folders or files of measured tables, or "default"')
    for source in sources:
        if str(source) == EMBEDDED:
            if (None, (EMBEDDED, embedded[0])) not in labels:
                labels += [(None, (EMBEDDED, name)) for name in embedded]
            continue
        for path in _tables(Path(source)):
            resolved = path.resolve()
            if resolved in seen:
                text = f"{path}: the same file as {seen[resolved]}, which counts once"
                warnings.warn(text, UserWarning, stacklevel=3)
                continue
            seen[resolved] = str(path)
            labels.append((path, _label(path)))
    return [Member(path, name) for (path, _), name in zip(labels, _kept_apart(labels), strict=True)]


def _tables(source: Path) -> list[Path]:
    if source.is_dir():
        if (source / RESULT).is_file():
            others = [path for path in table_paths(source) if path.name != RESULT]
            return [source / RESULT, *others] if others else [source / RESULT]
        fits = sorted(source.glob(f"*/{RESULT}"))
        below = [path for path in source.iterdir() if path.suffix.lower() in TABLE_SUFFIXES]
        return fits if fits and not below else table_paths(source)
    if source.exists() and source.suffix.lower() not in TABLE_SUFFIXES:
        raise ValueError(
            f"{source}: no measured table by its suffix; a library takes {', '.join(TABLE_SUFFIXES)} files, folders of "
            f'them, folders of `torchbrdf fit`, and "{EMBEDDED}"'
        )
    if not source.exists():
        raise FileNotFoundError(
            f"{source}: no such file or directory; expected a measured table ({', '.join(TABLE_SUFFIXES)}), a folder "
            f'of them, or "{EMBEDDED}"'
        )
    return [source]


def _label(path: Path) -> tuple[str, ...]:
    """The folders of a table and its name, which is that of its folder where `torchbrdf fit` wrote it."""
    path = path.absolute()
    return path.parent.parts if path.name == RESULT else (*path.parent.parts, path.stem)


def _kept_apart(labels: Sequence[tuple[Path | None, tuple[str, ...]]]) -> list[str]:
    """The last parts of every label, one where that is of one material, else as many as tell it from the others."""
    alike: dict[str, list[int]] = {}
    for i, (_, parts) in enumerate(labels):
        alike.setdefault(parts[-1], []).append(i)
    names = [parts[-1] for _, parts in labels]
    for group in alike.values():
        whole = [labels[i][1] for i in group]
        if len(set(whole)) < len(whole):
            first, second = (labels[i][0] for i in group if whole.count(labels[i][1]) > 1)
            raise ValueError(f"{first} and {second}: are of one name in one folder; name one of them, or rename one")
        length = 1
        while len({parts[-length:] for parts in whole}) < len(whole):
            length += 1
        for i, parts in zip(group, whole, strict=True):
            names[i] = "/".join(parts[-length:])
    return names
