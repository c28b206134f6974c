"""Which surface suits which body?  All methods, from the same contacts, for every body in meshes/.

Each body is scanned once, in slices across its z axis; the coefficient of friction is drawn separately for every sample.
Every method builds a surface from the contacts alone, and the surface is then compared with the true body.  The script
prints a table in Markdown: the Hausdorff distance to the body over the diagonal of its bounding box, the time that the
method took, and "open" where the surface has holes.  A dash means that the method refuses these contacts.  `auto` names the
method that it has chosen by cross-validation with held-out slices.

A convex hull and a fitted support function make use of the convexity of the body.  Poisson reconstruction and ball pivoting do
not, and have no information beyond the last slice: a flat end without contacts becomes a bulge or a hole.

    python examples/methods_by_meshes.py [MESH...] [--slices N] [--spacing cosine|adaptive]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept (the scan); M. Kazhdan, H. Hoppe, ACM Transactions on Graphics 32(3), 2013 (screened Poisson reconstruction);
F. Bernardini et al., IEEE Transactions on Visualization and Computer Graphics 5(4), 1999 (ball pivoting).
"""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from time import perf_counter

import scan3d
from scan3d.surfaces import METHODS

MESHES = sorted(file for file in (Path(__file__).parents[1] / "meshes").iterdir() if file.suffix not in (".py", ""))
FRICTION = (0.0, 0.4)


def cell(cloud: scan3d.Cloud, mesh: object, method: str) -> str:
    """Relative Hausdorff distance, seconds and whether the surface is open, or a dash."""
    start = perf_counter()
    try:
        surface = scan3d.surface(cloud, method)
    except scan3d.InputError:
        return "–"
    seconds = perf_counter() - start
    relative = scan3d.compare(surface, mesh).relative
    chosen = f"{surface.metadata['method']}: " if method == "auto" else ""
    return f"{chosen}{relative:.1e}, {seconds:.1f} s" + ("" if surface.is_watertight else ", open")


def rows(files: Sequence[Path], slices: int, spacing: str) -> Iterator[str]:
    """The lines of the table, each as soon as it has been computed."""
    yield f"| body | contacts | {' | '.join(METHODS)} |"
    yield "|---" * (len(METHODS) + 2) + "|"
    for file in files:
        mesh = scan3d.load_mesh(file)
        cloud = scan3d.reconstruct(
            scan3d.simulate(mesh, scan3d.Plan(slices=slices, spacing=spacing, friction=FRICTION))
        )
        yield f"| {file.stem} | {len(cloud):,} | {' | '.join(cell(cloud, mesh, method) for method in METHODS)} |"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Table of surface methods and bodies.")
    parser.add_argument("mesh", nargs="*", type=Path, help="bodies instead of those in meshes/")
    parser.add_argument("--slices", type=int, default=64)
    parser.add_argument("--spacing", choices=("cosine", "adaptive"), default="cosine")
    given = parser.parse_args(arguments)
    with suppress(ImportError, OSError):
        import open3d  # noqa: F401 - imported first, so that no measured time contains the import
    for row in rows(given.mesh or MESHES, given.slices, given.spacing):
        print(row, flush=True)


if __name__ == "__main__":
    main()
