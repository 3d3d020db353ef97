"""The materials of a library that is given as folders, files and results of earlier fits: where each lies, its name."""

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from torchbrdf.brdf.merl_directory import table_paths
from torchbrdf.brdf.settings import EMBEDDED, RESULT, RGL_SUFFIX, TABLE_SUFFIXES
from torchbrdf.files import did_you_mean, existing_file


@dataclass(frozen=True)
class Member:
    """One material.

    path  of its table; None where it is of the embedded library
    name  the shortest that tells it from the others: its own, after a slash behind as many folders as that takes
    """

    path: Path | None
    name: str

    @property
    def kind(self) -> str:
        """What its table is."""
        if self.path is None:
            return "embedded"
        if self.path.suffix.lower() == RGL_SUFFIX:
            return "RGL"
        return "fit" if self.path.name == RESULT else "MERL"


def position_among(names: Sequence[str], name: str, where: str) -> int:
    """Where a material stands among names. Raises ValueError with the closest name where it is none, or no text.

    where  it was sought, in the message
    """
    if not isinstance(name, str):
        advice = "; pass a list's names one by one: *names" if isinstance(name, list | tuple) else ""
        raise ValueError(f"the name of a material must be a text, got {name!r}{advice}")
    if name not in names:
        raise ValueError(f"no material {name!r} {where}{did_you_mean(name, names)}")
    return names.index(name)


def check_different(names: Sequence[str]) -> None:
    """Raise ValueError where two materials have the same name."""
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"materials must have different names; twice or more: {', '.join(twice)}")


def library_members(
    sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]], embedded: Sequence[str] = ()
) -> list[Member]:
    """The materials of folders, files, folders that `torchbrdf fit` wrote, and "default", in the order given.

    embedded  names of the embedded library, for "default"
    A table that is named twice counts once, with a warning. Raises as `table_paths`; FileNotFoundError where nothing is
    there, ValueError where a file is no table by its suffix or two in one folder are of one name.
    """
    labels: list[tuple[Path | None, tuple[str, ...]]] = []
    seen: dict[Path, str] = {}
    given = as_list(sources)
    if not given:
        raise ValueError('a library needs files, got none; name folders or files of measured tables, or "default"')
    for source in given:
        if source == EMBEDDED:
            own: list[tuple[Path | None, tuple[str, ...]]] = [(None, (EMBEDDED, name)) for name in embedded]
            labels += [label for label in own if label not in labels]
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


def as_list(sources: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[str]:
    """One path or several: "./default" is the folder, `EMBEDDED` is not. Raises ValueError for an empty one."""
    found = [os.fspath(path) for path in ([sources] if isinstance(sources, str | os.PathLike) else sources)]
    if "" in found:
        raise ValueError('one of the paths of the library is empty; "." is the current folder')
    return found


def _tables(source: Path) -> list[Path]:
    if source.is_dir():
        return table_paths(source)
    if not source.exists():
        existing_file(source, f'a measured table ({", ".join(TABLE_SUFFIXES)}), a folder of them, or "{EMBEDDED}"')
    if source.suffix.lower() not in TABLE_SUFFIXES:
        raise ValueError(
            f"{source}: no measured table by its suffix; a library takes {', '.join(TABLE_SUFFIXES)} files, folders of "
            f'them, folders of `torchbrdf fit`, and "{EMBEDDED}"'
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
