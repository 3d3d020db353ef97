"""Notebooks are the pages' own, and a cell that fails is told."""

from pathlib import Path

import jupytext
import nbformat
import pytest

import make_notebooks as script
from torchbrdf.command_line import BAD_INPUT

HEADER = "---\nfile_format: mystnb\nkernelspec:\n  display_name: Python 3\n  name: python3\n---\n\n"


@pytest.fixture
def page(tmp_path: Path) -> Path:
    path = tmp_path / "page.md"
    path.write_text(HEADER + "# Title\n\n```{code-cell} python\n:tags: [cover]\n\nprint(6 * 7)\n```\n")
    return path


def written(page: Path) -> Path:
    """A notebook beside the page, as if it had run."""
    notebook = script.read_page(page)
    for cell in notebook.cells[1:]:
        cell["execution_count"] = 1
    script.write_notebook(notebook, page)
    return page.with_suffix(".ipynb")


@pytest.mark.skipif(not script.PAGES.is_dir(), reason="the documentation is not here")
class TestTheTutorials:
    @pytest.mark.parametrize("page", script.pages(), ids=lambda page: page.stem)
    def test_notebooks_are_those_of_the_pages(self, page: Path):
        assert script.difference(page) is None

    @pytest.mark.parametrize("page", script.pages(), ids=lambda page: page.stem)
    def test_pages_have_a_cover_and_are_short(self, page: Path):
        notebook = jupytext.read(page.with_suffix(".ipynb"))
        assert script.cover(notebook) == page.with_suffix(".png").read_bytes()
        assert page.with_suffix(".ipynb").stat().st_size <= script.LARGEST
        assert len(page.read_text().splitlines()) <= 200

    def test_no_cell_of_a_notebook_failed(self):
        outputs = [
            output
            for page in script.pages()
            for cell in jupytext.read(page.with_suffix(".ipynb")).cells
            for output in cell.get("outputs", ())
        ]
        assert outputs
        assert [output for output in outputs if output.output_type == "error"] == []

    def test_the_first_goes_the_whole_way(self):
        text = (script.PAGES / "photographs.md").read_text()
        assert all(f"\ntorchbrdf {name} " in text for name in ("merge", "probe", "fit", "export"))


def test_the_notebook_of_a_page_does_not_differ(page: Path):
    written(page)
    assert script.difference(page) is None


def test_what_differs_is_told(page: Path):
    assert script.difference(page) == "page.ipynb is missing"
    written(page)
    page.write_text(page.read_text().replace("6 * 7", "6 * 8"))
    assert script.difference(page) == "page.ipynb differs from page.md in cell 1: print(6 * 8)"
    page.write_text(page.read_text() + "\nMore.\n")
    written(page)
    page.write_text(page.read_text().replace("\nMore.\n", ""))
    assert script.difference(page) == "page.ipynb has 3 cells, page.md 2"


def test_a_notebook_that_was_not_run_is_told(page: Path):
    script.write_notebook(script.read_page(page), page)
    assert script.difference(page) == "page.ipynb was not run"


def test_prose_is_renewed_without_a_run(page: Path, capsys: pytest.CaptureFixture[str]):
    pytest.importorskip("nbclient")
    before = jupytext.read(written(page))
    page.write_text(page.read_text().replace("# Title", "# Another title"))
    assert script.main(["--folder", str(page.parent), "--prose"]) == 0
    after = jupytext.read(page.with_suffix(".ipynb"))
    assert after.cells[0].source == "# Another title"
    assert after.cells[1:] == before.cells[1:]
    page.write_text(page.read_text().replace("6 * 7", "6 * 8"))
    assert script.main(["--folder", str(page.parent), "--prose"]) == BAD_INPUT
    assert "page.ipynb: its code is not that of page.md" in capsys.readouterr().err


def test_a_large_notebook_is_not_written(page: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(script, "LARGEST", 10)
    with pytest.raises(ValueError, match=r"page\.ipynb has \d+ bytes, at most 10"):
        written(page)
    assert not page.with_suffix(".ipynb").exists()


def test_an_unknown_page_is_refused(page: Path):
    with pytest.raises(ValueError, match="no tutorial 'pages'; there are page"):
        script.pages(["pages"], page.parent)


class TestRunning:
    @pytest.fixture(autouse=True)
    def _kernel(self):
        pytest.importorskip("nbclient")
        pytest.importorskip("ipykernel")

    def test_outputs_are_kept_without_the_folder_they_were_made_in(self, page: Path):
        page.write_text(page.read_text() + "\n```{code-cell} python\n%cd ../..\n%ls\n```\n")
        cells = script.executed(page).cells
        assert cells[1].outputs[0].text == "42\n"
        shown = "".join(output.text for output in cells[2].outputs)
        assert "scripts" in shown
        assert "tmp" not in shown

    @pytest.mark.parametrize("failing", ["1 / 0", "%%bash -e\nfalse\ntrue"])
    def test_a_cell_that_fails_ends_it(self, page: Path, failing: str, capsys: pytest.CaptureFixture[str]):
        page.write_text(page.read_text() + f"\n```{{code-cell}} python\n{failing}\n```\n")
        assert script.main(["--folder", str(page.parent)]) == script.FAILED
        assert "failed: page" in capsys.readouterr().out
        assert not page.with_suffix(".ipynb").exists()


def test_outputs_are_what_a_terminal_shows():
    def stream(name: str, text: str):
        return nbformat.v4.new_output("stream", name=name, text=text)

    bar = "\rreading:  50%|#####     | 1/2 [00:00<00:00, 3it/s]\rreading: 100%|##########| 2/2\r             \r"
    pieces = [stream("stderr", bar), stream("stdout", "wrote /work/docs/tutorials/a"), stream("stdout", ".exr\n\n")]
    warning = stream("stderr", "/tmp/ipykernel_7/8.py:9: \x1b[1;33mUserWarning:\x1b[0m loud\n")
    shown = script.as_on_a_terminal([*pieces, warning], "/work")
    assert [(output.name, output.text) for output in shown] == [
        ("stdout", "wrote a.exr\n"),
        ("stderr", "UserWarning: loud\n"),
    ]
