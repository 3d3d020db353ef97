"""A table, a light probe and a view as a folder that Mitsuba renders: `scene.xml` and the files that it names."""

import os
from pathlib import Path
from string import Template

from torchbrdf.brdf import MerlTable
from torchbrdf.files import writing_folder
from torchbrdf.light import LightProbe
from torchbrdf.mitsuba_backend.scenes import framing_of
from torchbrdf.view import MeshView, View

SCENE, RENDER_SCRIPT, README = "scene.xml", "render.py", "README.txt"
BRDF, PROBE, MESH = "brdf.binary", "probe.exr", "mesh.ply"

_SCENE = Template("""\
<?xml version="1.0" encoding="utf-8"?>
<!-- Written by torchbrdf. The plugin "merl" must be registered before this file is loaded: see render.py. -->
<scene version="3.0.0">
    <!-- Light that is reflected once, as torchbrdf renders; type="path" adds what the shape reflects onto itself. -->
    <integrator type="direct">
        <boolean name="hide_emitters" value="true"/>
    </integrator>

    <sensor type="$camera">
$fov        <float name="near_clip" value="$near"/>
        <float name="far_clip" value="$far"/>
        <transform name="to_world">
$scale            <lookat origin="$origin" target="$target" up="$up"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$width"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="rgb"/>
            <string name="component_format" value="float32"/>
            <rfilter type="box"/>
        </film>
        <sampler type="independent"/>
    </sensor>

    <!-- Lat-long, linear RGB, +Y up. -->
    <emitter type="envmap">
        <string name="filename" value="$probe"/>
    </emitter>

$shape
        <bsdf type="merl">
            <string name="filename" value="$brdf"/>
        </bsdf>
    </shape>
</scene>
""")

_SPHERE = '    <shape type="sphere">'
_MESH = f"""\
    <shape type="ply">
        <string name="filename" value="{MESH}"/>"""

_RENDER = f'''\
"""Render {SCENE} to image.exr and image.png, with torchbrdf and Mitsuba: python {RENDER_SCRIPT}"""

import argparse
from pathlib import Path

import numpy as np
import torch

from torchbrdf.images import exposure_for
from torchbrdf.mitsuba_backend import load_mitsuba, register_merl

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--samples", type=int, default=256, help="a pixel; default: 256")
parser.add_argument("--seed", type=int, default=0)
text = "factor on the radiance in image.png; default: that which makes the shape's 99th percentile white"
parser.add_argument("--exposure", type=float, help=text)
options = parser.parse_args()

folder = Path(__file__).resolve().parent
mi = load_mitsuba()
register_merl()
scene = mi.load_file(str(folder / "{SCENE}"))
image = mi.render(scene, spp=options.samples, seed=options.seed)
mi.util.write_bitmap(str(folder / "image.exr"), image, write_async=False)
exposure = options.exposure
if exposure is None:
    pixels = torch.from_numpy(np.array(image)).permute(2, 0, 1)
    exposure = exposure_for(pixels, pixels.amax(0, keepdim=True) > 0)  # the light beside the shape is hidden
mi.util.write_bitmap(str(folder / "image.png"), exposure * image, write_async=False)
print(f"wrote {{folder / 'image.exr'}}, and image.png, radiance times {{exposure:.3g}}")
'''

_README = Template(f"""\
A recovered BRDF as a scene for Mitsuba 3, written by torchbrdf.

    python {RENDER_SCRIPT}

writes image.exr (linear radiance) and image.png (display values), with torchbrdf and Mitsuba installed. In
image.png radiance is multiplied by what makes the shape's 99th percentile white, as `torchbrdf render` has it, or by
--exposure; the factor is printed. --samples, of a pixel, and --seed are for the noise.

{SCENE:<14} camera, light, shape and material; edit it freely. Paths in it are relative to it
{BRDF:<14} the material, a table in MERL format: $material
{PROBE:<14} the light: $light
$mesh
In a scene of your own, after mitsuba.set_variant:

    from torchbrdf.mitsuba_backend import register_merl
    register_merl()

Then <bsdf type="merl"><string name="filename" value="{BRDF}"/></bsdf> is a material like any other.
The light may be any emitter of Mitsuba's. Other renderers that read MERL files take {BRDF} as it is.

View: $view
""")


def export_scene(table: MerlTable, probe: LightProbe, view: View, folder: str | os.PathLike[str]) -> list[Path]:
    """Write a folder with a Mitsuba scene of a material, and a script that renders it with `python render.py`.

    table   the material, for one: `result.brdf(library)` of a reconstruction
    view    a SphereView or a MeshView: the shape and the camera
    folder  gets scene.xml, brdf.binary, probe.exr, render.py, README.txt, and mesh.ply of a MeshView; whole or absent
    The scene renders what `torchbrdf.render` gives, light that is reflected once, always with the shadows that a mesh
    casts on itself. Returns the paths of these files. Raises ValueError for a view without a shape, OSError where the
    folder cannot be written.
    """
    scene = scene_xml(view)
    with writing_folder(folder) as temporary:
        _write_text(temporary / SCENE, scene)
        _write_text(temporary / RENDER_SCRIPT, _RENDER)
        mesh = f"{MESH:<14} the shape: {view.mesh.name}\n" if isinstance(view, MeshView) else ""
        words = {"material": table.name, "light": probe.name, "view": repr(view), "mesh": mesh}
        _write_text(temporary / README, _README.substitute(words))
        table.save(temporary / BRDF)
        probe.save(temporary / PROBE)
        if isinstance(view, MeshView):
            view.mesh.save(temporary / MESH)
        names = sorted(os.listdir(temporary))
    return [Path(folder) / name for name in names]


def scene_xml(view: View) -> str:
    """The text of scene.xml; the same camera, light and shape as `MitsubaScene` has for the view."""
    framing = framing_of(view)
    fov_deg = framing.fov_deg
    height, width = view.size
    half = repr(framing.half_width)
    fov = f'        <float name="fov" value="{fov_deg!r}"/>\n        <string name="fov_axis" value="x"/>\n'
    return _SCENE.substitute(
        camera="orthographic" if fov_deg is None else "perspective",
        fov="" if fov_deg is None else fov,
        scale=f'            <scale x="{half}" y="{half}" z="1"/>\n' if fov_deg is None else "",
        near=repr(1e-3 * framing.distance),
        far=repr(1e3 * framing.distance),
        origin=_triple((framing.target + framing.distance * framing.back).tolist()),
        target=_triple(framing.target.tolist()),
        up=_triple(framing.top.tolist()),
        width=width,
        height=height,
        probe=PROBE,
        brdf=BRDF,
        shape=_MESH if isinstance(view, MeshView) else _SPHERE,
    )


def _triple(values: list[float]) -> str:
    return ", ".join(repr(value) for value in values)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")
