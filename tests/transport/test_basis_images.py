from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from torchbrdf.brdf.library import MaterialLibrary
from torchbrdf.brdf.merl import MerlTable
from torchbrdf.light.probe import LightProbe
from torchbrdf.rendering.basis import render_basis
from torchbrdf.transport.basis_images import BasisImages
from torchbrdf.view.sphere import SphereView

SIZE = 8


@pytest.fixture(scope="module")
def probe() -> LightProbe:
    return LightProbe.default(16)


@pytest.fixture(scope="module")
def basis(tiny_library: MaterialLibrary, probe: LightProbe) -> BasisImages:
    return render_basis(tiny_library, probe, SphereView(SIZE), samples=64)


@pytest.fixture
def saved(basis: BasisImages, tmp_path: Path) -> Path:
    basis.save(tmp_path / "basis.safetensors")
    return tmp_path / "basis.safetensors"


def small(**changes: object) -> BasisImages:
    """Two materials, a 2 x 3 image of which four pixels are used; entry 100 row + 10 channel + pixel."""
    mask = torch.tensor([[[True, False, True], [True, True, False]]])
    packed = 100 * torch.arange(6.0)[:, None, None] + 10 * torch.arange(3.0)[:, None] + torch.arange(4.0)
    fields = {"packed": packed, "mask": mask, "names": ("a", "b"), "library": "L", "probe": "P", "view": "V"}
    return BasisImages(**{**fields, **changes})


class TestContents:
    def test_sizes(self):
        basis = small()
        assert (basis.n, basis.size) == (6, (2, 3))
        assert "n = 6, 2 x 3, 4 pixels" in repr(basis)

    def test_few_normals_are_distrusted_wherever_the_images_go(self, tmp_path):
        assert small(normal_coverage=0.15).distrust is None
        plane = small(normal_coverage=0.009)
        plane.save(tmp_path / "plane.safetensors")
        for basis in (plane, plane.subset(["b"]), BasisImages.load(tmp_path / "plane.safetensors")):
            assert basis.distrust is not None
            assert "0.9% of the normals of a sphere" in basis.distrust

    def test_subset_and_without_take_three_rows_a_material(self):
        basis = small()
        swapped = basis.subset(["b", "a"])
        assert swapped.names == ("b", "a")
        assert swapped.packed[:, 0, 0].tolist() == [300, 400, 500, 0, 100, 200]
        left = basis.without("a")
        assert left.names == ("b",)
        assert left.packed[:, 0, 0].tolist() == [300, 400, 500]
        assert basis.names == ("a", "b")

    def test_no_names_and_one_twice(self):
        for use in (lambda b: b.subset([]), lambda b: b.without("a", "b")):
            with pytest.raises(ValueError, match=r"^basis images need at least one material, got none$"):
                use(small())
        with pytest.raises(ValueError, match=r"^materials must have different names; twice or more: a$"):
            small().subset(["a", "b", "a"])
        assert small().without("a", "a").names == ("b",)
        assert small().without().names == ("a", "b")

    def test_unknown_names(self):
        for use in (lambda b: b.subset(["a", "c"]), lambda b: b.without("c"), lambda b: b.image("c")):
            with pytest.raises(ValueError, match="no material 'c' among these 2 basis images"):
                use(small())

    def test_image_shows_each_channel_of_the_material_in_its_own_colour_of_the_light(self):
        image = small().image("b")
        assert image.shape == (3, 2, 3)
        assert image[:, 0, 0].tolist() == [300, 410, 520]
        assert image[:, 1, 1].tolist() == [303, 413, 523]
        assert image[:, 0, 1].tolist() == [0, 0, 0]

    def test_a_name_that_is_nearly_one_is_suggested(self, basis: BasisImages):
        with pytest.raises(ValueError, match=r"no material 'gold' among .* \(did you mean gold-0.3\?\)"):
            basis.image("gold")

    @pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
    @pytest.mark.parametrize("batch", [(), (2,), (2, 0), (1, 2)])
    def test_combinations_are_weighted_sums_in_the_precision_of_the_weights(
        self, batch: tuple[int, ...], dtype: torch.dtype
    ):
        basis, weights = small(), torch.rand(*batch, 6, 3, dtype=dtype)
        shown = sum(weights[..., i, :, None] * basis.packed[i] for i in range(6))
        with torch.autocast("cpu", torch.bfloat16):
            image = basis.render(weights)
        assert image.dtype == dtype
        torch.testing.assert_close(image, basis.unpack(shown.to(dtype)))

    def test_a_material_is_its_own_combination(self):
        weights = torch.zeros(6, 3)
        weights[[3, 4, 5], [0, 1, 2]] = 1
        assert torch.equal(small().render(weights), small().image("b"))

    def test_gradients_of_combinations_reach_weights_and_images(self):
        weights = torch.rand(2, 6, 3, dtype=torch.float64, requires_grad=True)
        packed = torch.rand(6, 3, 4, dtype=torch.float64, requires_grad=True)
        assert torch.autograd.gradcheck(lambda w, y: small(packed=y).render(w), (weights, packed))

    @pytest.mark.parametrize(
        ("weights", "got"),
        [
            (torch.zeros(3, 6), r"\(3, 6\) torch.float32"),
            (torch.zeros(6), r"\(6,\) torch.float32"),
            (torch.zeros(6, 3, dtype=torch.int64), r"\(6, 3\) torch.int64"),
        ],
    )
    def test_weights_of_another_shape_or_type(self, weights: torch.Tensor, got: str):
        expected = r"weights must be \(\*batch, 6, 3\) floating-point numbers for these basis images, got "
        with pytest.raises(ValueError, match=expected + got):
            small().render(weights)
        with pytest.raises(ValueError, match=r"^weights must be a tensor, got ndarray; such as result\.weights$"):
            small().render(weights.numpy())

    def test_pack_and_unpack(self):
        basis = small()
        image = torch.arange(12.0).reshape(2, 1, 2, 3)
        packed = basis.pack(image)
        assert packed.tolist() == [[[0, 2, 3, 4]], [[6, 8, 9, 10]]]
        assert torch.equal(basis.unpack(packed), torch.where(basis.mask, image, 0))

    def test_shapes_must_belong_together(self):
        with pytest.raises(
            ValueError, match=r"packed must be \(6, 3, 4\) for these names and this mask, got \(6, 3, 5\)"
        ):
            small(packed=torch.zeros(6, 3, 5))
        with pytest.raises(ValueError, match=r"packed must be \(3, 3, 4\)"):
            small(names=("a",))

    def test_renderings_say_what_they_come_from(
        self, basis: BasisImages, tiny_library: MaterialLibrary, probe: LightProbe
    ):
        assert basis.names == tiny_library.names
        assert basis.library == tiny_library.source
        assert basis.probe == probe.fingerprint
        assert basis.view == SphereView(SIZE).fingerprint
        assert basis.packed.shape == (30, 3, int(SphereView(SIZE).mask.sum()))

    def test_selection_of_the_library_is_the_selection_of_the_images(
        self, basis: BasisImages, tiny_library: MaterialLibrary, probe: LightProbe
    ):
        direct = render_basis(tiny_library.without("red"), probe, SphereView(SIZE), samples=64)
        chosen = basis.without("red")
        assert (direct.names, direct.library) == (chosen.names, chosen.library)
        assert torch.equal(direct.packed, chosen.packed)


class TestFiles:
    def test_load_returns_what_was_saved(
        self, basis: BasisImages, saved: Path, tiny_library: MaterialLibrary, probe: LightProbe
    ):
        for found in (BasisImages.load(saved), BasisImages.load(saved, tiny_library, probe, SphereView(SIZE))):
            assert torch.equal(found.packed, basis.packed)
            assert torch.equal(found.mask, basis.mask)
            for field in ("names", "library", "probe", "view", "description"):
                assert getattr(found, field) == getattr(basis, field)

    def test_the_file_is_safetensors_with_the_fingerprints(self, basis: BasisImages, saved: Path):
        with safe_open(saved, "pt") as file:
            metadata = file.metadata()
        assert {metadata["library"], metadata["probe"], metadata["view"]} == {basis.library, basis.probe, basis.view}

    def test_names_with_spaces_quotes_and_accents_survive(self, tmp_path: Path):
        names = ('say "cheese"', "näve, ça va\n")
        small(names=names).save(tmp_path / "b.safetensors")
        assert BasisImages.load(tmp_path / "b.safetensors").names == names

    def test_another_probe_is_refused(self, saved: Path, probe: LightProbe):
        turned = probe.rotated(torch.tensor([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
        for other in (probe.scaled(2.0), turned, LightProbe.default(8)):
            with pytest.raises(ValueError, match=r"basis\.safetensors: rendered with another light probe; render"):
                BasisImages.load(saved, probe=other)
        assert BasisImages.load(saved, probe=LightProbe(probe.radiance.clone())).probe == probe.fingerprint

    def test_another_view_is_refused(self, saved: Path):
        for other in (SphereView(SIZE + 1), SphereView(SIZE, fov_deg=30)):
            with pytest.raises(ValueError, match=r"rendered with another view; render the basis again"):
                BasisImages.load(saved, view=other)

    def test_another_library_is_refused(
        self, saved: Path, tiny_library: MaterialLibrary, tiny_tables: dict[str, MerlTable]
    ):
        reversed_order = tiny_library.subset(tiny_library.names[::-1])
        other_values = MaterialLibrary.from_tables([replace(t, values=t.values * 2) for t in tiny_tables.values()])
        assert other_values.names == tiny_library.names
        for other in (tiny_library.without("red"), reversed_order, other_values):
            with pytest.raises(ValueError, match="rendered with another library; render the basis again"):
                BasisImages.load(saved, library=other)

    def test_a_saved_selection_belongs_to_that_selection(
        self, basis: BasisImages, tiny_library: MaterialLibrary, tmp_path: Path
    ):
        basis.without("red").save(tmp_path / "b.safetensors")
        assert BasisImages.load(tmp_path / "b.safetensors", tiny_library.without("red")).n == 27
        with pytest.raises(ValueError, match="another library"):
            BasisImages.load(tmp_path / "b.safetensors", tiny_library)

    def test_absent(self, tmp_path: Path):
        with pytest.raises(FileNotFoundError, match=r"gone\.safetensors: no such file; expected basis images"):
            BasisImages.load(tmp_path / "gone.safetensors")

    def test_empty(self, tmp_path: Path):
        (tmp_path / "b.safetensors").touch()
        with pytest.raises(ValueError, match=r"b\.safetensors: is empty \(0 bytes\); expected basis images"):
            BasisImages.load(tmp_path / "b.safetensors")

    @pytest.mark.parametrize("content", [b"neither", b"\xff" * 200], ids=["text", "bytes"])
    def test_another_kind_of_file(self, tmp_path: Path, content: bytes):
        (tmp_path / "b.safetensors").write_bytes(content)
        with pytest.raises(ValueError, match=r"b\.safetensors: not basis images"):
            BasisImages.load(tmp_path / "b.safetensors")

    def test_truncated(self, saved: Path):
        raw = saved.read_bytes()
        saved.write_bytes(raw[:-100])
        with pytest.raises(ValueError, match=r"basis\.safetensors: not basis images"):
            BasisImages.load(saved)

    def test_safetensors_of_something_else(self, tmp_path: Path):
        path = tmp_path / "b.safetensors"
        for metadata in (None, {"format": "pt"}, {"format": "torchbrdf basis images 0"}):
            save_file({"packed": torch.zeros(6, 3, 4)}, path, metadata)
            with pytest.raises(ValueError, match=r"b\.safetensors: not basis images of this version"):
                BasisImages.load(path)

    @pytest.mark.parametrize(
        ("tensors", "metadata", "reason"),
        [
            ({"packe": torch.zeros(1)}, {}, "wrong or absent: 'packe'"),
            ({"mask": None}, {}, "wrong or absent: 'mask'"),
            (
                {"packed": torch.zeros(6, 3, 4, dtype=torch.float16)},
                {},
                "packed must be torch.float32, got torch.float16",
            ),
            ({"mask": torch.ones(1, 2, 3)}, {}, "mask must be torch.bool, got torch.float32"),
            ({"mask": torch.ones(2, 3, dtype=torch.bool)}, {}, r"mask must be \(1, H, W\) of bytes 0 and 1"),
            ({"mask": torch.zeros(1, 2, 3, dtype=torch.bool)}, {}, "some of them 1"),
            (
                {"mask": torch.tensor([[[1, 0, 2], [1, 1, 0]]], dtype=torch.uint8).view(torch.bool)},
                {},
                "mask must be .* bytes 0 and 1",
            ),
            ({"packed": torch.full((6, 3, 4), torch.nan)}, {}, "packed holds NaN or infinite values"),
            ({"relative_errors": torch.full((6,), torch.inf)}, {}, "relative_errors holds NaN or infinite values"),
            ({"packed": torch.zeros(6, 3, 5)}, {}, r"packed must be \(6, 3, 4\) for these names"),
            ({}, {"names": None}, "its metadata has no 'names'"),
            ({}, {"library": None}, "its metadata has no 'library'"),
            ({}, {"names": '["a",'}, "names in its metadata must be a list of texts"),
            ({}, {"names": '["a", 2]'}, "names in its metadata must be a list of texts"),
            ({}, {"names": "[" * 10000}, "names in its metadata must be a list of texts"),
            ({}, {"names": '["a", "a"]'}, "two materials in its metadata have the same name"),
            ({}, {"normal_coverage": "0x7f"}, "normal_coverage in its metadata must be 0 to 1"),
            ({}, {"normal_coverage": "nan"}, "normal_coverage in its metadata must be 0 to 1"),
            ({}, {"normal_coverage": "1.5"}, "normal_coverage in its metadata must be 0 to 1"),
        ],
    )
    def test_damaged_contents_are_refused_by_name(
        self, tmp_path: Path, tensors: dict[str, object], metadata: dict[str, object], reason: str
    ):
        path = tmp_path / "b.safetensors"
        small(relative_errors=torch.zeros(6)).save(path)
        with safe_open(path, "pt") as file:
            held = {key: file.get_tensor(key) for key in list(file.keys())} | tensors
            texts = file.metadata() | metadata
        save_file(
            {key: tensor for key, tensor in held.items() if tensor is not None},
            path,
            {key: text for key, text in texts.items() if text is not None},
        )
        with pytest.raises(ValueError, match=rf"^[^\n]*b\.safetensors: damaged basis images: [^\n]*{reason}[^\n]*$"):
            BasisImages.load(path)

    def test_what_a_damaged_header_says_is_not_repeated(self, saved: Path):
        saved.write_bytes(saved.read_bytes().replace(b'"F32"', b'"\x1b[1"'))
        with pytest.raises(ValueError, match=r"basis\.safetensors: not basis images \(truncated, damaged") as caught:
            BasisImages.load(saved)
        assert str(caught.value).isprintable()

    def test_failed_save_keeps_the_old_file(self, basis: BasisImages, saved: Path, monkeypatch: pytest.MonkeyPatch):
        def interrupted(*_: object) -> None:
            raise KeyboardInterrupt

        before = saved.read_bytes()
        monkeypatch.setattr("torchbrdf.transport.basis_images.save_file", interrupted)
        with pytest.raises(KeyboardInterrupt):
            basis.subset(["red"]).save(saved)
        assert saved.read_bytes() == before
        assert [p.name for p in saved.parent.iterdir()] == [saved.name]

    def test_saving_a_strided_selection(self, basis: BasisImages, tmp_path: Path):
        strided = replace(basis, packed=basis.packed.transpose(0, 2).contiguous().transpose(0, 2))
        strided.save(tmp_path / "b.safetensors")
        assert torch.equal(BasisImages.load(tmp_path / "b.safetensors").packed, basis.packed)
