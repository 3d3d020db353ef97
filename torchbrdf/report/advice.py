"""What warnings mean and what to do: the words of the report and of docs/warnings.md.

Backquotes are code. Commands begin with `torchbrdf`; the rest of a backquoted text is an option of `torchbrdf fit`.
"""

import re
from dataclasses import dataclass
from html import escape
from typing import Literal, get_args

Topic = Literal[
    "unexplained", "clipped", "clipped-light", "camera", "no-unit", "negative", "reflectance", "too-bright",
    "too-dark", "uncertain", "normals", "gloss", "grazing", "shadow",
    "class", "oscillation", "clamped", "dark-middle",
]  # fmt: skip
TOPICS: tuple[Topic, ...] = get_args(Topic)
"""In the order of docs/warnings.md: what is wrong with the capture, what the light leaves open, marks of the result."""


@dataclass(frozen=True)
class Advice:
    """What a warning means, and what to do.

    title    names it in a few words
    actions  what helps most, as clauses of a sentence; none where there is nothing to do but look
    meaning, remedy  a paragraph each
    page     of docs/, with the heading that says more
    heading  its words
    """

    title: str
    actions: tuple[str, ...]
    meaning: str
    remedy: str
    page: str
    heading: str

    @property
    def anchor(self) -> str:
        """Of the paragraph, in the report and in docs/warnings.md: the title as Markdown makes an anchor of it."""
        return re.sub(r"[^\w -]", "", self.title.lower()).replace(" ", "-")


ADVICE: dict[Topic, Advice] = {
    "unexplained": Advice(
        "Much of the photograph is unexplained",
        (
            "fit again with `--align`",
            "mask reflections of things near by",
            "try `--robust`",
            "check that the probe is of the photograph's room, and `--fov` that of its camera",
        ),
        "No material that the library can make looks like the photograph under this light. As a rule the light is "
        "not the one that the ball saw: a probe turned by two degrees makes the error five times as large. Clipped "
        "highlights come next. Where the library lacks the kind of material, such as one that is anisotropic, "
        "textured or translucent, it cannot be explained at all.",
        "Where more than half is unexplained, the probe is likely that of another room, or mirrored. Else look at the "
        "difference of fit and photograph. Red and blue side by side along highlights and the horizon: "
        "the probe is turned, `--align` finds by how much. Red in the middle of highlights: they are clipped; mask "
        "them, or merge a shorter exposure. A ring along the rim: the silhouette is another; give `--circle`, or "
        "`--fov` of the camera. Spots: mask them, or let `--robust` find them.",
        "capture_guide.md#what-a-defect-costs",
        "Capture guide: what a defect costs",
    ),
    "clipped": Advice(
        "Highlights look clipped",
        (
            "mask the clipped highlights, or merge a shorter exposure with `torchbrdf merge`",
        ),
        "Several pixels are exactly as bright as the brightest, and the fit is brighter there. So looks a highlight "
        "that the camera could not record. Clipped pixels that are used say that the highlight is lower and broader "
        "than it is, and cost more than any other defect but a turned probe.",
        "Merge exposures of which the shortest is clipped nowhere on the ball. Or mask the pixels, or mark them in "
        "the photograph as infinite; without them the rest of the highlight still tells its shape. `--robust` finds "
        "most of them.",
        "capture_guide.md#what-a-defect-costs",
        "Capture guide: what a defect costs",
    ),
    "clipped-light": Advice(
        "The light probe is clipped",
        (
            "take shorter exposures of the light, too, and merge them; a panorama of 8 bits does not do",
            "let `--align` find the radiance of clipped lamps",
        ),
        "The brightest part of the probe is of one value, which is that of the file or of the camera and not of the "
        "light. Lamps and windows give most of the light of a room: without what is lost of them the BRDF comes out "
        "too bright, and its highlights are those of another light.",
        "Merge exposures of the mirror ball or the panorama of which the shortest is clipped nowhere. Where only lamps "
        "are clipped, `--align` finds their radiance by what they light, one factor for all.",
        "capture_guide.md#the-probe",
        "Capture guide: the probe",
    ),
    "camera": Advice(
        "The camera is not known",
        (
            "give `--fov`, the field of view of the whole photograph, or `--focal-mm` with `--sensor-mm`",
        ),
        "From close by a camera sees less than half of a ball, and off the middle of the picture it sees it from "
        "another side and as an ellipse. Without a field of view the ball is taken as seen from infinity, straight "
        "ahead. The result then explains the photograph with reflections that are off by several degrees, which other "
        "light shows.",
        "Give the horizontal field of view of the whole photograph, not of a crop, or focal length and sensor width. "
        "Cameras write it into their files, and programs that edit these may drop it. For a lens far away, or of a "
        "picture that was rendered without perspective, nothing is lost.",
        "capture_guide.md#the-photograph",
        "Capture guide: the photograph",
    ),
    "no-unit": Advice(
        "The photograph has no unit",
        (
            "give the photograph in floating point, exposed and scaled as the probe is",
            "`--align --exposure` finds the factor, roughly",
        ),
        "Files of whole numbers, of 8 or 16 bits, hold shares of the largest number. What that stands for no program "
        "can know, so photograph and probe differ by a factor, and the BRDF by the same one. Its shape, its colour and "
        "its gloss may be right; how much it reflects is not measured.",
        "Have the raw file converted to floating point, by `torchbrdf merge` or another program that does not scale "
        "it, with the exposure of the probe. A grey card in both tells the factor. `--align --exposure` finds one, "
        "roughly.",
        "inputs.md",
        "Input files",
    ),
    "negative": Advice(
        "Radiance below zero",
        (
            "develop the photograph with its black level, so that black is 0",
        ),
        "No radiance is below zero. Pixels that are tell that more was subtracted than the sensor's black level, or "
        "that colours lie outside those that the file can hold. Then dark parts of the shape, which tell of grazing "
        "light and of what is reflected sideways, are too dark, too.",
        "Have the raw file developed by a program that takes the black level from it, such as `torchbrdf merge`, and "
        "subtract nothing more. A few pixels of noise about 0 do no harm, and `--mask` leaves out those that do.",
        "capture_guide.md#the-photograph",
        "Capture guide: the photograph",
    ),
    "reflectance": Advice(
        "The reflectance of the mirror ball is not known",
        (
            "give `--mirror-reflectance`, the share of the light that the mirror ball reflects",
        ),
        "The mirror ball is taken to reflect all light that falls on it, and polished chrome reflects 0.55 to 0.7 of "
        "it. The probe is then too dim by that factor, and the BRDF too bright by it; its shape and its gloss may be "
        "right.",
        "Give `--mirror-reflectance` to the command that reads the mirror ball, one number or one for each of red, "
        "green and blue: 0.6 for chrome, 1 for a simulated ball that reflects all. `torchbrdf probe --metal` takes it "
        "from the metal's optical constants.",
        "capture_guide.md#a-mirror-ball",
        "Capture guide: a mirror ball",
    ),
    "too-bright": Advice(
        "More light comes out than goes in",
        (
            "bring photograph and probe to the same units, with exposure times, aperture and ISO of both",
        ),
        "The BRDF reflects more light than arrives, which no material does. The photograph is too bright for the "
        "probe, or the probe too dark: one of them was scaled, or exposed otherwise, or lamps are clipped in the "
        "probe. The BRDF is off by the same factor; its shape may be right.",
        "Take photograph and probe with one exposure, or divide each by its exposure time, and by its ISO, and "
        "multiply it by the square of its f-number. A grey card in both tells the factor. A mirror ball as the "
        "probe reflects 60 % of the light: `torchbrdf probe --mirror-reflectance 0.6`. `--align --exposure` finds a "
        "factor, roughly.",
        "capture_guide.md#the-probe",
        "Capture guide: the probe",
    ),
    "too-dark": Advice(
        "Hardly any light comes out",
        (
            "bring photograph and probe to the same units, with exposure times, aperture and ISO of both",
        ),
        "The BRDF reflects less of the light than any ordinary material: black paint returns a twentieth, black "
        "cloth a hundredth. The photograph is too dark for the probe: one of them was scaled, or exposed otherwise, or "
        "is in other units. The BRDF is off by the same factor; its shape may be right.",
        "As where more light comes out than goes in: take photograph and probe with one exposure, or divide each by "
        "its exposure time, and by its ISO, and multiply it by the square of its f-number. A grey card in both tells "
        "the factor. Only a coating made to trap light is as dark: then leave it.",
        "capture_guide.md#the-probe",
        "Capture guide: the probe",
    ),
    "uncertain": Advice(
        "Uncertain under other light",
        (
            "take a second photograph from another side or under another light, and fit both with "
            "`--same-material`; `torchbrdf observe --probe PROBE --suggest` says which one",
        ),
        "Many BRDFs explain this photograph, and they look different under other light. What the result shows there "
        "comes from what the library's materials have in common, not from the photograph.",
        "Take a second photograph of the ball, with the camera gone round it or under another light. `torchbrdf "
        "observe --suggest` rehearses which one helps most. Give both to `torchbrdf fit --same-material`, each with "
        "its `--probe`. More pixels help where a mask leaves few.",
        "uncertainty.md#before-any-photograph",
        "Uncertainty: before any photograph",
    ),
    "normals": Advice(
        "Too few normals",
        (
            "photograph a ball of the material, or another shape that is curved both ways",
        ),
        "The shape turns too few of its normals towards the camera. Each pixel then sees nearly the same cells of "
        "the BRDF, and what is left is the library's guess.",
        "Photograph a ball, or a shape that is curved both ways. A plane, a cube and a cylinder do not do.",
        "known_shapes.md#shapes-that-show-few-normals",
        "Known shapes: shapes that show few normals",
    ),
    "gloss": Advice(
        "This light does not tell gloss",
        (
            "photograph under light with edges or small bright lamps; `torchbrdf observe --probe PROBE --suggest` "
            "says which lamp or second photograph helps most",
        ),
        "Gloss is seen in how an edge of the light is blurred. This light is so even that a glossy and a matt "
        "material of one albedo look nearly alike under it. That holds for any material and any photograph under "
        "it, however well it is fitted.",
        "Use a room with windows and lamps, or a street; not an overcast sky, a tent or an integrating sphere. "
        "`torchbrdf observe --suggest` compares what a lamp or a second photograph would add.",
        "capture_guide.md#the-light",
        "Capture guide: the light",
    ),
    "grazing": Advice(
        "No light from behind",
        (
            "grazing reflection is a guess: add a photograph with the camera gone round to the other side, fitted "
            "together by `--same-material`",
        ),
        "Reflection at grazing angles, where nearly every material becomes a mirror, shows along the rim of the "
        "ball, and only if there is light behind it. Here there is little, so the rim under other light is the "
        "library's guess.",
        "Take a second photograph with the camera gone round the ball, so that the lights are behind it, and give "
        "both to `torchbrdf fit --same-material`. Or put a lamp behind the ball, outside the picture. Leave the rim "
        "in the mask.",
        "uncertainty.md#before-any-photograph",
        "Uncertainty: before any photograph",
    ),
    "shadow": Advice(
        "Much lies in shadow",
        (
            "add light from other sides, or a second photograph with the camera gone round, fitted together by "
            "`--same-material`",
        ),
        "No light reaches a part of the picture. A single lamp shows one slice of the BRDF, a single angle between "
        "light and camera, and a probe that is off by a degree then spoils all of it.",
        "Add light from other sides, if only from white walls. Or take more photographs with the camera gone round "
        "the ball, each with its probe, and give all to `torchbrdf fit --same-material`.",
        "capture_guide.md#the-light",
        "Capture guide: the light",
    ),
    "class": Advice(
        "The class is not told",
        (),
        "The library's materials are sorted into classes, from dull to mirror-like, and this photograph fits "
        "several. The result averages them by their probabilities; with a fixed penalty it is that of the best one "
        "alone. Three photographs in ten are like that, and the result need not be worse for it.",
        "Compare the candidates of the classes in the report. Where they look alike, it does not matter. Where "
        "their highlights differ, a light with sharper edges or a second photograph decides.",
        "uncertainty.md#classes",
        "Uncertainty: classes",
    ),
    "oscillation": Advice(
        "Weights cancel each other",
        (),
        "The result is a small difference of large materials. With a small fixed penalty, or none, such weights fit "
        "the photograph, noise included, and little else.",
        "Take a larger penalty, or the default, whose averages are no further off for such weights than their standard "
        "deviations say. Look for rings and spots under directional lights.",
        "constraints.md",
        "Constraints",
    ),
    "clamped": Advice(
        "Negative values were cut off",
        (
            "if black spots or rings show under directional lights, fit again with `--constraint lobes`",
        ),
        "A combination of measured BRDFs with weights of both signs can be negative in some cells, which no "
        "material is. They are set to zero. That changes nothing where the photograph looks, and may leave dark "
        "spots or rings elsewhere.",
        "Look for black spots and rings in the pictures under directional lights. `--constraint lobes`, which `fit` "
        "takes unless another or a penalty is given, finds the nearest BRDF whose highlights have none; "
        "`--constraint energy` one that is nowhere negative.",
        "constraints.md#when-each-helps",
        "Constraints: when each helps",
    ),
    "dark-middle": Advice(
        "Highlights are dark in their middle",
        (
            "for use under lamps and the sun, fit again with `--constraint lobes`",
        ),
        "A photograph under a probe tells highlights no finer than its pixels and lamps are wide. What the last degree "
        "about the mirror direction is made of it leaves open, and a combination of sharper materials with weights of "
        "both signs may be darker there than beside it, or black. Pictures under a probe do not show it. Under a point "
        "light it is a dark spot in a bright ring.",
        "`--constraint lobes`, which `fit` takes unless another or a penalty is given, finds the nearest BRDF whose "
        "highlights fall off from their middle; in Python it is `BRDFEstimator(basis, classes, constraint=\"lobes\", "
        "library=library)`. Its tables are nearer to measured ones there, and its pictures as good. A photograph under "
        "smaller lamps, with more pixels, tells more of the middle.",
        "constraints.md#highlights",
        "Constraints: highlights",
    ),
}


def marked(text: str) -> str:
    """HTML of words with `code`, whose options stay whole at the end of a line."""
    code = re.sub("`([^`]*)`", r"<code>\1</code>", escape(text, quote=False))
    return re.sub(r"(?<![\w-])--[\w-]+", r"<span>\g<0></span>", code)
