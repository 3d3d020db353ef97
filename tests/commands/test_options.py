"""Numbers on the command line: what no picture, camera or fit can use is one line that names the option."""

from argparse import ArgumentTypeError

import pytest

from torchbrdf.cli import main, parser
from torchbrdf.commands._options import number, whole_number

GIVEN = {
    "render": ["x.binary", "--probe", "default", "-o", "x.png"],
    "export": ["x.binary", "--probe", "default", "-o", "x"],
    "compare": ["x.binary", "y.binary", "-o", "x.html"],
    "analytic": ["x.binary"],
    "bake": ["--probe", "default", "-o", "x.safetensors"],
    "fit": ["x.exr", "--probe", "default", "-o", "x"],
    "live": [],
    "classes": [],
}
SIZES = [
    (command, ("--size", text)) for command in GIVEN if command != "classes" for text in ("0", "-4", "2", "1e9", "nan")
]
SIZES += [(command, ("--size", "100000")) for command in ("render", "fit")]
SAMPLES = [
    (command, ("--samples", text))
    for command in ("render", "compare", "bake")
    for text in ("0", "1", "-1", "10000000000")
]
EXPOSURES = [("render", ("--exposure", text)) for text in ("nan", "inf", "-inf", "0", "-1", "-1e-3", "much")]
CAMERAS = [
    *(("--fov", text) for text in ("nan", "0", "-45", "180", "1e9")),
    *(("--width", text) for text in ("nan", "inf", "0", "-1")),
    *((name, "0", "0", "0") for name in ("--toward", "--up")),
    *((name, "0", "nan", "1") for name in ("--toward", "--up", "--target")),
    ("--toward", "0", "-inf", "1"),
]
CIRCLES = [
    ("--circle", "nan", "8", "8"),
    ("--circle", "8", "8", "0"),
    ("--circle", "8", "8", "-4"),
    ("--circle", "8", "8", "inf"),
]
REFUSED = [
    *SIZES,
    *SAMPLES,
    *EXPOSURES,
    *((command, camera) for command in ("fit", "export", "bake") for camera in CAMERAS),
    *((command, circle) for command in ("fit", "live") for circle in CIRCLES),
    *(("bake", ("--seed", text)) for text in ("-1", "nan", "99999999999")),
    *(("classes", (name, text)) for name in ("--n-classes", "--n-dims") for text in ("0", "-1", "nan")),
    *(("analytic", ("--most-evaluations", text)) for text in ("0", "-1", "nan")),
    *(("fit", ("--penalty", text)) for text in ("nan", "inf", "-1", "-1e-3")),
]


@pytest.mark.parametrize(
    ("command", "option"), REFUSED, ids=lambda value: value if isinstance(value, str) else " ".join(value)
)
def test_one_line_names_the_option(capsys: pytest.CaptureFixture[str], command: str, option: tuple[str, ...]):
    with pytest.raises(SystemExit) as left:
        main([command, *GIVEN[command], *option])
    assert left.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"torchbrdf: error: argument {option[0]}: ")
    assert " must be " in said or " must not be " in said


@pytest.mark.parametrize(
    ("command", "option", "expected"),
    [
        ("render", ("--exposure", "1e-3"), 1e-3),
        ("render", ("--size", "3"), 3),
        ("export", ("--fov", "179.5"), 179.5),
        ("export", ("--toward", "-1e-3", "-.5", "-1."), [-1e-3, -0.5, -1.0]),
        ("export", ("--target", "0", "0", "0"), [0.0, 0.0, 0.0]),
        ("fit", ("--circle", "-2.5", "8", "1.5"), [-2.5, 8.0, 1.5]),
    ],
)
def test_what_is_meant_is_taken(command: str, option: tuple[str, ...], expected: object):
    options = parser().parse_args([command, *GIVEN[command], *option])
    assert getattr(options, option[0].lstrip("-")) == expected


@pytest.mark.parametrize(
    ("parse", "text", "said"),
    [
        (number(), "inf", "must be a finite number, got inf"),
        (number(0), "0", "must be a finite number above 0, got 0"),
        (number(0, 180), "180", "must be a finite number between 0 and 180, got 180"),
        (whole_number(1), "0", "must be a whole number of at least 1, got 0"),
        (whole_number(3, 8), "2.5", "must be a whole number from 3 to 8, got 2.5"),
    ],
)
def test_what_is_said(parse, text: str, said: str):
    with pytest.raises(ArgumentTypeError, match=f"^{said}$"):
        parse(text)


@pytest.mark.parametrize("command", ["fit", "live", "analytic"])
def test_help_says_what_is_used_without_an_option(capsys, command: str):
    """It said that all of a photograph is used where nothing marks the ball, which is found."""
    with pytest.raises(SystemExit):
        main([command, "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert "default: the photograph's alpha; without one a ball is found, and of another shape all is used" in told
    assert "default: of a photographed ball what the file says, else orthographic" in told
