"""What the file of a picture says beside its colours, for another file of the same picture."""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from torchbrdf.commands._capture import FOV_KEY, MIRROR_KEY, REFLECTANCE_KEY
from torchbrdf.images import (
    DISPLAY_SUFFIXES,
    LONGEST_KEY,
    SPACE_KEYS,
    EnvironmentMap,
    Picture,
    read_environment_map,
    read_metadata,
    read_shooting,
)
from torchbrdf.light import LAMPS_KEY, ROWS_KEY


@dataclass(frozen=True, eq=False)
class Carried:
    """What is beside the colours, and is read of a light probe or a photograph.

    attributes  text, and the camera's numbers; not what names the space that the colours were in
    envmap      how a picture of all directions is laid out; None where the file does not say
    """

    path: Path
    picture: Picture
    attributes: dict[str, str | float]
    envmap: EnvironmentMap | None

    @classmethod
    def of(cls, path: Path, picture: Picture) -> "Carried":
        """Of a picture and its file."""
        is_exr = path.suffix.lower() == ".exr"
        found = read_shooting(path).attributes() | (read_metadata(path) if is_exr else {})
        kept = (key for key in found if len(key.encode()) <= LONGEST_KEY and key not in SPACE_KEYS)
        attributes = {key: found[key] for key in kept}
        return cls(path, picture, attributes, read_environment_map(path) if is_exr else None)

    def kept(self, output: Path) -> dict[str, Any]:
        """What `write_image` takes of it; warns of what is lost, unless the output is for eyes."""
        suffix = output.suffix.lower()
        if suffix == ".exr":
            return {"metadata": self.attributes, "alpha": self.picture.alpha, "envmap": self.envmap}
        if suffix not in DISPLAY_SUFFIXES and (lost := self._lost()):
            text = f"{output}: a {suffix} file does not hold {', '.join(lost)}, which {self.path} does; name it X.exr"
            warnings.warn(text, UserWarning, stacklevel=2)
        return {}

    def _lost(self) -> list[str]:
        """What is read of it, in words."""
        odd = int((~torch.isfinite(self.picture.image).all(0)).sum())
        known = self.attributes.keys()
        found = {
            "how its rows lie (--probe-rows poles)": self.attributes.get(ROWS_KEY) == "poles",
            f"that it is an environment map ({self.envmap})": self.envmap,
            "that no lamp is clipped": LAMPS_KEY in known,
            "what is known of its mirror ball": known & {FOV_KEY, MIRROR_KEY, REFLECTANCE_KEY},
            "the camera's field of view": known & {"nominalFocalLength", "Exif:FocalLengthIn35mmFilm"},
            "alpha, which is a photograph's mask": self.picture.alpha is not None,
            f"that {odd} pixels are not known": odd,
        }
        return [what for what, is_there in found.items() if is_there]
