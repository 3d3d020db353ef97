"""`torchbrdf completion`: what bash and zsh offer after a TAB, in a shell of their own."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from torchbrdf import commands
from torchbrdf.cli import main
from torchbrdf.commands import completion
from torchbrdf.images import RAW_SUFFIXES, readable_suffixes
from torchbrdf.view import MESH_SUFFIXES

COMMANDS = set(commands.found())
LAYOUTS = {"latlong", "angular", "mirror_ball", "vertical_cross", "horizontal_cross", "envmap_cube"}
PICTURES = {"ball.exr", "BALL.JPG", "two words.exr"}
CASES = [
    ([""], COMMANDS),
    (["fi"], {"fit"}),
    (["fit", ""], {*PICTURES, "folder"}),
    (["fit", "ball.exr", ""], {*PICTURES, "folder"}),
    (["fit", "ball.exr", "--probe-la"], {"--probe-layer", "--probe-layout"}),
    (["fit", "--probe-layout", ""], LAYOUTS),
    (["fit", "ball.exr", "--probe-layout", "m"], {"mirror_ball"}),
    (["fit", "ball.exr", "--circle", "1", "2", "3", "--search", ""], {"near", "full"}),
    (["fit", "--align", "--probe", "d"], {"default"}),
    (["fit", "--penalty", ""], {"auto", "paper"}),
    (["fit", "--library", ""], {"default", "gold.binary", "satin.bsdf", "folder"}),
    (["analytic", "gold.binary", "--model", "p"], {"principled"}),
    (["render", ""], {"gold.binary", "satin.bsdf", "folder"}),
    (["live", "--view", ""], {"sphere", "shape.ply", "folder", *PICTURES}),
    (["observe", "--probes", "ball.exr", "--sug"], {"--suggest"}),
    (["completion", ""], {"bash", "zsh"}),
]
IDS = [" ".join(typed) for typed, _ in CASES]

BASH = r"""
source script
COMP_WORDS=("$@"); COMP_CWORD=$(( $# - 1 ))
"$(complete -p torchbrdf | sed 's/.*-F \([^ ]*\) .*/\1/')"
printf '%s\n' "${COMPREPLY[@]}"
"""
ZSH = r"""
zmodload zsh/zpty
zpty shell zsh -f -i
say() { zpty -w shell "$1"; }
say 'PS1=; autoload -Uz compinit; compinit -u -D -d dump; '$1
say 'compadd() { local -a got; builtin compadd -O got "$@"; print -rl -- $got >> offered; builtin compadd "$@" }'
say "bindkey '^I' complete-word; zstyle ':completion:*' completer _complete; print REA''DY"
zpty -r -m shell seen '*READY*'
zpty -w -n shell "$2"$'\t'
repeat 200; do [[ -s offered ]] && break; sleep 0.05; done
zpty -w -n shell $'\C-u'"print DO''NE"$'\n'
zpty -r -m shell seen '*DONE*'
zpty -d shell
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files to choose from, and the scripts."""
    root = tmp_path_factory.mktemp("completion")
    for name in (*PICTURES, "notes.txt", "gold.binary", "satin.bsdf", "shape.ply"):
        (root / name).touch()
    (root / "folder").mkdir()
    return root


@pytest.fixture(scope="module")
def script_of(folder: Path) -> Callable[[str], Path]:
    """The script for a shell, in a folder of its own."""

    def script_of(shell: str) -> Path:
        path = folder.with_name(f"{folder.name}-{shell}") / "_torchbrdf"
        if not path.exists():
            path.parent.mkdir()
            command = [sys.executable, "-m", "torchbrdf", "completion", shell]
            path.write_text(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        return path

    return script_of


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not here")
@pytest.mark.parametrize(("typed", "expected"), CASES, ids=IDS)
def test_bash(typed: list[str], expected: set[str], folder: Path, script_of: Callable[[str], Path]):
    program = BASH.replace("script", str(script_of("bash")), 1)
    command = ["bash", "--norc", "-c", program, "bash", "torchbrdf", *typed]
    ran = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60)
    assert set(ran.stdout.splitlines()) == expected, ran.stderr


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not here")
@pytest.mark.parametrize(("typed", "expected"), CASES, ids=IDS)
def test_zsh(typed: list[str], expected: set[str], folder: Path, script_of: Callable[[str], Path], tmp_path: Path):
    assert by_zsh(typed, f'eval "$(cat {script_of("zsh")})"', folder, tmp_path) == expected


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not here")
def test_zsh_from_a_folder_of_functions(folder: Path, script_of: Callable[[str], Path], tmp_path: Path):
    setup = f"fpath=({script_of('zsh').parent} $fpath); compinit -u -D -d dump"
    assert by_zsh(["fit", "--probe-layout", ""], setup, folder, tmp_path) == LAYOUTS


def by_zsh(typed: list[str], setup: str, folder: Path, place: Path) -> set[str]:
    """What an interactive zsh offers: it notes it in a file, beside which it finds those of the folder."""
    for path in folder.iterdir():
        (place / path.name).symlink_to(path)
    line = " ".join(["torchbrdf", *typed])
    command = ["zsh", "-f", "-c", ZSH, "zsh", setup, line]
    ran = subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=60)
    assert ran.returncode == 0, ran.stderr
    found = (place / "offered").read_text().splitlines()
    return {one.replace("\\", "") for one in found} - {"", "dump", "offered"}


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_script_is_printed_at_once(shell: str):
    """A shell may ask for it whenever it starts: torch is not loaded."""
    program = "import sys; from torchbrdf.cli import main; main(sys.argv[1:]); assert 'torch' not in sys.modules"
    ran = subprocess.run([sys.executable, "-c", program, "completion", shell], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "torchbrdf" in ran.stdout


def test_suffixes_are_those_that_are_read():
    assert {f".{suffix}" for suffix in completion.PICTURES} == set(readable_suffixes())
    assert {f".{suffix}" for suffix in completion.RAW} == set(RAW_SUFFIXES)
    assert {f".{suffix}" for suffix in completion.MESHES} == set(MESH_SUFFIXES)


def test_another_shell_is_refused(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit, match="2"):
        main(["completion", "tcsh"])
    assert "choose from" in capsys.readouterr().err
