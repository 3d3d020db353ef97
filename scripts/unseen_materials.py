"""Claim: the default estimator predicts materials outside its library under new light no worse than least squares.

    python scripts/unseen_materials.py --library MERL_DIR --targets TABLE_DIR --observe grace.hdr --novel uffizi.hdr

Every table of TABLE_DIR is rendered under the first probe, with noise, fitted, and its weights rendered under the
second: as Y w, or with --tables as the table that a user would save, whose cells below zero are clamped (slow).
Errors are |rendered - target| / |target| over all pixels under the mask and channels, in per cent. Targets have
their own random numbers and four times as many samples as the basis.
"""

import argparse
import statistics
from pathlib import Path

import torch
from tqdm import tqdm

import torchbrdf as tb
from torchbrdf.estimator import DEFAULT_PENALTY
from torchbrdf.merl_directory import table_paths
from torchbrdf.metrics import relative_rms
from torchbrdf.transport import DEFAULT_SAMPLES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--library", type=Path, required=True, help="folder of MERL *.binary tables")
    parser.add_argument("--targets", type=Path, required=True, help="folder of *.binary tables to recover")
    parser.add_argument("--observe", required=True, help="light probe of the photograph")
    parser.add_argument("--novel", required=True, help="light probe of the comparison")
    parser.add_argument("--noise", type=float, nargs="*", default=[0, 1, 2], help="noise in %% of every pixel")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--penalties", type=float, nargs="*", default=[], help="more values of lambda to try")
    parser.add_argument("--tables", action="store_true", help="render whole tables instead of Y w")
    options = parser.parse_args()

    library = tb.MaterialLibrary.from_merl(options.library)
    observe, novel = tb.LightProbe.open(options.observe), tb.LightProbe.open(options.novel)
    view = tb.SphereView(options.size)
    basis = tb.render_basis(library, observe, view, progress=True)
    novel_basis = tb.render_basis(library, novel, view, progress=True)
    classes, single = tb.MaterialClasses.fit(library), tb.MaterialClasses.single(library)
    methods = {
        "naive": tb.BRDFEstimator(basis, single, penalty=0.0, solver="lstsq"),
        "single 0.5": tb.BRDFEstimator(basis, single, penalty="paper"),
        "paper": tb.BRDFEstimator(basis, classes, penalty="paper"),
        f"default {DEFAULT_PENALTY}": tb.BRDFEstimator(basis, classes),
    }
    for penalty in options.penalties:
        methods[f"classes {penalty:g}"] = tb.BRDFEstimator(basis, classes, penalty)
        methods[f"single {penalty:g}"] = tb.BRDFEstimator(basis, single, penalty)

    targets = []
    for i, path in enumerate(tqdm(table_paths(options.targets), desc="targets", leave=False)):
        table = tb.MerlTable.open(path)
        seen = tb.render(table, observe, view, 4 * DEFAULT_SAMPLES, seed=1000 + i)
        targets.append((path.stem, seen, tb.render(table, novel, view, 4 * DEFAULT_SAMPLES, seed=2000 + i)))

    for level in options.noise:
        title = f"\n{level:g} % noise; observation / novel light [%]"
        print(title.ljust(48) + "".join(f"{name:>17}" for name in methods))
        errors: dict[str, list[tuple[float, float]]] = {name: [] for name in methods}
        for i, (label, seen, truth) in enumerate(targets):
            noise = torch.randn(seen.shape, generator=torch.Generator().manual_seed(i))
            for name, estimator in methods.items():
                result = estimator(seen * (1 + level / 100 * noise))
                if options.tables:
                    relit = tb.render(result.brdf(library), novel, view, seed=3000 + i)
                else:
                    relit = novel_basis.unpack(torch.einsum("nc,ncp->cp", result.weights, novel_basis.packed))
                errors[name].append((100 * float(result.relative_error), 100 * relative_rms(relit, truth, view.mask)))
            print(label.ljust(47) + "".join(_cell(*errors[name][-1]) for name in methods))
        for label, summarise in (("mean", statistics.mean), ("worst", max)):
            rows = {name: [summarise(values) for values in zip(*pairs, strict=True)] for name, pairs in errors.items()}
            print(label.ljust(47) + "".join(_cell(*rows[name]) for name in methods))


def _cell(observation: float, novel: float) -> str:
    return f"{observation:.2f} / {novel:.2f}".rjust(17)


if __name__ == "__main__":
    main()
