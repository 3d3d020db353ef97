"""The facts that the command line gives: help, files, what is printed, exit statuses, messages about bad input."""

import io
import re
import signal
import subprocess
import sys
import urllib.request
import warnings
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import torch

import torchbrdf as tb
from torchbrdf.cli import main
from versions.python import LIBRARY, numbers, scene, views
from versions.record import RAISED, VERSION, Record

PROGRAM = [sys.executable, "-m", "torchbrdf.cli"]

PROGRESS = re.compile(r"[^\r\n]*\d+%\|[^\r\n]*|\r|^ +(?=\r|$)", re.MULTILINE)
"""Progress bars, hidden in what goes to standard error: how often they are drawn depends on the clock."""

SECONDS = re.compile(r"\d+\.\d(?= s$)", re.MULTILINE)
"""Hidden in the one line of `torchbrdf analytic` that tells how long a fit took."""

ADDRESS = re.compile(r"(?<=127\.0\.0\.1:)\d+")
"""The port of `torchbrdf live`, hidden: the system gives any that is free."""


def called(command: str) -> dict[str, str]:
    """What a command prints and its exit status."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        try:
            status: object = main(command.split())
        except SystemExit as stopped:
            status = stopped.code
    printed = SECONDS.sub("SECONDS", VERSION.sub("VERSION", out.getvalue()))
    return {"status": str(status), "out": printed, "err": PROGRESS.sub("", err.getvalue()).strip()}


def help_texts(record: Record) -> None:
    """The help of the program and of each command, which tells options, choices, defaults and what is required."""
    text = called("--help")["out"]
    names = re.findall(r"^    (\w+)(?: |$)", text.partition("COMMAND")[2].partition("\noptions:")[0], re.MULTILINE)
    record.add("help/names of the commands", " ".join(sorted(names)))
    record.add("help/version", called("--version"))
    module = subprocess.run([*PROGRAM, "--help"], capture_output=True, text=True, check=True)
    record.add("help/of python -m torchbrdf.cli", module.stdout)
    record.add("help", {name: called(f"{name} --help") for name in names})


COMMANDS = {
    "demo": "demo -o demo",
    "fit": "fit demo/photograph.exr --probe default --size 48 --uncertainty -o fitted",
    "fit, aligned": "fit demo/photograph.exr --probe default --library merl --align --exposure -o aligned",
    "fit, masked": "fit ball.exr --probe probe.exr --library merl --mask mask.png --size 20 --circle 12 12 11 "
    "--robust --constraint energy -o masked",
    "fit, normals": "fit bumps.exr --probe probe.exr --library merl --view normals.exr --penalty paper -o bumps",
    "bake": "bake --probe probe.exr --library merl --view torus.ply --size 20 --samples 64 -o baked.safetensors",
    "fit, baked": "fit torus.exr --probe probe.exr --library merl --view torus.ply --basis baked.safetensors -o torus",
    "render, exr": "render demo/brdf.binary --probe probe.exr --size 48 --samples 256 -o rendered.exr",
    "render, hdr": "render demo/brdf.binary --probe square.exr --probe-layout angular --size 48 -o rendered.hdr",
    "render, png": "render demo/brdf.binary --probe default --size 48 --exposure 0.5 -o rendered.png",
    "compare": "compare demo merl/alum-bronze.binary --size 96 -o page.html",
    "analytic": "analytic fitted --model ward --metric image",
    "analytic, gltf": "analytic demo --model ggx -o ball.glb --preview glb.png --size 32",
    "analytic, other gltf": "analytic demo --model metallic-roughness -o other.glb --preview other.hdr --size 32",
    "analytic, Mitsuba": "analytic demo --model principled -o ball.xml --preview xml.exr --size 32",
    "analytic, Mitsuba json": "analytic demo --model ward -o ball.json",
    "analytic, MaterialX": "analytic demo --model ggx --separate -o ball.mtlx --preview mtlx.png --size 32",
    "analytic, OpenPBR": "analytic demo --model ggx --format openpbr -o open.mtlx",
    "analytic, table": "analytic demo --model cook-torrance -o table.binary --preview table.png --size 32",
    "export": "export demo/brdf.binary --probe probe.exr --size 64 -o scene",
    "export, mesh": "export demo/brdf.binary --probe probe.exr --view torus.ply --fov 30 -o scene-mesh",
    "classes": "classes",
    "classes, 2": "classes --library merl --n-classes 2 --n-dims 3",
    "precompute": "precompute --library merl",
    "verify": "verify merl",
}
"""In an order in which each finds what it reads; `live` and `bad_input` read some of the files, too."""


def commands(record: Record) -> None:
    """Every command with good input, and each file that it writes."""
    shown, table = views(), scene().whole.table("brass")
    tb.write_image("mask.png", scene().view.mask.float().expand(3, -1, -1))
    tb.write_image("ball.exr", scene().photograph)
    tb.write_image("normals.exr", shown["normal map"].normals)
    tb.write_image("bumps.exr", tb.render(table, scene().probe, shown["normal map"], 512))
    tb.write_image("torus.exr", tb.render(table, scene().probe, shown["mesh"], 512))
    tb.write_image("probe.exr", scene().probe.radiance)
    for name, command in COMMANDS.items():
        found = called(command)
        record.add(f"commands: {name}", found)
        if found["status"] != "0":
            record.add(f"commands: {name}/{RAISED}", f"{command}: {found['err']}")
        for output in map(Path, re.findall(r"(?:-o|--preview) (\S+)", command)):
            files = sorted(output.iterdir()) if output.is_dir() else [output]
            record.add(f"commands: {name}", {str(path).replace("/", " "): path for path in files})
    subprocess.run([sys.executable, "scene/render.py", "--samples", "32"], check=True, stdout=subprocess.DEVNULL)
    record.add("commands: export", {name: Path("scene") / name for name in ("image.exr", "image.png")})


def live(record: Record) -> None:
    """The page of `torchbrdf live` and a turned picture."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells make what runs in the background ignore it
    command = "live ball.exr --probe probe.exr --library merl --pixels 32 --no-browser"
    with subprocess.Popen([*PROGRAM, *command.split()], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            lines = [process.stdout.readline(), process.stdout.readline()]
            address = re.search(r"http://\S+/", lines[1])
            if address is None:
                raise ValueError(f"no address in {lines}")
            with urllib.request.urlopen(address[0], timeout=60) as answer:
                record.add("live/page", answer.read().decode())
            with urllib.request.urlopen(f"{address[0]}frame?rotation=0.8,0,0.6,0&stops=0.5", timeout=60) as answer:
                record.add("live/picture", torch.frombuffer(bytearray(answer.read()), dtype=torch.uint8))
        finally:
            process.send_signal(signal.SIGINT)
        rest = process.stdout.read()
    record.add("live/printed", ADDRESS.sub("PORT", "".join(lines) + rest))
    record.add("live/status", process.returncode)


BAD_INPUT = {
    "no command": "",
    "unknown command": "paint",
    "no photograph": "fit --probe default -o never",
    "missing photograph": "fit nowhere.exr --probe default -o never",
    "photograph that is text": "fit notes.exr --probe default -o never",
    "8-bit photograph": "fit eight-bit.png --probe default -o never",
    "black photograph": "fit black.exr --probe default -o never",
    "NaN in the photograph": "fit nan.exr --probe default -o never",
    "empty mask": "fit square.exr --probe probe.exr --mask nothing.png -o never",
    "mask of another size": "fit square.exr --probe probe.exr --mask mask.png -o never",
    "missing mask": "fit square.exr --probe probe.exr --mask nowhere.png -o never",
    "missing probe": "fit square.exr --probe nowhere.hdr -o never",
    "probe that is square": "fit square.exr --probe square.exr -o never",
    "probe that is no ball": "fit square.exr --probe wide.exr --probe-layout mirror_ball -o never",
    "unknown layout": "fit square.exr --probe probe.exr --probe-layout cube -o never",
    "NaN in the probe": "fit square.exr --probe nan.exr --probe-layout angular -o never",
    "negative penalty": "fit square.exr --probe probe.exr --penalty -1 -o never",
    "penalty that is no number": "fit square.exr --probe probe.exr --penalty much -o never",
    "unknown constraint": "fit square.exr --probe probe.exr --constraint sum -o never",
    "size that is no whole number": "fit square.exr --probe probe.exr --size 0.5 -o never",
    "size 1": "fit square.exr --probe probe.exr --size 1 -o never",
    "basis with align": "fit square.exr --probe probe.exr --basis baked.safetensors --align -o never",
    "search without align": "fit square.exr --probe probe.exr --search full -o never",
    "align of a near ball": "fit square.exr --probe probe.exr --fov 30 --align --library merl -o never",
    "uncertainty of the paper": "fit square.exr --probe probe.exr --uncertainty --penalty paper -o never",
    "basis of another view": "fit square.exr --probe probe.exr --basis baked.safetensors --library merl -o never",
    "basis that is none": "fit square.exr --probe probe.exr --basis merl/alum-bronze.binary -o never",
    "library of nothing": "fit square.exr --probe probe.exr --library empty -o never",
    "library of three": "fit square.exr --probe probe.exr --library three -o never",
    "missing library": "fit square.exr --probe probe.exr --library nowhere -o never",
    "circle of a mesh": "fit square.exr --probe probe.exr --view torus.ply --circle 8 8 7 -o never",
    "camera of a ball": "fit square.exr --probe probe.exr --toward 0 0 1 -o never",
    "mesh that is text": "fit square.exr --probe probe.exr --view notes.ply -o never",
    "missing mesh": "fit square.exr --probe probe.exr --view nowhere.obj -o never",
    "output in a file": "fit square.exr --probe probe.exr --library merl -o square.exr/out",
    "rendering as .jpg": "render merl/alum-bronze.binary --probe default -o never.jpg",
    "rendering of no table": "render short.binary --probe default -o never.png",
    "rendering of a cut table": "render broken/steel.binary --probe default -o never.png",
    "rendering into no folder": "render merl/alum-bronze.binary --probe default -o no/never.png",
    "comparison of one": "compare merl/alum-bronze.binary -o never.html",
    "comparison as text": "compare merl/alum-bronze.binary merl/alum-bronze.binary -o never.txt",
    "comparison with a folder": "compare merl/alum-bronze.binary empty -o never.html",
    "unknown model": "analytic merl/alum-bronze.binary --model velvet",
    "unknown metric": "analytic merl/alum-bronze.binary --metric taste",
    "format without file": "analytic merl/alum-bronze.binary --format gltf",
    "unknown suffix": "analytic merl/alum-bronze.binary -o never.doc",
    "no evaluations": "analytic merl/alum-bronze.binary --most-evaluations 0",
    "bake of a missing mesh": "bake --probe default --view nowhere.ply -o never.safetensors",
    "bake with one sample": "bake --probe default --samples 1 --library merl -o never.safetensors",
    "export of a missing table": "export nowhere.binary --probe default -o never",
    "export of a normal map": "export merl/alum-bronze.binary --probe default --view normals.exr -o never",
    "unsound tables": "verify broken",
    "verify of nothing": "verify empty",
    "no classes": "classes --library merl --n-classes 0",
    "live with a mask alone": "live --mask mask.png --no-browser",
    "live without a probe": "live ball.exr --no-browser",
    "live at no port": "live ball.exr --probe default --port 70000",
}


def bad_input(record: Record) -> None:
    """Exit status and message of what no command takes."""
    size = 16
    pictures = {"square": 0.1 + numbers(1, 3, size, size), "black": torch.zeros(3, size, size)}
    pictures |= {"nan": torch.full((3, size, size), torch.nan), "wide": torch.ones(3, size, size + 1)}
    for name, picture in pictures.items():
        tb.write_image(f"{name}.exr", picture)
    tb.write_image("eight-bit.png", torch.full((3, size, size), 0.5))
    tb.write_image("nothing.png", torch.zeros(3, size, size))
    Path("notes.exr").write_text("these are notes")
    Path("notes.ply").write_text("these are notes")
    Path("short.binary").write_bytes(b"short")
    for folder, count in (("empty", 0), ("three", 3), ("broken", 1)):
        Path(folder).mkdir()
        for path in sorted(LIBRARY.iterdir())[:count]:
            (Path(folder) / path.name).hardlink_to(path)
    (Path("broken") / "nylon.binary").write_bytes(b"short")
    (Path("broken") / "steel.binary").write_bytes((LIBRARY / "alum-bronze.binary").read_bytes()[:-8])
    record.add("bad input", {name: called(command) for name, command in BAD_INPUT.items()})
    record.add("bad input/left behind", " ".join(sorted(str(path) for path in Path().glob("never*"))))
