"""`InputFile`: what a reader is given, sound or mutated."""

from dataclasses import dataclass, replace
from pathlib import Path


@dataclass(frozen=True)
class InputFile:
    """A file to be written.

    name     what is special about it
    suffix   of its path
    content  its first bytes
    length   of the file, bytes; zeros (a hole) follow the content. None: of the content
    patches  (offset, bytes) of what stands in that hole
    """

    name: str
    suffix: str
    content: bytes
    length: int | None = None
    patches: tuple[tuple[int, bytes], ...] = ()

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return len(self.content) if self.length is None else self.length

    def with_content(self, content: bytes) -> "InputFile":
        """The same file with other first bytes."""
        return replace(self, content=content)

    def write(self, path: Path) -> None:
        """Make the file anew: readers may still map what lay there before."""
        path.unlink(missing_ok=True)
        with open(path, "wb") as file:
            file.write(self.content[: self.size])
            for offset, patch in self.patches:
                file.seek(offset)
                file.write(patch)
            file.truncate(self.size)
